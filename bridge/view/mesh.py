"""Triangle meshes that are made once and moved in place, and the shapes they are made of."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int32]


class Part:
    """N copies of one shape of V corners inside a mesh: views of the mesh's own arrays.

    points, normals, colours: (N, V, 3), to be written in place.
    """

    def __init__(self, mesh: Mesh, rows: slice, copies: int) -> None:
        shape = (copies, -1, 3)
        self.points = mesh.points[rows].reshape(shape)
        self.normals = mesh.normals[rows].reshape(shape)
        self.colours = mesh.colours[rows].reshape(shape)


class Mesh:
    """Points (V, 3), normals (V, 3), colours (V, 3) in 0 to 1, and triangles (T, 3).

    shapes: per part, how many copies of which shape, the shape given by its corners' number and
    its triangles.
    """

    def __init__(self, shapes: list[tuple[int, int, Triangles]]) -> None:
        starts = np.cumsum([0, *(copies * corners for copies, corners, _ in shapes)])
        self.points = np.zeros((starts[-1], 3))
        self.normals = np.zeros((starts[-1], 3))
        self.colours = np.zeros((starts[-1], 3))
        self.parts: list[Part] = []
        triangles = []
        for start, end, (copies, corners, shape) in zip(starts, starts[1:], shapes, strict=False):
            self.parts.append(Part(self, slice(start, end), copies))
            offsets = start + corners * np.arange(copies)
            triangles.append((offsets[:, None, None] + shape).reshape(-1, 3))
        self.triangles: Triangles = np.concatenate(triangles).astype(np.int32)


def sphere() -> tuple[Array, Triangles]:
    """A unit sphere of 42 corners and 80 triangles: an icosahedron, each face cut in four."""
    golden = (1 + math.sqrt(5)) / 2
    corners = [
        point
        for a in (-1.0, 1.0)
        for b in (-golden, golden)
        for point in ((0.0, a, b), (a, b, 0.0), (b, 0.0, a))
    ]
    points = np.array(corners)
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 2.1
    faces = [
        (a, b, c) if np.linalg.det(points[[a, b, c]]) > 0 else (a, c, b)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if near[a, b] and near[b, c] and near[a, c]
    ]
    middles: dict[tuple[int, int], int] = {}
    small = []
    for face in faces:
        ab, bc, ca = (
            middles.setdefault((min(a, b), max(a, b)), 12 + len(middles))
            for a, b in zip(face, (face[1], face[2], face[0]), strict=True)
        )
        a, b, c = face
        small += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    points = np.concatenate([points, [points[a] + points[b] for a, b in middles]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, np.array(small, np.int32)


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
