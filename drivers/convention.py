"""How another program names and places markers, and what we make of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from drivers.coordinates import OURS, Frame, parse_axes, parse_frame, parse_unit
from drivers.frame import Floats, Layout
from drivers.url import Url

_NO_LABELS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Convention:
    """A stream's coordinates and labels. labels: theirs to ours; others stay as they are."""

    frame: Frame = OURS
    labels: Mapping[str, str] = field(default_factory=lambda: _NO_LABELS)

    @classmethod
    def take(cls, url: Url, frame: Frame = OURS, *, unit: float | None = None) -> Convention:
        """The options `frame`, `axes`, `unit` and `labels` of an address.

        frame: the wire's own, where the address names none. unit: metres, where it is known: then
        there is no option for it. Raises UrlError.
        """
        frame = url.take("frame", frame, parse_frame)
        axes = url.take("axes", frame.axes, parse_axes)
        if unit is None:
            unit = url.take("unit", frame.unit, parse_unit)
        return cls(Frame(axes, unit), url.take("labels", _NO_LABELS, parse_labels))

    def lacking(self, layout: Layout) -> list[str]:
        """Names that `labels` has and their layout has not, nobody's."""
        names = {own for label in layout.labels for own in (label, label.rpartition(":")[2])}
        return [name for name in self.labels if name not in names]

    def layout_in(self, layout: Layout) -> Layout:
        """Their layout under our labels. Two of theirs may not be one of ours: ValueError."""
        if not self.labels:
            return layout
        return Layout(tuple(map(self._ours, layout.labels)), layout.rate)

    def layout_out(self, layout: Layout) -> Layout:
        """Our layout under their labels."""
        theirs = {ours: name for name, ours in self.labels.items()}
        return Layout(tuple(theirs.get(name, name) for name in layout.labels), layout.rate)

    def _ours(self, name: str) -> str:
        """Our name of a marker; of several performers, `ann:LeftHand` is `LeftHand` of each."""
        if name in self.labels:
            return self.labels[name]
        whose, colon, own = name.rpartition(":")
        return f"{whose}{colon}{self.labels.get(own, own)}"

    def xyz_in(self, xyz: Floats) -> Floats:
        """(M, 3) of theirs as ours, metres."""
        return self.frame.to_ours(xyz)

    def xyz_out(self, xyz: Floats) -> Floats:
        """(M, 3) metres of ours as theirs."""
        return self.frame.from_ours(xyz)


def parse_labels(text: str) -> Mapping[str, str]:
    """`THEIRS:OURS,THEIRS:OURS`, no name twice on either side. Raises ValueError.

    The last colon of each divides: a foreign name may have one of its own.
    """
    labels: dict[str, str] = {}
    for pair in text.split(","):
        theirs, colon, ours = pair.strip().rpartition(":")
        if not (colon and theirs and ours):
            raise ValueError(f"'{pair}' maps nothing: write for example Hand_L:LWRB,Hand_R:RWRB")
        if theirs in labels or ours in labels.values():
            raise ValueError(f"'{pair}': {theirs} or {ours} is named twice")
        labels[theirs] = ours
    return labels
