"""Performers that need no capture: walking synthesised from a few kilobytes of parameters.

In the manner of Troje (2002), "Decomposing biological motion": a pose in the body frame is a mean
pose and a few principal components whose scores are Fourier series over the gait cycle; the body
frame itself sways and bounces about a point that moves on the path at constant speed.
"""

from __future__ import annotations

import json
import math
from importlib.resources import files

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats, Layout
from drivers.marker_set import MARKERS

Array = npt.NDArray[np.float64]

PERFORMERS = ("walk",)

_STRIDES = 28  # of the whole path: about 40 m
# A heading of A sin(s) closes to a figure of eight where A is the first zero of Bessel's J0.
_AMPLITUDE = 2.404825557695773
# Legs follow the bent path and the trunk stays rigid; between these heights (m) it is a blend.
_RIGID_ABOVE, _BENT_BELOW = 1.0, 0.1


def fourier_basis(phase: npt.ArrayLike, harmonics: int) -> Array:
    """(N,) phases in cycles as (N, 1 + 2 harmonics): 1, then cosine and sine of each harmonic."""
    angles = math.tau * np.outer(np.asarray(phase, float), np.arange(1, harmonics + 1))
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(angles), -1)
    return np.concatenate([np.ones((len(angles), 1)), waves], axis=1)


class Walker:
    """Endless walking on a figure of eight; the feet stand where they are put down.

    rate: frames a second.
    """

    def __init__(self, rate: float = 120.0) -> None:
        self.layout = Layout(MARKERS, rate)
        text = (files("simulators") / "data" / "walk.json").read_text(encoding="utf-8")
        parameters = json.loads(text)
        table = np.array([parameters["markers"][label] for label in MARKERS]) / 1000
        self._cycle = float(parameters["cycle_s"])
        self._stride = float(parameters["stride"]) / 1000
        self._yaw = np.radians(parameters["yaw"])
        self._origin = np.array(parameters["origin"]) / 1000
        self._scores = np.array(parameters["scores"])
        self._components = table.reshape(len(MARKERS), -1, 3).transpose(1, 0, 2)
        height = self._components[0, :, 2] + self._origin[2, 0]
        bent = (_RIGID_ABOVE - height) / (_RIGID_ABOVE - _BENT_BELOW)
        self._bent = np.clip(bent, 0, 1)
        self._path = _Path(_STRIDES * self._stride)

    def pose(self, index: int) -> Floats:
        """The markers of frame `index`: (41, 3) metres, world, Z up."""
        # The walk repeats with the path: no precision is lost however long it lasts.
        cycles = index / self.layout.rate / self._cycle % _STRIDES
        basis = fourier_basis([cycles], (self._origin.shape[1] - 1) // 2)[0]
        weights = np.concatenate([[1.0], self._scores @ basis[1:]])
        xyz = np.tensordot(weights, self._components, 1) @ _turn(self._yaw @ basis).T
        xyz += self._origin @ basis
        # Now x is to the right of the path, y along it. Each marker goes some way along the path
        # itself and the rest straight: a foot that goes all the way stands still in a turn.
        along = self._bent * xyz[:, 1]
        place, heading = self._path.at(cycles * self._stride + along)
        xyz[:, 1] -= along
        cos, sin = np.cos(heading), np.sin(heading)
        turned = [cos * xyz[:, 0] - sin * xyz[:, 1], sin * xyz[:, 0] + cos * xyz[:, 1], xyz[:, 2]]
        world = np.stack(turned, axis=1)
        world[:, :2] += place
        return world.astype(np.float32)


class _Path:
    """A closed figure of eight of gentle turns: heading A sin(2 pi s / length) at arc length s.

    Its integral is a Fourier series, so a place on it needs no summing up of steps.
    """

    def __init__(self, length: float) -> None:
        self._step = math.tau / length
        angles = np.arange(64) * math.tau / 64
        series = np.fft.fft(np.exp(1j * _AMPLITUDE * np.sin(angles))) / 64
        self._orders = np.r_[-15:0, 1:16]
        self._terms = series[self._orders] / (1j * self._orders * self._step)

    def at(self, arc: Array) -> tuple[Array, Array]:
        """Places (N, 2) in metres at arc lengths (N,), and headings (N,): 0 is along y."""
        angles = arc * self._step
        along = np.exp(1j * np.outer(angles, self._orders)) @ self._terms
        return np.stack([-along.imag, along.real], axis=1), _AMPLITUDE * np.sin(angles)


def _turn(yaw: float) -> Array:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def load_performer(name: str) -> Walker:
    """The performer of that name. Raises ValueError where there is none."""
    if name not in PERFORMERS:
        raise ValueError(f"no performer '{name}' (known: {', '.join(PERFORMERS)})")
    return Walker()
