"""What the camera goes with, the floor it goes over, and the way the body went."""

from __future__ import annotations

import math

import numpy as np

from bridge.body_frame import REFERENCES, BodyFrame
from bridge.view.camera import Camera
from bridge.view.colours import BACKGROUND, Colour
from bridge.view.mesh import Array, Part, or_nothing
from bridge.view.player import TRAIL
from drivers.frame import Floats

_TILE: Colour = (0.135, 0.155, 0.195)
_YAW_LAG, _PLACE_LAG = 0.8, 0.1  # s

# Metres.
_SQUARE, _FLOOR = 0.5, 6.0  # side of a floor square; where the floor has faded away
SQUARES = int(2 * _FLOOR / _SQUARE) ** 2 // 2  # that are drawn: every other one
_RIBBON = 0.007  # half as wide as a trail
_STRIDE = 0.6  # nobody goes so far from one point of a trail to the next


def share(step: float, lag: float) -> float:
    """How far a value that follows with a lag goes towards its goal in `step` seconds."""
    return 1 - math.exp(-step / lag)


class Follow:
    """Where the camera's rig stands in the world: the body's middle, and its heading smoothly."""

    def __init__(self, reference_rows: list[int]) -> None:
        self._rows = reference_rows
        self._frame = BodyFrame(REFERENCES)
        self._yaw = self._facing = 0.0
        self.centre = np.zeros(2)
        self.rotation = np.eye(2)

    def turn_to(self, facing: float) -> None:
        """The body is to be seen that far off its front."""
        self._facing = facing
        self._turn()

    def update(self, xyz: Floats, step: float) -> None:
        self._frame.update(xyz[self._rows])
        turn = math.remainder(self._frame.yaw - self._yaw, math.tau)
        self._yaw += share(step, _YAW_LAG) * turn
        known = xyz[np.isfinite(xyz[:, 0]), :2]
        if len(known):
            middle = known.mean(axis=0, dtype=float)
            self.centre += share(step, _PLACE_LAG) * (middle - self.centre)
        self._turn()

    def to_rig(self, xyz: Floats) -> Array:
        placed = xyz.astype(float)
        placed[..., :2] = (placed[..., :2] - self.centre) @ self.rotation.T
        return placed

    def _turn(self) -> None:
        angle = math.pi + self._facing - self._yaw
        cos, sin = math.cos(angle), math.sin(angle)
        self.rotation = np.array([[cos, -sin], [sin, cos]])


class Floor:
    """A chessboard that stands still in the world and fades into the background."""

    def __init__(self, part: Part) -> None:
        self._part = part
        count = int(2 * _FLOOR / _SQUARE)
        columns, rows = np.divmod(np.arange(count * count), count)
        dark = (columns + rows) % 2 == 0
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        squares = np.stack([columns, rows], axis=1)[dark] - count // 2
        self._corners = (squares[:, None] + corners) * _SQUARE

    def place(self, follow: Follow) -> None:
        offset = follow.centre % (2 * _SQUARE)
        places = (self._corners - offset) @ follow.rotation.T
        self._part.points[:, :, :2] = places
        fade = np.clip(1.1 - np.linalg.norm(places, axis=2, keepdims=True) / (_FLOOR - 1), 0, 1)
        self._part.colours[:] = BACKGROUND + fade * np.subtract(_TILE, BACKGROUND)


class Trail:
    """The way that the middle of some markers went, a ribbon that fades with time."""

    def __init__(self, part: Part, rows: list[int], colour: Colour) -> None:
        self._part, self._rows, self._colour = part, rows, np.array(colour)

    def place(
        self, went: Floats, ages: Array, follow: Follow, aside: Array, camera: Camera
    ) -> None:
        """went: (K, M, 3), where all markers were, `ages` (K,) seconds ago."""
        self._part.points[:] = 0.0
        if len(went) < 2 or not self._rows:
            return
        middles = went[:, self._rows].mean(axis=1)
        places = follow.to_rig(middles) + aside
        way = np.diff(places, axis=0)
        across = np.cross(way, camera.back)
        across *= _RIBBON / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        # Each point's own, so that one piece begins where the other ends.
        across = np.concatenate([across[:1], (across[1:] + across[:-1]) / 2, across[-1:]])
        sides = np.stack([places - across, places + across], axis=1)
        pieces = np.concatenate([sides[:-1], sides[1:, ::-1]], axis=1)
        pieces[np.linalg.norm(way, axis=1) > _STRIDE] = np.nan  # it did not go there
        self._part.points[: len(pieces)] = or_nothing(pieces)
        left = 0.75 * np.clip(1 - ages / TRAIL, 0, 1)[:, None]
        colours = BACKGROUND + left * (self._colour - BACKGROUND)
        self._part.colours[: len(pieces), :2] = colours[:-1, None]
        self._part.colours[: len(pieces), 2:] = colours[1:, None]
