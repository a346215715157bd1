"""The worlds that a stream may mean: which way is up, and whether left and right are exchanged.

How a world is turned about its up axis makes no difference to the body: of the 48 ways to name
three axes there are twelve kinds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from drivers.coordinates import FRAMES, UNITS, Frame

FITS = 1.55  # a unit fits a body at most this many times as large or small as the model's


def _all_axes() -> Iterator[str]:
    for order in itertools.permutations("xyz"):
        for signs in itertools.product(("", "-"), repeat=3):
            yield ",".join(sign + axis for sign, axis in zip(signs, order, strict=True))


def kind(frame: Frame) -> tuple[str, bool]:
    """What the body tells of a world: the axis that is up, and whether it is left-handed."""
    return frame.axes.rpartition(",")[2], frame.left_handed


def _strangeness(axes: str) -> tuple[int, int]:
    """Axes out of their place, and signs."""
    parts = axes.split(",")
    return sum(part[-1] != own for part, own in zip(parts, "xyz", strict=True)), axes.count("-")


# One of each kind, the least strange; ours is the first.
WORLDS: tuple[Frame, ...] = tuple(
    {
        kind(Frame(axes)): Frame(axes)
        for axes in sorted(_all_axes(), key=_strangeness, reverse=True)
    }.values()
)[::-1]


def joined(first: Frame, then: Frame) -> Frame:
    """A world read as `first`, and what comes of it as `then`."""
    turn = first.turn @ then.turn
    axes = ",".join(
        ("-" if column.sum() < 0 else "") + "xyz"[int(np.flatnonzero(column)[0])]
        for column in turn.T
    )
    return Frame(axes, first.unit * then.unit)


def nearest_unit(unit: float) -> float | None:
    """The known unit (m) that is about as long; None where there is none."""
    near = min(UNITS.values(), key=lambda known: abs(np.log(known / unit)))
    return near if max(near / unit, unit / near) <= FITS else None


def options_of(frame: Frame) -> Mapping[str, str]:
    """What to write into an address: a named world of this kind, else axes and unit."""
    for name, named in FRAMES.items():
        if kind(named) == kind(frame) and np.isclose(named.unit, frame.unit):
            return {"frame": name}
    return {"axes": frame.axes, "unit": unit_name(frame.unit)}


def unit_name(unit: float) -> str:
    """`mm` for 0.001."""
    return min(UNITS, key=lambda name: abs(np.log(UNITS[name] / unit)))
