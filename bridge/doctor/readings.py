"""The ways to read a stream: as what world, with which labels exchanged; and how well each fits."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.doctor.body_fit import BodyFit
from bridge.doctor.worlds import WORLDS
from drivers.coordinates import OURS, Frame
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Pairs = tuple[tuple[str, str], ...]

# A reading is better than another if, in this share of the frames, it fits better, and its squared
# distance is smaller by so much in the median.
CONSISTENT = 0.8
MARGIN = 6.0
TWINS = 30.0  # the same against its mirror image: no body is quite the same on both sides


@dataclass(frozen=True)
class Reading:
    """world: what the positions are taken to be. exchanged: pairs of labels that are taken for each
    other. sides: whether these are all of left and right.
    """

    world: Frame = OURS
    exchanged: Pairs = ()
    sides: bool = False

    @property
    def changes(self) -> int:
        """How much has to be wrong for this to be right."""
        return (self.world != OURS) + bool(self.exchanged)


AS_IT_IS = Reading()


def best_readings(fit: BodyFit, labels: tuple[str, ...], xyz: Floats) -> list[Reading]:
    """The reading that fits best, and those that cannot be told from it and change as little: first
    the worlds. As it is, where no other is clearly better.

    On a body that is the same on both sides, a mirrored world with left and right exchanged looks
    like the true one.

    labels: of the stream, those of `fit` among them; xyz: (n, M, 3) metres, those of `fit` there.
    """
    rows = {label: row for row, label in enumerate(labels)}
    readings = list(_readings(fit.labels, labels))
    misfits = []
    for reading in readings:
        other = dict(reading.exchanged) | {two: one for one, two in reading.exchanged}
        columns = [rows[other.get(label, label)] for label in fit.labels]
        misfits.append(fit.misfit(reading.world.to_ours(xyz[:, columns]).astype(float)))
    table = np.array(misfits)
    best = int(np.median(table, axis=1).argmin())
    if not _is_better(table[best], table[readings.index(AS_IT_IS)]):
        return [AS_IT_IS]
    alike = [
        reading
        for reading, misfit in zip(readings, table, strict=True)
        if not _is_better(
            table[best], misfit, TWINS if reading.sides != readings[best].sides else MARGIN
        )
    ]
    simplest = min(reading.changes for reading in alike)
    return [reading for reading in alike if reading.changes == simplest]


def partners(tracked: tuple[str, ...], labels: tuple[str, ...]) -> list[str]:
    """The labels of the stream that are tracked markers' names on the other side."""
    sides = _sides(labels)
    return [sides[label] for label in tracked if label in sides]


def _sides(labels: tuple[str, ...]) -> dict[str, str]:
    """Each label that has one to the label of the other side."""
    other = {"L": "R", "R": "L"}
    found = {name: other[name[0]] + name[1:] for name in labels if name[0] in other}
    return {name: across for name, across in found.items() if across in labels}


def _is_better(one: Array, other: Array, margin: float = MARGIN) -> bool:
    gain = other - one
    return bool(np.median(gain) >= margin and np.mean(gain > 0) >= CONSISTENT)


def _readings(tracked: tuple[str, ...], labels: tuple[str, ...]) -> Iterator[Reading]:
    exchanges: list[tuple[Pairs, bool]] = [((), False)]
    exchanges += [((pair,), False) for pair in itertools.combinations(tracked, 2)]
    sides = tuple((name, other) for name, other in _sides(labels).items() if name[0] == "L")
    if len(sides) > 1:
        exchanges.append((sides, True))
    for pairs, of_sides in exchanges:
        for world in WORLDS:
            yield Reading(world, pairs, of_sides)
