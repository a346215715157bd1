"""What may be worn: the wishes of `select-markers --by error`, and what they leave to be chosen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from bridge.body_frame import REFERENCES, SIX_FRAME
from drivers.errors import UsageError
from drivers.marker_set import MARKERS
from training.mirroring import MIRRORED_COLUMNS

Markers = tuple[str, ...]
Units = tuple[Markers, ...]

SHOULDERS = SIX_FRAME.references  # give the body frame where no other references are worn
COUNT = 6  # as many as the paper's

# What holds a marker on somebody who is dressed. The labels are without their side.
WEARABLE = {
    "FHD": "a cap or head band",
    "BHD": "a cap or head band",
    "SHO": "a shoulder strap",
    "STRN": "a chest belt",
    "T10": "a chest belt",
    "UPA": "an arm band",
    "WRA": "a wrist band",
    "WRB": "a wrist band",
    "FIN": "a glove",
    "FWT": "a belt",
    "BWT": "a belt",
    "ANK": "an ankle band",
    "HEE": "a shoe",
    "TOE": "a shoe",
    "MT5": "a shoe",
}
# Why nothing holds the others.
NOT_WEARABLE = {
    "C7": "a collar comes away from the neck",
    "CLAV": "cloth hangs loose over the collar bones",
    "RBAC": "cloth slides over the shoulder blade",
    "ELB": "a sleeve slides as the elbow bends",
    "FRM": "a band slips down the forearm",
    "THI": "trousers swing about the thigh, and a band slips down it",
    "KNE": "trousers slide as the knee bends",
    "SHN": "trousers swing about the shin, and a band slips off the calf",
}


@dataclass(frozen=True, slots=True)
class Choice:
    """What a search chooses from.

    references: give the body frame, and are worn in any case. must: what the set has in any case.
    units: what may be added, each worn whole or not at all: a marker or a pair. left: how many
    markers are to be added.
    """

    references: Markers
    must: Markers
    units: Units
    left: int

    def beside_references(self, markers: Collection[str]) -> Markers:
        """These markers without the references."""
        return tuple(label for label in markers if label not in self.references)


@dataclass(frozen=True, slots=True)
class Wishes:
    """count: how many principal markers. must, never: labels. pairs: a left marker only together
    with its right twin; those on the middle of the body stand alone. clothes: only WEARABLE ones.
    alone: the body frame is the shoulders', which are among the `count`; no references beside them.
    """

    count: int = COUNT
    must: Markers = ()
    never: Markers = ()
    pairs: bool = False
    clothes: bool = False
    alone: bool = False

    @property
    def references(self) -> Markers:
        """What gives the body frame."""
        return SHOULDERS if self.alone else REFERENCES

    def choice(self) -> Choice:
        """What is left to be chosen. Raises UsageError where the wishes cannot all be kept."""
        asked = tuple(dict.fromkeys((*(SHOULDERS if self.alone else ()), *self.must)))
        units = _pairs() if self.pairs else tuple((label,) for label in MARKERS)
        worn = [unit for unit in units if {*unit} & {*asked}]
        self._check_must(asked, worn)
        must = tuple(label for unit in worn for label in unit)
        if len(must) > self.count:
            raise UsageError(
                f"--count {self.count} is less than what must be worn: {', '.join(must)}"
            )
        barred = {*must, *self.references, *self.never}
        free = tuple(
            unit
            for unit in units
            if not {*unit} & barred and not (self.clothes and _not_wearable(unit))
        )
        left = self.count - len(must)
        if self.alone and self.count == len(SHOULDERS):
            raise UsageError(
                f"--count {self.count}: the shoulders alone tell no pose: take 3 or more"
            )
        if not can_fill(left, free):
            raise UsageError(
                f"--count {self.count}: the wishes leave {sum(map(len, free))} markers to choose "
                f"{left} from{' in pairs' if self.pairs else ''}, which cannot be: take another "
                "number or allow more"
            )
        if len({*must, *self.references}) + left >= len(MARKERS):
            raise UsageError(f"--count {self.count}: no marker is left to be estimated")
        return Choice(self.references, must, free, left)

    def _check_must(self, asked: Markers, units: Sequence[Markers]) -> None:
        """That what must be worn, which is in these units, is against no other wish."""
        for option, labels in (("--must", self.must), ("--never", self.never)):
            unknown = [label for label in labels if label not in MARKERS]
            if unknown:
                raise UsageError(f"{option}: {', '.join(unknown)} not in the marker set")
            references = [label for label in labels if label in self.references]
            if references and not (self.alone and labels is self.must):
                raise UsageError(
                    f"{option}: {', '.join(references)} are references, worn in any case: leave "
                    "them out"
                )
        both = [label for label in asked if label in self.never]
        if both:
            raise UsageError(f"--must and --never both name {', '.join(both)}")
        lonely = {*asked} - {label for unit in units for label in unit}
        if lonely:
            raise UsageError(f"--must: {', '.join(sorted(lonely))} has no twin, as --pairs wants")
        for unit in units:
            for label in unit:
                if label in self.never:
                    raise UsageError(
                        f"--never: {label} is the twin of one that must be worn: --pairs wants both"
                    )
            why = _not_wearable(unit) if self.clothes else None
            if why:
                raise UsageError(f"--must: {', '.join(unit)} does not go with --clothes: {why}")


def can_fill(left: int, units: Sequence[Markers]) -> bool:
    """Whether some of the units, each of one marker or two, have exactly `left` markers."""
    singles = sum(len(unit) == 1 for unit in units)
    pairs = min(len(units) - singles, left // 2)
    # All the pairs that go in leave the fewest to those that stand alone.
    return left >= 0 and left - 2 * pairs <= singles


def _pairs() -> Units:
    """The pairs of twins, and the markers on the middle of the body."""
    twins = [MARKERS[column // 3] for column in MIRRORED_COLUMNS[::3]]
    # Right ones come with their left twin. RBAC has none, though mirror images keep it.
    return tuple(
        (label,) if label == twin else (label, twin)
        for label, twin in zip(MARKERS, twins, strict=True)
        if not label.startswith("R")
    )


def _not_wearable(unit: Markers) -> str | None:
    """Why nothing that one wears holds these markers; None where something does."""
    return next((why for label in unit if (why := _reason(label))), None)


def _reason(label: str) -> str | None:
    return NOT_WEARABLE.get(label) or (
        NOT_WEARABLE.get(label[1:]) if label[0] in ("L", "R") else None
    )
