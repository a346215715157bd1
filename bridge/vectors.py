"""Vectors as tuples x, y, z, and rotations as three of them, for compiled functions alone.

A rotation is what it makes of the axes x, y and z: its matrix' columns. Kernels of all modules call
these, and a change here does not compile those anew (docs/decisions/0028), so they are mathematics
that stays what it is.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.compiled import inlined

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.floating]
Vector = tuple[float, float, float]
Axes = tuple[Vector, Vector, Vector]
Quaternion = tuple[float, float, float, float]


@inlined
def at(rows: Rows, row: int) -> Vector:
    """A row of (N, 3)."""
    return float(rows[row, 0]), float(rows[row, 1]), float(rows[row, 2])


@inlined
def put(rows: Rows, row: int, a: Vector) -> None:
    """Writes a row of (N, 3)."""
    rows[row, 0], rows[row, 1], rows[row, 2] = a


@inlined
def axes_at(rows: Array) -> Axes:
    """A rotation of which the rows (3, 3) are the axes."""
    return at(rows, 0), at(rows, 1), at(rows, 2)


@inlined
def put_axes(rows: Array, axes: Axes) -> None:
    """Writes a rotation's axes as rows (3, 3)."""
    put(rows, 0, axes[0])
    put(rows, 1, axes[1])
    put(rows, 2, axes[2])


@inlined
def plus(a: Vector, b: Vector) -> Vector:
    """The sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a: Vector, b: Vector) -> Vector:
    """The difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def times(share: float, a: Vector) -> Vector:
    """A vector so many times as long."""
    return share * a[0], share * a[1], share * a[2]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """The vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@inlined
def length(a: Vector) -> float:
    """How long a vector is."""
    return math.sqrt(dot(a, a))


@inlined
def unit(a: Vector) -> Vector:
    """Of length 1; where there is no direction, zero."""
    return times(1.0 / max(length(a), 1e-12), a)


@inlined
def across(a: Vector, along: Vector) -> Vector:
    """What of a vector is at right angles to a unit vector."""
    return minus(a, times(dot(a, along), along))


@inlined
def about_z(yaw: float) -> Axes:
    """The rotation about z."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    return (cos, sin, 0.0), (-sin, cos, 0.0), (0.0, 0.0, 1.0)


@inlined
def turned(turn: Axes, a: Vector) -> Vector:
    """A vector turned by a rotation."""
    return plus(plus(times(a[0], turn[0]), times(a[1], turn[1])), times(a[2], turn[2]))


@inlined
def seen_in(axes: Axes, a: Vector) -> Vector:
    """A vector in these axes: turned back by the rotation."""
    return dot(axes[0], a), dot(axes[1], a), dot(axes[2], a)


@inlined
def lowered(turn: Axes, sine: float) -> Axes:
    """A rotation, turned about its own x so that what rises forward by this sine is level then."""
    x, y, z = turn
    cosine = math.sqrt(1.0 - sine * sine)
    return x, minus(times(cosine, y), times(sine, z)), plus(times(sine, y), times(cosine, z))


@inlined
def carried(a: Vector, start: Vector, end: Vector) -> Vector:
    """A vector turned by the shortest turn from one unit vector to another."""
    both = plus(start, end)
    along = max(1.0 + dot(start, end), 1e-9)
    back = times(dot(a, both) / along, both)
    return plus(minus(a, back), times(2.0 * dot(a, start), end))


@inlined
def quaternion(turn: Axes) -> Quaternion:
    """x, y, z, w of a rotation; w is not negative.

    By the largest of the four components, which is never small (Shepperd 1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn
    # Four times each component's square.
    x2, y2 = 1.0 + xx - yy - zz, 1.0 - xx + yy - zz
    z2, w2 = 1.0 - xx - yy + zz, 1.0 + xx + yy + zz
    if x2 >= y2 and x2 >= z2 and x2 >= w2:
        x, y, z, w = x2, xy + yx, xz + zx, yz - zy
    elif y2 >= z2 and y2 >= w2:
        x, y, z, w = xy + yx, y2, yz + zy, zx - xz
    elif z2 >= w2:
        x, y, z, w = xz + zx, yz + zy, z2, xy - yx
    else:
        x, y, z, w = yz - zy, zx - xz, xy - yx, w2
    share = 1.0 / max(math.sqrt(x * x + y * y + z * z + w * w), 1e-12)
    if w < 0.0:
        share = -share
    return share * x, share * y, share * z, share * w


@inlined
def turn_at(rows: Rows, row: int) -> Quaternion:
    """A row of (N, 4)."""
    return float(rows[row, 0]), float(rows[row, 1]), float(rows[row, 2]), float(rows[row, 3])


@inlined
def put_turn(rows: Rows, row: int, turn: Quaternion) -> None:
    """Writes a row of (N, 4)."""
    rows[row, 0], rows[row, 1], rows[row, 2], rows[row, 3] = turn


@inlined
def opposite(turn: Quaternion) -> Quaternion:
    """The rotation back."""
    return -turn[0], -turn[1], -turn[2], turn[3]


@inlined
def after(last: Quaternion, first: Quaternion) -> Quaternion:
    """One rotation after another, as one."""
    x, y, z, w = last
    a, b, c, d = first
    return (
        w * a + x * d + y * c - z * b,
        w * b - x * c + y * d + z * a,
        w * c + x * b - y * a + z * d,
        w * d - x * a - y * b - z * c,
    )


@inlined
def spun(turn: Quaternion, a: Vector) -> Vector:
    """A vector turned by a rotation that is a unit quaternion."""
    axis = turn[0], turn[1], turn[2]
    twice = times(2.0, cross(axis, a))
    return plus(plus(a, times(turn[3], twice)), cross(axis, twice))


@inlined
def blended(start: Quaternion, end: Quaternion, share: float) -> Quaternion:
    """A unit quaternion so far on the way to another, the shorter way round."""
    x, y, z, w = start
    a, b, c, d = end
    sign = 1.0 if x * a + y * b + z * c + w * d >= 0.0 else -1.0
    x, y = x + share * (sign * a - x), y + share * (sign * b - y)
    z, w = z + share * (sign * c - z), w + share * (sign * d - w)
    scale = 1.0 / max(math.sqrt(x * x + y * y + z * z + w * w), 1e-12)
    return scale * x, scale * y, scale * z, scale * w
