"""Triangle meshes that are made once and moved in place, and the shapes they are made of."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int32]

THICKEST = 0.2  # of a bone's length

_LAMP = np.array([-0.35, 0.55, 0.76])  # where it is, as normals are given
_BETWEEN = np.array([-0.19, 0.29, 0.94])  # half way from there to the viewer
_DARKEST, _BRIGHTEST, _GLOSS = 0.4, 1.15, 0.25


class Part:
    """N copies of one shape of V corners inside a mesh: views of the mesh's own arrays.

    points, colours: (N, V, 3), to be written in place.
    """

    def __init__(self, mesh: Mesh, rows: slice, copies: int, corners: int) -> None:
        shape = (copies, corners, 3)
        self.points = mesh.points[rows].reshape(shape)
        self.colours = mesh.colours[rows].reshape(shape)


class Mesh:
    """Points (V, 3), colours (V, 3) in 0 to 1, and triangles (T, 3).

    shapes: per part, how many copies of which shape, the shape given by its corners' number and
    its triangles.
    """

    def __init__(self, shapes: list[tuple[int, int, Triangles]]) -> None:
        starts = np.cumsum([0, *(copies * corners for copies, corners, _ in shapes)])
        self.points = np.zeros((starts[-1], 3))
        self.colours = np.zeros((starts[-1], 3))
        self.parts: list[Part] = []
        triangles = []
        for start, end, (copies, corners, shape) in zip(starts, starts[1:], shapes, strict=False):
            self.parts.append(Part(self, slice(start, end), copies, corners))
            offsets = start + corners * np.arange(copies)
            triangles.append((offsets[:, None, None] + shape).reshape(-1, 3))
        self.triangles: Triangles = np.concatenate(triangles).astype(np.int32)


def or_nothing(points: Array) -> Array:
    """Shapes (N, V, 3) with those that are not wholly known shrunk to a point: they vanish."""
    known = np.isfinite(points).all(axis=(1, 2), keepdims=True)
    return np.where(known, points, 0.0)


def lit(colours: Array, normals: Array) -> Array:
    """Colours (..., 3) as a lamp shows them that is over the viewer's left shoulder.

    normals: (..., 3) to the right, up, and back to the viewer. Shaded here and not by Open3D, whose
    four lamps take a software renderer twice as long as all else.
    """
    bright = _DARKEST + (_BRIGHTEST - _DARKEST) * np.maximum(normals @ _LAMP, 0.0)
    gloss = _GLOSS * np.maximum(normals @ _BETWEEN, 0.0) ** 16
    shown: Array = np.minimum(colours * bright[..., None] + gloss[..., None], 1.0)
    return shown


def dome() -> tuple[Array, Triangles]:
    """The half of a unit sphere that is seen from z: 25 corners in two rings, 32 triangles."""
    half, rim = circle(8)[0] * math.sqrt(0.5), circle(16)[0]
    points = np.zeros((25, 3))
    points[0, 2] = 1.0
    points[1:9, :2], points[1:9, 2] = half, math.sqrt(0.5)
    points[9:, :2] = rim
    triangles = []
    for near in range(8):
        after = (near + 1) % 8
        out, between, out_after = 2 * near, 2 * near + 1, 2 * after
        triangles += [(0, 1 + near, 1 + after), (1 + near, 9 + out, 9 + between)]
        triangles += [(1 + near, 9 + between, 1 + after), (1 + after, 9 + between, 9 + out_after)]
    return points, np.array(triangles, np.int32)


def circle(corners: int) -> tuple[Array, Triangles]:
    """A unit circle in the plane (corners, 2), and the triangles that fill it."""
    angles = np.arange(corners) * math.tau / corners
    return np.stack([np.cos(angles), np.sin(angles)], axis=1), fan(corners)


def fan(corners: int) -> Triangles:
    """The triangles that fill a convex polygon whose corners run counter-clockwise."""
    rest = np.arange(1, corners - 1)
    return np.stack([np.zeros_like(rest), rest, rest + 1], axis=1).astype(np.int32)


def tube(sides: int) -> Triangles:
    """The triangles of an open tube: `sides` corners at one end, then as many at the other."""
    near = np.arange(sides)
    following = (near + 1) % sides
    far, far_following = near + sides, following + sides
    quads = [(near, following, far_following), (near, far_following, far)]
    return np.concatenate([np.stack(quad, axis=1) for quad in quads]).astype(np.int32)


def octahedron() -> tuple[Array, Array, Triangles]:
    """A bone along y, from 0 to 1, one wide to both sides in x and z where it is thickest.

    Its corners (24, 3), each face having its own, their normals for one that is as long as it is
    wide, and its triangles.
    """
    root, tip = np.zeros(3), np.array([0.0, 1.0, 0.0])
    ring = [np.array([x, THICKEST, z]) for x, z in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    faces = []
    for a, b in zip(ring, ring[1:] + ring[:1], strict=True):
        faces += [(root, a, b), (tip, b, a)]
    points = np.array(faces)
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    triangles = np.arange(24).reshape(8, 3).astype(np.int32)
    return points.reshape(-1, 3), np.repeat(normals, 3, axis=0), triangles
