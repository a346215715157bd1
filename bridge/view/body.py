"""One body: a sphere per marker, sticks or bones between them, a shadow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.humanoid.rotations import cross, dot, unit
from bridge.humanoid.skeleton import BONES, PARENTS, ROW
from bridge.view import mesh
from bridge.view.camera import Camera
from bridge.view.colours import Colour
from bridge.view.mesh import Array, Part, Triangles, or_nothing
from drivers.frame import Floats

# Metres.
RADIUS, LARGEST = 0.020, 0.065  # of a sphere
_SURER = 0.8  # of sigma, added to the radius as errors add
_STICK = 0.0115
_BONE_THIN, _BONE_THICK = 0.014, 0.05
_SHADOW_SLOPE = np.array([0.35, 0.25])  # how far a shadow falls aside per height
_ABOVE = 0.004  # the floor

_DOME, _DOME_TRIANGLES = mesh.dome()
_SIDES = 6
_RING = mesh.circle(_SIDES)[0]
_TUBE = mesh.tube(_SIDES)
_QUAD = mesh.fan(4)
_BONE_POINTS, _BONE_NORMALS, _BONE_TRIANGLES = mesh.octahedron()

# Bones go from a joint to each of its children's; where there is none, so far in the rest pose,
# for hips a metre high.
_LEAVES = {
    "Head": (0.0, 0.03, 0.19),
    "LeftHand": (-0.17, 0.0, 0.0),
    "RightHand": (0.17, 0.0, 0.0),
    "LeftFoot": (0.0, 0.18, -0.06),
    "RightFoot": (0.0, 0.18, -0.06),
}
_CHILDREN = np.array([row for row in range(len(BONES)) if PARENTS[row] >= 0])
_ENDS = np.array([ROW[name] for name in _LEAVES])
_OWNERS = np.concatenate([PARENTS[_CHILDREN], _ENDS])
_REACHES = np.array(list(_LEAVES.values()))
_STOUT = np.where(np.isin(_OWNERS, ROW["Head"]), 0.3, 0.13)[:, None]  # how thick for its length
# The direction of the rest pose that a bone's thickness keeps to: no bone goes along it.
_SIDE = np.array(
    [[0.0, 0.0, 1.0] if "Foot" in BONES[owner] else [0.0, 1.0, 0.0] for owner in _OWNERS]
)


class Colours(NamedTuple):
    """Of the markers' spheres (M, 3), and of the ends of sticks at each marker (M, 3)."""

    markers: Array
    sticks: Array


class Bones(NamedTuple):
    """A humanoid in the rig: joints (B, 3), rotations as matrices (B, 3, 3), how high the hips are
    in the rest pose; metres.
    """

    joints: Array
    turned: Array
    height: float


class Body:
    """ends: (S, 2), the markers at the ends of each stick."""

    @staticmethod
    def shapes(markers: int, sticks: int) -> list[tuple[int, int, Triangles]]:
        """The parts of a mesh that it takes."""
        return [
            (markers, len(_DOME), _DOME_TRIANGLES),
            (sticks, 2 * _SIDES, _TUBE),
            (len(_OWNERS), len(_BONE_POINTS), _BONE_TRIANGLES),
        ]

    @staticmethod
    def shadow_shapes(sticks: int) -> tuple[int, int, Triangles]:
        """The part that its shadow takes."""
        return (sticks, 4, _QUAD)

    def __init__(self, ends: npt.NDArray[np.intp], parts: list[Part], shadow: Part) -> None:
        self._ends, self._shadow = ends, shadow
        self._spheres, self._sticks, self._bones = parts
        self.places = np.full((len(self._spheres.points), 3), np.nan)
        self.radii = np.full(len(self.places), RADIUS)

    def place(self, xyz: Array, sigma: Floats | None, colours: Colours, camera: Camera) -> None:
        """Markers (M, 3) in the rig, and their sigma (M,) where it is shown; metres."""
        self.places = xyz
        self.radii[:] = RADIUS
        if sigma is not None:
            grown = np.hypot(RADIUS, _SURER * np.nan_to_num(sigma, posinf=LARGEST))
            self.radii[:] = np.minimum(grown, LARGEST)
        # Of a sphere no more is drawn than the camera sees.
        seen = _DOME @ camera.axes
        self._spheres.points[:] = or_nothing(xyz[:, None] + self.radii[:, None, None] * seen)
        self._spheres.colours[:] = mesh.lit(colours.markers[:, None], _DOME)
        self._place_shadow(xyz)
        self._sticks.points[:] = self._bones.points[:] = 0.0

    def join(self, colours: Colours, camera: Camera) -> None:
        """Sticks between the markers."""
        a, b = self.places[self._ends[:, 0]], self.places[self._ends[:, 1]]
        along = unit(b - a)
        upright = np.abs(along[:, 2:]) > 0.9
        across = unit(cross(along, np.where(upright, [1.0, 0, 0], [0, 0, 1.0])))
        ring = _RING @ np.stack([across, cross(along, across)], axis=1)
        points = np.concatenate([a[:, None] + _STICK * ring, b[:, None] + _STICK * ring], axis=1)
        self._sticks.points[:] = or_nothing(points)
        normals = np.nan_to_num(ring) @ camera.axes.T
        for end, corners in enumerate((slice(_SIDES), slice(_SIDES, None))):
            own = 0.85 * colours.sticks[self._ends[:, end], None]
            self._sticks.colours[:, corners] = mesh.lit(own, normals)

    def join_bones(self, bones: Bones, colour: Colour, camera: Camera) -> None:
        """The humanoid's bones, in place of sticks."""
        joints, turned, height = bones
        reaches = (turned[_ENDS] @ (height * _REACHES)[..., None])[..., 0]
        start = joints[_OWNERS]
        way = np.concatenate([joints[_CHILDREN], joints[_ENDS] + reaches]) - start
        length = np.maximum(np.sqrt(dot(way, way)), 1e-6)
        along = way / length
        side = (turned[_OWNERS] @ _SIDE[..., None])[..., 0]
        side = unit(side - dot(side, along) * along)
        thick = np.clip(_STOUT * length, _BONE_THIN, _BONE_THICK)
        across = cross(along, side)
        axes = np.stack([thick * across, way, thick * side], axis=1)
        self._bones.points[:] = or_nothing(start[:, None] + _BONE_POINTS @ axes)
        # Normals go by the inverse of what the corners go by.
        inverse = np.stack([across / thick, along / length, side / thick], axis=1)
        normals = np.nan_to_num(unit(_BONE_NORMALS @ inverse)) @ camera.axes.T
        self._bones.colours[:] = mesh.lit(0.85 * np.array(colour), normals)

    def _place_shadow(self, xyz: Array) -> None:
        floor = xyz[:, :2] + xyz[:, 2:] * _SHADOW_SLOPE
        a, b = floor[self._ends[:, 0]], floor[self._ends[:, 1]]
        way = b - a
        across = way[:, ::-1] * [-_STICK, _STICK]
        across /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        corners = np.full((len(a), 4, 3), _ABOVE)
        corners[:, :, :2] = np.stack([a - across, b - across, b + across, a + across], axis=1)
        self._shadow.points[:] = or_nothing(corners)
