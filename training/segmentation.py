"""Cuts a capture where its behaviour changes: probabilistic PCA (paper 3.2.2, Barbic 2004).

A Gaussian with few free directions is fitted to the frames since the last cut. While the behaviour
lasts, the frames just ahead lie well inside it, the better the more has been seen of it; their
mean Mahalanobis distance H falls. Where the behaviour changes, H climbs to a peak: there is a cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Segmentation:
    """How to cut. Times in seconds.

    first: frames that a behaviour is first fitted to. ahead: frames that are judged by it. step: by
    how much the fit grows. variance: share of the variance that the free directions hold. rise: by
    what factor H must climb from its valley to its peak for a cut. floor: metres, below which
    variance across the free directions is measurement noise.
    """

    first: float = 1.0
    ahead: float = 0.75
    step: float = 1 / 12
    variance: float = 0.95
    rise: float = 3.0
    floor: float = 0.003

    def cut(self, poses: npt.NDArray[np.floating], rate: float) -> list[slice]:
        """The segments of one sequence (N, D), in order and without gaps."""
        block = max(1, round(self.step * rate))
        moments = _Moments(poses, block)
        first, ahead = (max(1, round(t * rate / block)) for t in (self.first, self.ahead))
        cuts = [0]
        while (cut := self._next_cut(moments, cuts[-1], first, ahead)) is not None:
            cuts.append(cut)
        edges = [cut * block for cut in cuts] + [len(poses)]
        return [slice(a, b) for a, b in pairwise(edges)]

    def _next_cut(self, moments: _Moments, start: int, first: int, ahead: int) -> int | None:
        """The block where the behaviour that starts at block `start` ends; None: it does not."""
        valley, peak, at = np.inf, 0.0, 0
        for now in range(start + first, moments.blocks - ahead + 1):
            distance = self.distance(moments.between(start, now), moments.between(now, now + ahead))
            if distance > peak and distance > self.rise * valley:
                peak, at = distance, now
            elif peak:
                # Past the peak. What comes next must be long enough to be fitted itself.
                return at if moments.blocks - at >= first else None
            valley = min(valley, distance)
        return None

    def distance(self, fitted: tuple[Array, Array], ahead: tuple[Array, Array]) -> float:
        """H: mean squared Mahalanobis distance per coordinate of frames ahead from a fitted model.

        Both are (mean (D,), second moment (D, D)). The model is probabilistic PCA: its largest
        directions as they are, one variance for all others. 1 for frames of the same Gaussian.
        """
        mean, second = fitted
        values, axes = np.linalg.eigh(second - np.outer(mean, mean))
        values = np.maximum(values[::-1], 0.0)
        axes = axes[:, ::-1]
        free = 1 + int(np.searchsorted(np.cumsum(values), self.variance * values.sum()))
        noise = max(float(values[free:].mean()) if free < len(values) else 0.0, self.floor**2)
        variances = np.full(len(values), noise)
        variances[:free] = np.maximum(values[:free], noise)
        ahead_mean, ahead_second = ahead
        about = ahead_second - np.outer(mean, ahead_mean) - np.outer(ahead_mean, mean)
        about += np.outer(mean, mean)
        spread = np.einsum("ij,ik,kj->j", axes, about, axes, optimize=True)
        return float((spread / variances).mean())


class _Moments:
    """Mean and second moment of any run of blocks, from cumulative sums: no pass per question."""

    def __init__(self, poses: npt.NDArray[np.floating], block: int) -> None:
        self.blocks = len(poses) // block
        self._block = block
        frames = poses[: self.blocks * block].astype(float)
        frames = frames.reshape(self.blocks, block, poses.shape[1])
        self._first = _cumulated(frames.sum(axis=1))
        self._second = _cumulated(frames.transpose(0, 2, 1) @ frames)

    def between(self, start: int, end: int) -> tuple[Array, Array]:
        count = (end - start) * self._block
        first: Array = (self._first[end] - self._first[start]) / count
        second: Array = (self._second[end] - self._second[start]) / count
        return first, second


def _cumulated(parts: Array) -> Array:
    return np.concatenate([np.zeros_like(parts[:1]), np.cumsum(parts, axis=0)])
