"""Rotations, many at once: matrices (..., 3, 3) that turn columns, quaternions (..., 4) xyzw."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Of the four ways to take a quaternion from a matrix, in the order of its components x, y, z, w:
# the signs of the diagonal in four times that component's square, less one.
_DIAGONAL = np.array([[1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1]], float)
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def length_of(vectors: Array) -> Array:
    """The lengths (...) of vectors (..., 3)."""
    found: Array = np.sqrt(np.vecdot(vectors, vectors))
    return found


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) of length 1; none where there is no direction: zero."""
    found: Array = vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-12)
    return found


def cross(a: Array, b: Array) -> Array:
    """The cross product of (..., 3); of a few it takes an eighth of numpy's own time."""
    return a.take(_NEXT, -1) * b.take(_AFTER, -1) - a.take(_AFTER, -1) * b.take(_NEXT, -1)


def dot(a: Array, b: Array) -> Array:
    """The scalar product (..., 1) of (..., 3), to be multiplied with them."""
    found: Array = np.vecdot(a, b)[..., None]
    return found


def carried(vectors: Array, start: Array, end: Array) -> Array:
    """Vectors (..., 3) turned by the shortest turn from one unit vector to another."""
    both = start + end
    along = np.maximum(1.0 + dot(start, end), 1e-9)
    return vectors - dot(vectors, both) / along * both + 2 * dot(vectors, start) * end


def quaternions(matrices: Array) -> Array:
    """Unit quaternions (..., 4) of rotation matrices, w not negative.

    By the largest of the four components, which is never small (Shepperd 1978).
    """
    m = matrices
    skew = m[..., _AFTER, _NEXT] - m[..., _NEXT, _AFTER]  # 4 w x, 4 w y, 4 w z
    mixed = m + np.swapaxes(m, -1, -2)  # 4 x y and so on
    rows = np.empty((*m.shape[:-2], 4, 4))
    rows[..., :3, :3] = mixed
    rows[..., :3, 3] = rows[..., 3, :3] = skew
    squares = 1.0 + np.einsum("...ii->...i", m) @ _DIAGONAL.T
    np.einsum("...ii->...i", rows)[...] = squares
    flat = rows.reshape(-1, 4, 4)
    found = flat[np.arange(len(flat)), squares.argmax(axis=-1).ravel()].reshape(squares.shape)
    return unit(np.where(found[..., 3:] < 0, -found, found))


def matrices(turns: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    axis, w = turns[..., :3], turns[..., 3:]
    basis = np.broadcast_to(np.eye(3), (*turns.shape[:-1], 3, 3))
    axis, w = axis[..., None, :], w[..., None, :]
    twice = 2.0 * cross(axis, basis)
    # The rows are what each axis of the basis becomes.
    return np.swapaxes(basis + w * twice + cross(axis, twice), -1, -2)
