"""Linear maps from the tracked to the unworn markers, one per leaf (paper 3.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Sums over frames, all that least squares needs: xx (D, D), zx (U, D), their weight.

    Adding moments is pooling frames. An affine map is a linear one of x with a last entry of 1.
    """

    xx: Array
    zx: Array
    weight: float

    @classmethod
    def of(cls, x: npt.NDArray[np.floating], z: npt.NDArray[np.floating]) -> Moments:
        """Of frames x (N, D) and z (N, U), each of them weighing 1."""
        inputs, outputs = x.astype(float), z.astype(float)
        return cls(inputs.T @ inputs, outputs.T @ inputs, len(x))

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.xx + other.xx, self.zx + other.zx, self.weight + other.weight)

    def scaled(self, weight: float) -> Moments:
        """The same frames, weighing `weight` together."""
        factor = weight / self.weight
        return Moments(factor * self.xx, factor * self.zx, weight)


def affine(x: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The rows (N, D) with a last column of ones."""
    return np.hstack([x, np.ones((len(x), 1), x.dtype)])


def least_squares(moments: Moments) -> Array:
    """B (U, D), the paper's Z X^T (X X^T)^-1; the smallest B where the frames leave it open."""
    return _solve(moments.xx, moments.zx)


def ridge(moments: Moments, noise: float) -> Array:
    """[B c] (U, D + 1) of affine frames, B held back as if x were measured with `noise` metres.

    The constant is free.
    """
    penalty = np.full(len(moments.xx), moments.weight * noise**2)
    penalty[-1] = 0.0
    return _solve(moments.xx + np.diag(penalty), moments.zx)


def shrunk(leaf: Moments, everything: Moments, share: float, noise: float) -> Array:
    """[B c] of one leaf, shrunk towards the global map.

    The frames of all leaves are pooled with the leaf's own, weighing `share` of them together: a
    direction that the leaf has not seen follows the global map, one that it has seen is its own.
    """
    return ridge(leaf + everything.scaled(share * leaf.weight), noise)


def _solve(xx: Array, zx: Array) -> Array:
    return np.asarray(np.linalg.lstsq(xx, zx.T)[0].T, float)
