"""Named frames of coordinates: how another program's world relates to ours.

Ours: metres, right-handed, Z up; read as x to the right, y forward, z up. Where an engine has a
forward, its forward is our y. Golden vectors: tests/drivers/test_coordinates.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivers.frame import Floats

UNITS = {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}


@dataclass(frozen=True)
class Frame:
    """Another world. axes: what our x, y and z are there, for example `x,-z,y`. unit: metres."""

    axes: str
    unit: float = 1.0

    @cached_property
    def order(self) -> list[int]:
        """Which of their axes our x, y and z are."""
        return ["xyz".index(axis[-1]) for axis in self.axes.split(",")]

    @cached_property
    def scale(self) -> Floats:
        """(3,): metres of our x, y and z for one of theirs; negative where the axis is reversed."""
        signs = [-1.0 if axis[0] == "-" else 1.0 for axis in self.axes.split(",")]
        return np.array(signs, np.float32) * np.float32(self.unit)

    @property
    def turn(self) -> Floats:
        """(3, 3): ours = theirs @ turn, but for the unit; a signed permutation."""
        return np.sign(self.scale) * np.eye(3, dtype=np.float32)[:, self.order]

    @cached_property
    def left_handed(self) -> bool:
        """Whether a right hand's coordinates, read as they are, would be a left hand's."""
        return bool(np.linalg.det(self.turn) < 0)

    @cached_property
    def spin(self) -> Floats:
        """(3,): signs of a rotation's axis along our x, y and z there: the axis goes with the
        world, and where that is left-handed, turning about it is the other way round.
        """
        return np.sign(self.scale) * np.float32(-1.0 if self.left_handed else 1.0)

    @cached_property
    def _is_ours(self) -> bool:
        return self.axes == "x,y,z" and self.unit == 1.0

    def to_ours(self, xyz: Floats) -> Floats:
        """(..., 3) of theirs, in their unit, as ours in metres."""
        # Not a product of matrices: an infinite coordinate would spoil the others of its marker.
        return xyz if self._is_ours else xyz[..., self.order] * self.scale

    def from_ours(self, xyz: Floats) -> Floats:
        """(..., 3) metres of ours as theirs, in their unit."""
        return xyz if self._is_ours else (xyz / self.scale)[..., np.argsort(self.order)]

    def rotations_from_ours(self, quaternions: Floats) -> Floats:
        """(..., 4) unit quaternions x, y, z, w of ours as theirs."""
        axis = quaternions[..., :3] * self.spin
        return np.concatenate([axis[..., np.argsort(self.order)], quaternions[..., 3:]], axis=-1)


FRAMES = {
    "cmu": Frame("x,y,z"),
    "c3d": Frame("x,y,z", UNITS["mm"]),
    "ros": Frame("-y,x,z"),  # REP 103: x forward, y left, z up
    "opengl": Frame("x,-z,y"),  # x right, y up, -z forward
    "steamvr": Frame("x,-z,y"),  # OpenVR: as OpenGL, metres
    "unity": Frame("x,z,y"),  # left-handed: x right, y up, z forward
    "unreal": Frame("y,x,z", UNITS["cm"]),  # left-handed: x forward, y right, z up
    "fastrak": Frame("y,x,-z", UNITS["in"]),  # Polhemus: x forward, y right, z down
}
OURS = FRAMES["cmu"]


def parse_frame(text: str) -> Frame:
    """A named frame. Raises ValueError."""
    if text not in FRAMES:
        raise ValueError(f"known are {', '.join(FRAMES)}")
    return FRAMES[text]


def parse_axes(text: str) -> str:
    """What our x, y and z are there, as `x,-z,y`. Raises ValueError."""
    axes = ",".join(part.strip() for part in text.lower().split(","))
    if not re.fullmatch(r"-?[xyz],-?[xyz],-?[xyz]", axes) or {"x", "y", "z"} - set(axes):
        raise ValueError("name each of x, y and z once, for example x,-z,y")
    return axes


def parse_unit(text: str) -> float:
    """A unit of length in metres. Raises ValueError."""
    if text not in UNITS:
        raise ValueError(f"known are {', '.join(UNITS)}")
    return UNITS[text]
