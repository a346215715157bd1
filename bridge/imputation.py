"""Missing tracked markers, filled in from those present: conditional Gaussian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats

PATTERNS = 512  # of missing markers that are kept; nine tracked markers have no more
_NOISE = 0.005  # m: no coordinate is predicted from the others more finely than this


@dataclass(frozen=True, slots=True)
class _Conditional:
    """What one pattern of missing markers needs, computed when the pattern first comes up."""

    missing: npt.NDArray[np.bool_]  # (D,)
    gain: Floats  # (missing, present)
    offset: Floats  # (missing,)
    covariance: npt.NDArray[np.float64]  # (D, D), zero where present


class ConditionalGaussian:
    """Markers in the body frame as one Gaussian; the missing ones by their conditional mean.

    mean: (F, 3) metres; covariance: (3F, 3F) m².
    """

    def __init__(self, mean: npt.ArrayLike, covariance: npt.ArrayLike) -> None:
        self._mean = np.array(mean, float).ravel()
        self._covariance = np.array(covariance, float) + _NOISE**2 * np.eye(len(self._mean))
        self._cache: dict[bytes, _Conditional] = {}

    def fill(self, xyz: Floats, present: npt.NDArray[np.bool_]) -> Floats:
        """The markers (F, 3) with the rows that are not present (F,) filled in."""
        if present.all():
            return xyz
        conditional = self._conditional(present)
        filled = xyz.ravel().copy()
        known = filled[~conditional.missing]
        filled[conditional.missing] = conditional.gain @ known + conditional.offset
        return filled.reshape(-1, 3)

    def uncertainty(self, present: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """Covariance (3F, 3F) of the filled-in coordinates; zero for those present."""
        return self._conditional(present).covariance

    def _conditional(self, present: npt.NDArray[np.bool_]) -> _Conditional:
        key = present.tobytes()
        if key not in self._cache:
            if len(self._cache) >= PATTERNS:
                self._cache.clear()
            known = np.repeat(present, 3)
            missing = ~known
            across = self._covariance[np.ix_(missing, known)]
            gain = np.linalg.solve(self._covariance[np.ix_(known, known)], across.T).T
            covariance = np.zeros_like(self._covariance)
            covariance[np.ix_(missing, missing)] = (
                self._covariance[np.ix_(missing, missing)] - gain @ across.T
            )
            offset = self._mean[missing] - gain @ self._mean[known]
            self._cache[key] = _Conditional(
                missing, gain.astype(np.float32), offset.astype(np.float32), covariance
            )
        return self._cache[key]


class Imputation(Protocol):
    """A way to fill in missing markers, frame after frame."""

    def reset(self) -> None:
        """Forgets the past: a new performer or sequence."""

    def fill(self, xyz: Floats, present: npt.NDArray[np.bool_], interval: float) -> Floats:
        """The next frame's markers (F, 3), in the body frame, with the missing ones filled in.

        present: (F,); interval: seconds since the frame before.
        """
