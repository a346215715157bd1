"""How a performer's humanoid is built: what stays the same while they move.

Measured on the markers of poses and averaged, so that a bone has one length: it settles within a
second, and after that follows another performer within minutes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PRIOR = 30  # poses that the usual proportions count as much as
SETTLED = 120  # poses until one counts as little as ever
SLOW = 12_000  # poses that the mean goes back over from then on: 100 s
EVERY = 8  # then one pose in so many is looked at


class Proportions:
    """Lengths and places in metres, in the axes of the bone that they belong to, x outwards where
    there are two sides; right and left are built alike.

    limbs: (2, 2) of arm and leg, upper and lower bone. hip: (3,) from the hips' joint to a leg's.
    waist: (3,) from the hips' joint to the spine's. spine: its length. neck: (3,) from the chest's
    joint to the neck's. skull: from there to the head's. collar: (3,) from the chest's joint to a
    clavicle's. clavicle: (3,) from there to the upper arm's. level: (3,) sines of how far the
    forward axes of pelvis, chest and head, as their markers lie, rise in one who stands upright.
    All are views of `values` (24,), in this order.
    """

    def __init__(self, values: Array) -> None:
        self.values = np.array(values, float)
        self.limbs = self.values[:4].reshape(2, 2)
        self.hip, self.waist = self.values[4:7], self.values[7:10]
        self.neck = self.values[11:14]
        self.collar, self.clavicle = self.values[15:18], self.values[18:21]
        self.level = self.values[21:]

    @property
    def spine(self) -> float:
        return float(self.values[10])

    @property
    def skull(self) -> float:
        return float(self.values[14])


# Nobody's in particular: the mean of the captures of people in training.
USUAL = (
    *((0.295, 0.27), (0.43, 0.415)),
    (0.092, 0.0, 0.0),
    (0.0, -0.06, 0.087),
    (0.26,),
    (0.0, 0.036, 0.195),
    (0.09,),
    (0.025, 0.098, 0.15),
    (0.142, -0.067, -0.017),
    (0.05, -0.1, 0.33),
)
COUNT = sum(map(len, USUAL))


class Measuring:
    """The mean of what poses show, beginning with USUAL; or the proportions known, unchanged."""

    def __init__(self, known: Proportions | None = None) -> None:
        self.mean = Proportions(known.values if known else np.concatenate(USUAL))
        self._known = known is not None
        self._poses = 0

    def due(self) -> bool:
        """Counts a pose; whether to look at it."""
        self._poses += 1
        return not self._known and (self._poses <= SETTLED or self._poses % EVERY == 0)

    def add(self, shown: Array) -> None:
        """Takes in what one pose shows (24,); NaN where it shows nothing."""
        gain = 1.0 / (PRIOR + self._poses) if self._poses <= SETTLED else EVERY / SLOW
        values = self.mean.values
        values += gain * np.where(np.isnan(shown), 0.0, shown - values)
