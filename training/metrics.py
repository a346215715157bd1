"""How far an estimate is from the truth: errors in mm, as the design defines them.

All functions take one sequence, estimate and truth (N, M, 3) in metres; a missing marker of either
(NaN) is left out. They return None where nothing is there to be scored.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats

Array = npt.NDArray[np.float64]
_MM = 1000.0
_RATE = 120.0  # Hz: velocities are per frame of this rate


def frame_rms(estimate: Floats, truth: Floats) -> Array:
    """Per frame (N,) the root of the mean squared distance over its markers, mm; NaN for none."""
    squared = ((_MM * (estimate.astype(float) - truth)) ** 2).sum(axis=2)
    there = ~np.isnan(squared)
    count = there.sum(axis=1)
    total = np.where(there, squared, 0.0).sum(axis=1)
    mean: Array = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return np.sqrt(mean)


def rms(estimate: Floats, truth: Floats) -> float | None:
    """The mean over frames of `frame_rms`."""
    return mean_known(frame_rms(estimate, truth))


def jerk(estimate: Floats, truth: Floats, rate: float) -> float | None:
    """Jerkiness (paper 3.4.2): mean norm of the velocity's error, mm per 1/120 s."""
    error = np.diff(estimate.astype(float), axis=0) - np.diff(truth.astype(float), axis=0)
    mean = mean_known(np.linalg.norm(error, axis=2))
    return None if mean is None else mean * _MM * rate / _RATE


def roughness(estimate: Floats, truth: Floats) -> float | None:
    """Mean norm of the third difference of the estimate over that of the truth; 1 is right."""
    rough, true = (
        np.linalg.norm(np.diff(xyz.astype(float), n=3, axis=0), axis=2) for xyz in (estimate, truth)
    )
    both = ~(np.isnan(rough) | np.isnan(true))
    if not true[both].any():
        return None
    return float(rough[both].mean() / true[both].mean())


def mean_known(values: Array) -> float | None:
    """The mean of the values that are not NaN; None without any."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if len(there) else None
