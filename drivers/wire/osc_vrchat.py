"""VRChat's OSC trackers: nine places without names.

    /tracking/trackers/<1 to 8, or head>/position  f f f metres
    /tracking/trackers/<1 to 8, or head>/rotation  f f f degrees, of no use here

As on docs.vrchat.com/docs/osc-trackers. Programs send each message by itself, or all in a bundle. A
lost tracker is not sent.
"""

from __future__ import annotations

from drivers.frame import Layout
from drivers.url import Url
from drivers.wire.assembler import take_rate
from drivers.wire.osc import OscMessage, arguments, build
from drivers.wire.osc_markers import (
    MarkerDecoder,
    MarkerEncoder,
    Position,
    Slot,
    position_of,
)

FRAME = "unity"  # metres, Y up, left-handed

PLACES = ("1", "2", "3", "4", "5", "6", "7", "8", "head")
_POSITIONS = {f"/tracking/trackers/{place}/position": place for place in PLACES}
_ROTATIONS = frozenset(f"/tracking/trackers/{place}/rotation" for place in PLACES)


class VrchatDecoder(MarkerDecoder):
    """The labels are the places: `1` to `8` and `head`."""

    def _read(self, message: OscMessage) -> tuple[str, Position] | None:
        if message.address in _POSITIONS:
            xyz = position_of(message.types, arguments(message))
            return _POSITIONS[message.address], xyz
        if message.address not in _ROTATIONS:
            self.counters["foreign"] += 1
        return None


class VrchatEncoder(MarkerEncoder):
    """Positions alone, a bundle for each frame. Labels that are no places take them in order."""

    def encode_layout(self, layout: Layout) -> bytes:
        labels = layout.labels
        if not set(labels) & set(PLACES) and len(labels) <= len(PLACES):
            labels = PLACES[: len(labels)]
        if not set(labels) <= set(PLACES):
            raise ValueError(
                f"VRChat has the places {', '.join(PLACES)}: send nine markers at most, or name "
                "them all with the option labels, for example labels=1:C7,head:LFHD"
            )
        return super().encode_layout(Layout(labels, layout.rate))

    def _slot(self, label: str, row: int) -> Slot:
        return Slot(build(f"/tracking/trackers/{label}/position", *[("f", 0.0)] * 3))


def open_decoder(url: Url) -> VrchatDecoder:
    """The host's side. Option: `rate` in Hz."""
    return VrchatDecoder(take_rate(url))


def open_encoder(url: Url) -> VrchatEncoder:
    """The tracking program's side; it has no options."""
    return VrchatEncoder()
