"""The pose: what the estimator gives and every sink takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from bridge.humanoid.skeleton import Posture
from drivers.frame import Floats


class Provenance(IntEnum):
    """Where a marker's position comes from."""

    MEASURED = 0
    IMPUTED = 1  # tracked, but missing now
    ESTIMATED = 2  # nobody wears it
    LOST = 3  # nothing is known any more; the position is the last one, or NaN before the first


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """The whole body at one moment.

    index, t: the marker frame's. xyz: (M, 3) float32 metres, world, in the model's marker order.
    provenance: (M,) uint8 of Provenance. sigma: (M,) float32, standard deviation of the error per
    coordinate, metres. posture: the humanoid of these markers; None where no sink wants it, and
    until all of them are known. performer: whose it is; empty where there is one alone. t_mapped,
    t_parsed: the frame's; t_estimated: seconds on the host's clock when the pose was known.
    """

    index: int
    t: float
    xyz: Floats
    provenance: npt.NDArray[np.uint8]
    sigma: Floats
    posture: Posture | None = None
    performer: str = ""
    t_mapped: float = math.nan
    t_parsed: float = math.nan
    t_estimated: float = math.nan

    def lost(self, t: float) -> Pose:
        """The same at a later time, when nothing is known any more."""
        unknown = np.full_like(self.sigma, np.inf)
        posture = self.posture
        if posture is not None:
            posture = replace(posture, sigma=np.full_like(posture.sigma, np.inf))
        lost = np.full_like(self.provenance, Provenance.LOST)
        return replace(self, t=t, provenance=lost, sigma=unknown, posture=posture)
