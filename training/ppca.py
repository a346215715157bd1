"""Probabilistic principal component analysis (Tipping and Bishop 1999): a Gaussian with few free
directions, and one variance for all others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Of some frames (n, D): how many, their sum (D,), and the sum of their outer products (D, D).

    Adding them is pooling the frames.
    """

    count: int
    first: Array
    second: Array

    @classmethod
    def of(cls, frames: npt.NDArray[np.floating]) -> Sums:
        rows = frames.astype(float)
        return cls(len(rows), rows.sum(axis=0), rows.T @ rows)

    def __add__(self, other: Sums) -> Sums:
        return Sums(self.count + other.count, self.first + other.first, self.second + other.second)

    def __sub__(self, other: Sums) -> Sums:
        return Sums(self.count - other.count, self.first - other.first, self.second - other.second)


@dataclass(frozen=True, slots=True, eq=False)
class Ppca:
    """The fitted model. mean: (D,); axes: (D, free), the free directions in columns, largest
    variance first; variances: (D,), those of the free directions as they are, then the noise.
    """

    mean: Array
    axes: Array
    variances: Array
    free: int

    @classmethod
    def of(cls, sums: Sums, variance: float, floor: float = 0.0) -> Ppca:
        """Fits the frames. The free directions are the fewest that hold this share of the variance;
        no variance is below that of `floor`, in the frames' unit.
        """
        mean = sums.first / sums.count
        values, axes = np.linalg.eigh(sums.second / sums.count - np.outer(mean, mean))
        values = np.maximum(values[::-1], 0.0)
        free = components_for(values, variance)
        noise = max(float(values[free:].mean()) if free < len(values) else 0.0, floor**2)
        variances = np.full(len(values), noise)
        variances[:free] = np.maximum(values[:free], noise)
        return cls(mean, axes[:, : -free - 1 : -1], variances, free)

    def distance(self, frames: Sums) -> float:
        """H: mean squared Mahalanobis distance of frames per coordinate; 1 for frames of the same
        Gaussian.
        """
        # About the mean: E[(x - m)²] = E[x²] - 2 m E[x] + m², along each free axis and in all.
        mean, seen = self.mean, frames.first / frames.count
        along, seen_along = mean @ self.axes, seen @ self.axes
        spread = (self.axes * (frames.second @ self.axes)).sum(axis=0) / frames.count
        spread += along * (along - 2 * seen_along)
        total = np.trace(frames.second) / frames.count + mean @ (mean - 2 * seen)
        # The other directions have one variance: which they are does not matter.
        others = (total - spread.sum()) / self.variances[-1]
        return float(((spread / self.variances[: self.free]).sum() + others) / len(mean))


def components_for(variances: Array, share: float) -> int:
    """How many of the variances (D,), largest first, it takes to hold this share of their sum."""
    total = float(variances.sum())
    return min(1 + int(np.searchsorted(np.cumsum(variances), share * total)), len(variances))
