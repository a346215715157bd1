"""How a performer's humanoid is built: what stays the same while they move.

Measured on the markers of each pose and averaged, so that a bone has one length: it changes ever
less from pose to pose, and after ten seconds not at all.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from bridge.humanoid.rotations import Array

PRIOR = 30  # poses that the usual proportions count as much as
SETTLED = 120  # poses after which only
SLOW = 12_000  # poses, 100 s, change much


@dataclass(frozen=True, slots=True, eq=False)
class Proportions:
    """Lengths and places in metres, in the axes of the bone that they belong to, x outwards where
    there are two sides; right and left are built alike.

    limbs: (2, 2) of arm and leg, upper and lower bone. hip: (3,) from the hips' joint to a leg's.
    waist: (3,) from the hips' joint to the spine's. spine: (1,), its length. neck: (3,) from the
    chest's joint to the neck's. skull: (1,) from there to the head's. collar: (3,) from the chest's
    joint to a clavicle's. clavicle: (3,) from there to the upper arm's. level: (3,) sines of how
    far the forward axes of pelvis, chest and head, as their markers lie, rise in one who stands
    upright.
    """

    limbs: Array
    hip: Array
    waist: Array
    spine: Array
    neck: Array
    skull: Array
    collar: Array
    clavicle: Array
    level: Array


# Nobody's in particular: of upright frames of captures in training.
USUAL = Proportions(
    limbs=np.array([[0.295, 0.27], [0.43, 0.415]]),
    hip=np.array([0.092, 0.0, 0.0]),
    waist=np.array([0.0, -0.06, 0.087]),
    spine=np.array([0.26]),
    neck=np.array([0.0, 0.036, 0.195]),
    skull=np.array([0.09]),
    collar=np.array([0.025, 0.098, 0.15]),
    clavicle=np.array([0.142, -0.067, -0.017]),
    level=np.array([0.05, -0.1, 0.33]),
)


class Measuring:
    """The mean of what poses show, beginning with USUAL; or the proportions known, unchanged."""

    def __init__(self, known: Proportions | None = None) -> None:
        start = known or USUAL
        self.mean = Proportions(**{f.name: getattr(start, f.name).copy() for f in fields(start)})
        self._known = known is not None
        self._poses = 0

    def add(self, seen: Proportions) -> None:
        """Takes in what one pose shows; NaN where it shows nothing."""
        if self._known:
            return
        self._poses += 1
        gain = 1.0 / (PRIOR + self._poses if self._poses <= SETTLED else SLOW)
        for entry in fields(seen):
            mean = getattr(self.mean, entry.name)
            mean += gain * np.nan_to_num(getattr(seen, entry.name) - mean)
