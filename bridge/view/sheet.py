"""A sheet of glass before the camera, to write and draw on."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from bridge.view import mesh
from bridge.view.camera import FIELD, Camera
from bridge.view.colours import Colour
from bridge.view.lettering import strokes, width
from bridge.view.mesh import Array, Mesh

_NEAR = 0.3  # m from the eye: before everything
_LAYER = 1e-5  # of that: what is drawn later is nearer
_QUADS = 2000  # room for so many
_PEN = 0.06  # half the thickness of a stroke, in heights of a letter
_DISC = np.linspace(0, math.pi, 9)


class Sheet:
    """Drawn anew for each picture: `begin`, what there is to see, `end`.

    Places and lengths are in heights of the picture, from its middle, x to the right, y up.
    """

    def __init__(self) -> None:
        self.mesh = Mesh([(_QUADS, 4, mesh.fan(4))])
        self.width = 0.0
        self._part = self.mesh.parts[0]
        self._quads: list[Array] = []
        self._colours: list[Colour] = []

    def begin(self, camera: Camera) -> None:
        self.width = camera.aspect
        self._quads.clear()
        self._colours.clear()

    def box(self, left: float, bottom: float, right: float, top: float, colour: Colour) -> None:
        corners = [[left, bottom], [right, bottom], [right, top], [left, top]]
        self._add(np.array([corners]), colour)

    def disc(self, x: float, y: float, radius: float, colour: Colour) -> None:
        upper = np.stack([np.cos(_DISC), np.sin(_DISC)], axis=1) * radius
        lower = upper * [1, -1]
        slices = np.stack([upper[:-1], upper[1:], lower[1:], lower[:-1]], axis=1)
        self._add(slices + np.array([x, y]), colour)

    def text(
        self, text: str, x: float, y: float, height: float, colour: Colour, align: float = 0.0
    ) -> None:
        """Writes from (x, y) on. align: which share of its length is to the left of there."""
        start = np.array([x - align * width(text) * height, y])
        self._add(_written(text) * height + start, colour)

    def end(self, camera: Camera) -> None:
        """Puts all that was drawn before the camera; what there is no room for is left out."""
        counts = [len(quads) for quads in self._quads]
        quads = np.concatenate([np.empty((0, 4, 2)), *self._quads])[:_QUADS]
        layers = np.repeat(np.arange(len(counts)), counts)[:_QUADS]
        colours = np.array(self._colours).reshape(-1, 3)
        distance = _NEAR * (1 - _LAYER * layers)[:, None, None]
        plane = 2 * math.tan(FIELD / 2) * quads @ [camera.right, camera.up]
        self._part.points[: len(quads)] = camera.eye + distance * (plane - camera.back)
        self._part.points[len(quads) :] = camera.eye
        self._part.colours[: len(quads)] = colours[layers][:, None]

    def _add(self, quads: Array, colour: Colour) -> None:
        self._quads.append(quads)
        self._colours.append(colour)


@lru_cache(256)
def _written(text: str) -> Array:
    """A text one high, as rectangles (S, 4, 2) that reach as far over as they are thick."""
    lines = strokes(text)
    a, b = lines[:, 0], lines[:, 1]
    length = np.linalg.norm(b - a, axis=1, keepdims=True)
    along = _PEN * (b - a) / np.maximum(length, 1e-9)
    across = along[:, ::-1] * [-1, 1]
    return np.stack(
        [a - along - across, b + along - across, b + along + across, a - along + across], axis=1
    )
