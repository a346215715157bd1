"""Linear maps from the tracked to the unworn markers, one per leaf (paper 3.2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from training.moments import ONE

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Sums over frames, all that least squares needs: xx (D, D), zx (U, D), their weight.

    Adding them is pooling frames. An affine map is a linear one of x with a last entry of 1.
    """

    xx: Array
    zx: Array
    weight: float

    @classmethod
    def of(cls, x: npt.NDArray[np.floating], z: npt.NDArray[np.floating]) -> NormalEquations:
        """Of frames x (N, D) and z (N, U), each of them weighing 1."""
        inputs, outputs = x.astype(float), z.astype(float)
        return cls(inputs.T @ inputs, outputs.T @ inputs, len(x))

    @classmethod
    def between(cls, whole: Array, x: Columns, z: Columns) -> NormalEquations:
        """Of the columns x and z of a matrix (D, D) of sums of products."""
        return cls(whole[np.ix_(x, x)], whole[np.ix_(z, x)], float(whole[ONE, ONE]))

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.xx + other.xx, self.zx + other.zx, self.weight + other.weight)

    def scaled(self, weight: float) -> NormalEquations:
        """The same frames, weighing `weight` together."""
        factor = weight / self.weight
        return NormalEquations(factor * self.xx, factor * self.zx, weight)


def affine(x: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """The rows (N, D) with a last column of ones."""
    return np.hstack([x, np.ones((len(x), 1), x.dtype)])


def least_squares(equations: NormalEquations) -> Array:
    """B (U, D), the paper's Z X^T (X X^T)^-1; the smallest B where the frames leave it open."""
    return _solve(equations.xx, equations.zx)


def ridge(equations: NormalEquations, noise: float) -> Array:
    """[B c] (U, D + 1) of affine frames, B held back as if x were measured with `noise` metres.

    The constant is free.
    """
    penalty = np.full(len(equations.xx), equations.weight * noise**2)
    penalty[-1] = 0.0
    return _solve(equations.xx + np.diag(penalty), equations.zx)


def shrunk(leaf: NormalEquations, everything: NormalEquations, share: float, noise: float) -> Array:
    """[B c] of one leaf, shrunk towards the global map.

    The frames of all leaves are pooled with the leaf's own, weighing `share` of them together: a
    direction that the leaf has not seen follows the global map, one that it has seen is its own.
    """
    return ridge(leaf + everything.scaled(share * leaf.weight), noise)


def _solve(xx: Array, zx: Array) -> Array:
    return np.asarray(np.linalg.lstsq(xx, zx.T)[0].T, float)
