"""Where the picture is seen from, in the camera's rig: x to the right, y away, z up, metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bridge.view.mesh import Array

SIZE = (1280, 720)  # of the picture, in pixels
FIELD = math.radians(34)  # of view, upright


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A place to look from. eye, aim: (3,). facing: the body's heading off the camera's axis, to
    the viewer's right.
    """

    eye: Array
    aim: Array
    facing: float


_EYE, _AIM = np.array([0.0, -4.55, 1.5]), np.array([0.0, 0.0, 1.06])
VIEWPOINTS = {
    "front": Viewpoint(_EYE, _AIM, 0.0),
    "side": Viewpoint(_EYE, _AIM, math.radians(90)),
    "top": Viewpoint(np.array([0.0, -0.6, 5.2]), np.array([0.0, 0.0, 0.9]), 0.0),
    "three-quarter": Viewpoint(_EYE, _AIM, math.radians(35)),
}
DEFAULT = "three-quarter"


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """The camera as the mouse has turned it: its place, unit vectors to the right, up, and back
    to the viewer, each (3,), and how wide the picture is for its height.
    """

    eye: Array
    right: Array
    up: Array
    back: Array
    aspect: float

    @property
    def axes(self) -> Array:
        """(3, 3), in rows: to the right, up, back to the viewer."""
        return np.stack([self.right, self.up, self.back])

    @property
    def sideways(self) -> Array:
        """To the right, on the floor."""
        level = self.right * [1, 1, 0]
        return level / max(float(np.linalg.norm(level)), 1e-9)

    @classmethod
    def of(cls, extrinsic: Array, aspect: float) -> Camera:
        """From the (4, 4) map from the rig to a camera: x right, y down, z ahead."""
        axes = extrinsic[:3, :3]
        return cls(-axes.T @ extrinsic[:3, 3], axes[0], -axes[1], -axes[2], aspect)


def looking(eye: Array, aim: Array) -> Array:
    """The (4, 4) map from the rig to a camera at `eye`: x right, y down, z ahead."""
    ahead = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead])
    extrinsic = np.eye(4)
    extrinsic[:3, :3], extrinsic[:3, 3] = axes, -axes @ eye
    return extrinsic
