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
    return np.sqrt(row_mean(((_MM * (estimate.astype(float) - truth)) ** 2).sum(axis=2)))


def rms(estimate: Floats, truth: Floats) -> float | None:
    """The mean over frames of `frame_rms`."""
    return mean_known(frame_rms(estimate, truth))


def velocity_error(estimate: Floats, truth: Floats, rate: float) -> Array:
    """γ of the paper (3.4.2): the norm of the velocity's error, (N, M), mm per 1/120 s.

    Its mean is the jerkiness. rate: Hz. Velocities are those since the frame before; NaN where
    either sample is missing, and in the first frame.
    """
    error = estimate.astype(float) - truth
    gamma: Array = np.full(error.shape[:2], np.nan)
    gamma[1:] = np.linalg.norm(np.diff(error, axis=0), axis=2) * _MM * rate / _RATE
    return gamma


def roughness(estimate: Floats, truth: Floats) -> float | None:
    """Mean norm of the third difference of the estimate over that of the truth; 1 is right."""
    rough, true = (
        np.linalg.norm(np.diff(xyz.astype(float), n=3, axis=0), axis=2) for xyz in (estimate, truth)
    )
    both = ~(np.isnan(rough) | np.isnan(true))
    if not true[both].any():
        return None
    return float(rough[both].mean() / true[both].mean())


def transitions(leaves: npt.NDArray[np.integer], window: int) -> npt.NDArray[np.bool_]:
    """Which of the frames (N,) are at a change of leaf (paper 3.4.2), or up to `window` after it.

    leaves: (N,), the leaf with most votes in each frame.
    """
    changed = np.zeros(len(leaves), int)
    changed[1:] = leaves[1:] != leaves[:-1]
    before = np.concatenate([np.zeros(window + 1, int), np.cumsum(changed)])
    at_change: npt.NDArray[np.bool_] = before[window + 1 :] > before[: len(leaves)]
    return at_change


def row_mean(values: Array) -> Array:
    """Per row of (N, M) the mean of its values that are not NaN; NaN for none."""
    there = ~np.isnan(values)
    count = there.sum(axis=1)
    total = np.where(there, values, 0.0).sum(axis=1)
    mean: Array = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return mean


def mean_known(values: Array) -> float | None:
    """The mean of the values that are not NaN; None without any."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if len(there) else None
