"""What the view shows, as triangles: bodies, floor, meter (the paper's figure 8). No drawing here.

The camera stands still and the world moves: everything is placed in the camera's rig, x to the
right, y away from the camera, z up, with the body's middle over the origin and the body turned to
a three-quarter front view. So the light stays with the camera, and the mouse may turn it.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.body_frame import REFERENCES, BodyFrame
from bridge.pose import Pose, Provenance
from bridge.truth import rms_mm
from bridge.view import mesh
from bridge.view.lettering import strokes, width
from bridge.view.mesh import Array, Mesh, Part
from bridge.view.skeleton import stick_rows
from drivers.frame import Floats

Colour = tuple[float, float, float]

BACKGROUND: Colour = (0.075, 0.09, 0.12)
GOLD: Colour = (1.0, 0.70, 0.12)
CYAN: Colour = (0.10, 0.80, 0.90)
ORANGE: Colour = (1.0, 0.42, 0.05)  # imputed
GREY: Colour = (0.45, 0.47, 0.50)  # lost
WHITE: Colour = (1.0, 1.0, 1.0)  # principal
PALE: Colour = (0.62, 0.72, 0.95)  # reference
GREEN: Colour = (0.15, 0.85, 0.25)  # origin
_TILE: Colour = (0.135, 0.155, 0.195)
_SHADOW: Colour = (0.04, 0.048, 0.065)
_TRACK: Colour = (0.20, 0.225, 0.27)
_INK: Colour = (0.86, 0.89, 0.93)

FULL_SCALE = 200.0  # mm: the meter's end

# Metres.
APART = 0.62  # each body from the middle
_SPHERE, _STICK = 0.021, 0.0115
_DISC, _RIM = 0.030, 0.037
_LIFT = 0.045  # of a disc towards the camera, out of its own sphere and sticks
_SQUARE, _FLOOR = 0.5, 6.0  # side of a floor square; where the floor has faded away
_METER_HEIGHT, _METER_HALF, _METER_THICK = 2.06, 0.75, 0.065
_LETTER = 0.085

_FACING = math.radians(35)  # of the body, off the camera's axis
_SHADOW_SLOPE = np.array([0.35, 0.25])  # how far a shadow falls aside per height
_YAW_LAG, _PLACE_LAG, _METER_LAG = 0.8, 0.1, 0.15  # s

_SPHERE_POINTS, _SPHERE_TRIANGLES = mesh.sphere()
_SIDES = 8
_RING = mesh.circle(_SIDES)[0]
_CIRCLE, _CIRCLE_TRIANGLES = mesh.circle(20)
_QUAD = mesh.fan(4)
_MOST = 9999.0  # mm: the largest error that the meter writes
_STROKES = len(strokes("RMS 8888 mm"))  # room for any figure: no digit has more strokes than an 8


class Camera:
    """The camera's axes in the rig: unit vectors to the right, up, and back to the viewer."""

    def __init__(self, right: Array, up: Array, back: Array) -> None:
        self.right, self.up, self.back = right, up, back

    @property
    def sideways(self) -> Array:
        """To the right, on the floor."""
        level = self.right * [1, 1, 0]
        return level / max(float(np.linalg.norm(level)), 1e-9)


class Scene:
    """Two meshes, `lit` and `flat` (not shaded), moved in place by `update`.

    labels: the markers of a pose, in order. principal: those shown as white discs.
    """

    def __init__(self, labels: tuple[str, ...], principal: tuple[str, ...]) -> None:
        self._ends = stick_rows(labels)
        self._reference_rows = [labels.index(label) for label in REFERENCES]
        worn = [label for label in labels if label in principal or label in REFERENCES]
        self._worn = [labels.index(label) for label in worn]
        self._worn_colours = np.array([_worn_colour(label, principal) for label in worn])
        self._follow = _Follow(self._reference_rows)
        self._error = 0.0
        self._last: float | None = None

        body = [
            (len(labels), len(_SPHERE_POINTS), _SPHERE_TRIANGLES),
            (len(self._ends), 2 * _SIDES, mesh.tube(_SIDES)),
        ]
        self.lit = Mesh(body * 2)
        self._true = _Body(self._ends, self.lit.parts[0], self.lit.parts[1])
        self._estimate = _Body(self._ends, self.lit.parts[2], self.lit.parts[3])
        squares = int(2 * _FLOOR / _SQUARE) ** 2 // 2
        shadow = (len(self._ends), 2 * _SIDES, mesh.tube(_SIDES))
        disc = (len(worn), len(_CIRCLE), _CIRCLE_TRIANGLES)
        self.flat = Mesh(
            [(squares, 4, _QUAD), shadow, shadow, disc, disc, *_Meter.SHAPES]  # in drawing order
        )
        floor, true_shadow, estimate_shadow, self._rims, self._discs, *meter = self.flat.parts
        self._floor = _Floor(floor)
        self._shadows = (true_shadow, estimate_shadow)
        for part in self._shadows:
            part.colours[:] = _SHADOW
        self._rims.colours[:] = BACKGROUND
        self._meter = _Meter(meter)

    def update(self, pose: Pose, truth: Floats | None, camera: Camera) -> None:
        """Moves everything to a pose, with the true one (M, 3) beside it where it is known."""
        step = 0.0 if self._last is None else max(pose.t - self._last, 0.0)
        first = self._last is None
        self._last = pose.t
        self._follow.update(pose.xyz, step, first)
        xyz = self._follow.to_rig(pose.xyz)
        aside = camera.sideways * APART
        self._estimate.place(xyz + (aside if truth is not None else 0.0))
        self._estimate.paint(CYAN)
        self._estimate.mark(pose.provenance == Provenance.IMPUTED, ORANGE)
        self._estimate.mark(pose.provenance == Provenance.LOST, GREY)
        self._true.place(
            np.full_like(xyz, np.nan) if truth is None else self._follow.to_rig(truth) - aside
        )
        self._true.paint(GOLD)
        self._floor.place(self._follow)
        for part, body in zip(self._shadows, (self._true, self._estimate), strict=True):
            part.points[:, :, :2] = body.sticks[:, :, :2] + body.sticks[:, :, 2:] * _SHADOW_SLOPE
            part.points[:, :, 2] = np.where(body.sticks[:, :, 2] == 0, 0, 0.004)
        self._place_discs(pose, camera)
        if truth is None:
            self._meter.hide()
        else:
            error = rms_mm(pose.xyz, truth)
            error = 0.0 if math.isnan(error) else error
            self._error += _share(step, _METER_LAG, first) * (error - self._error)
            self._meter.show(self._error, camera)

    def _place_discs(self, pose: Pose, camera: Camera) -> None:
        measured = pose.provenance[self._worn] == Provenance.MEASURED
        colours = np.where(
            measured[:, None], self._worn_colours, self._estimate.colours[self._worn]
        )
        self._discs.colours[:] = colours[:, None]
        plane = _CIRCLE @ [camera.right, camera.up]
        centres = self._estimate.places[self._worn]
        for part, radius, lift in ((self._rims, _RIM, _LIFT), (self._discs, _DISC, _LIFT + 0.004)):
            part.points[:] = _or_nothing((centres + lift * camera.back)[:, None] + radius * plane)


def _worn_colour(label: str, principal: tuple[str, ...]) -> Colour:
    if label == REFERENCES[0]:
        return GREEN
    return WHITE if label in principal else PALE


def _share(step: float, lag: float, first: bool) -> float:
    """How far a value that follows with a lag goes towards its goal in `step` seconds."""
    return 1.0 if first else 1 - math.exp(-step / lag)


def _or_nothing(points: Array) -> Array:
    """Shapes (N, V, 3) with those that are not wholly known shrunk to a point: they vanish."""
    known = np.isfinite(points).all(axis=(1, 2), keepdims=True)
    return np.where(known, points, 0.0)


class _Follow:
    """Where the camera's rig stands in the world: the body's middle, and its heading smoothly."""

    def __init__(self, reference_rows: list[int]) -> None:
        self._rows = reference_rows
        self._frame = BodyFrame(REFERENCES)
        self._yaw = 0.0
        self.centre = np.zeros(2)
        self.rotation = np.eye(2)

    def update(self, xyz: Floats, step: float, first: bool) -> None:
        self._frame.update(xyz[self._rows])
        turn = math.remainder(self._frame.yaw - self._yaw, math.tau)
        self._yaw += _share(step, _YAW_LAG, first) * turn
        known = xyz[np.isfinite(xyz[:, 0]), :2]
        if len(known):
            middle = known.mean(axis=0, dtype=float)
            self.centre += _share(step, _PLACE_LAG, first) * (middle - self.centre)
        angle = math.pi + _FACING - self._yaw
        cos, sin = math.cos(angle), math.sin(angle)
        self.rotation = np.array([[cos, -sin], [sin, cos]])

    def to_rig(self, xyz: Floats) -> Array:
        placed = xyz.astype(float)
        placed[:, :2] = (placed[:, :2] - self.centre) @ self.rotation.T
        return placed


class _Body:
    """One body: a sphere per marker and the sticks between."""

    def __init__(self, ends: npt.NDArray[np.intp], spheres: Part, sticks: Part) -> None:
        self._ends, self._spheres, self._sticks = ends, spheres, sticks
        self._spheres.normals[:] = _SPHERE_POINTS
        self.sticks = sticks.points
        self.places = np.zeros((len(spheres.points), 3))
        self.colours = np.zeros((len(spheres.points), 3))

    def place(self, xyz: Array) -> None:
        self.places = xyz
        self._spheres.points[:] = _or_nothing(xyz[:, None] + _SPHERE * _SPHERE_POINTS)
        a, b = xyz[self._ends[:, 0]], xyz[self._ends[:, 1]]
        along = b - a
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        upright = np.abs(along[:, 2:]) > 0.9
        across = np.cross(along, np.where(upright, [1.0, 0, 0], [0, 0, 1.0]))
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        frame = np.stack([across, np.cross(along, across)], axis=1)
        ring = _RING @ frame
        self._sticks.normals[:] = np.nan_to_num(np.concatenate([ring, ring], axis=1))
        ring = _STICK * ring
        points = np.concatenate([a[:, None] + ring, b[:, None] + ring], axis=1)
        self._sticks.points[:] = _or_nothing(points)

    def paint(self, colour: Colour) -> None:
        self.colours[:] = colour
        self._spheres.colours[:] = colour
        self._sticks.colours[:] = np.multiply(colour, 0.8)

    def mark(self, markers: npt.NDArray[np.bool_], colour: Colour) -> None:
        self.colours[markers] = colour
        self._spheres.colours[markers] = colour


class _Floor:
    """A chessboard that stands still in the world and fades into the background."""

    def __init__(self, part: Part) -> None:
        self._part = part
        count = int(2 * _FLOOR / _SQUARE)
        columns, rows = np.divmod(np.arange(count * count), count)
        dark = (columns + rows) % 2 == 0
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        squares = np.stack([columns, rows], axis=1)[dark] - count // 2
        self._corners = (squares[:, None] + corners) * _SQUARE

    def place(self, follow: _Follow) -> None:
        offset = follow.centre % (2 * _SQUARE)
        places = (self._corners - offset) @ follow.rotation.T
        self._part.points[:, :, :2] = places
        fade = np.clip(1.1 - np.linalg.norm(places, axis=2, keepdims=True) / (_FLOOR - 1), 0, 1)
        self._part.colours[:] = BACKGROUND + fade * np.subtract(_TILE, BACKGROUND)


class _Meter:
    """The error over the bodies: a bar of 200 mm full scale, its figure, and a scale."""

    _SCALE = ("0", "100", "200")
    _FIXED = np.concatenate(
        [
            (strokes(text) - [width(text) / 2, 0]) * 0.055
            + [(2 * place / 2 - 1) * _METER_HALF, -0.115]
            for place, text in enumerate(_SCALE)
        ]
    )
    SHAPES = (
        (1, 4, _QUAD),  # track
        (1, 4, _QUAD),  # bar
        (5, 4, _QUAD),  # marks on the scale
        (len(_FIXED), 4, _QUAD),  # its figures
        (_STROKES, 4, _QUAD),  # the error
    )

    def __init__(self, parts: list[Part]) -> None:
        self._parts = parts
        self._track, self._bar, self._marks, self._figures, self._text = parts
        for part, colour in zip(parts, (_TRACK, _INK, _INK, _INK, _INK), strict=True):
            part.colours[:] = colour

    def hide(self) -> None:
        for part in self._parts:
            part.points[:] = 0

    def show(self, error: float, camera: Camera) -> None:
        """error: millimetres."""
        share = min(error / FULL_SCALE, 1.0)
        end = _METER_HALF * (2 * share - 1)
        half = _METER_THICK / 2
        track = _box(np.array([-_METER_HALF]), np.array([_METER_HALF]), -half, half)
        bar = _box(np.array([-_METER_HALF]), np.array([end]), -half, half)
        marks = np.linspace(-_METER_HALF, _METER_HALF, 5)
        ticks = _box(marks - 0.003, marks + 0.003, -half - 0.02, -half)
        text = f"RMS {min(error, _MOST):.0f} mm"
        lines = (strokes(text) - [width(text) / 2, 0]) * _LETTER + [0, half + 0.05]
        padded = np.zeros((_STROKES, 2, 2))
        padded[: len(lines)] = lines
        self._bar.colours[:] = np.clip([2 * share, 2 - 2 * share, 0.15], 0.15, 0.9)
        drawn = (track, bar, ticks, _pen(self._FIXED, 0.004), _pen(padded, 0.0065))
        centre = np.array([0, 0, _METER_HEIGHT])
        for layer, (part, flat) in enumerate(zip(self._parts, drawn, strict=True)):
            nearer = centre + 0.003 * layer * camera.back
            part.points[:] = flat @ [camera.right, camera.up] + nearer


def _box(left: Array, right: Array, bottom: float, top: float) -> Array:
    """Rectangles (N, 4, 2)."""
    low, high = np.full_like(left, bottom), np.full_like(left, top)
    corners = [(left, low), (right, low), (right, high), (left, high)]
    return np.stack([np.stack(corner, axis=1) for corner in corners], axis=1)


def _pen(lines: Array, half: float) -> Array:
    """Strokes (S, 2, 2) as rectangles (S, 4, 2) of twice `half` thick, that reach as far over."""
    a, b = lines[:, 0], lines[:, 1]
    length = np.linalg.norm(b - a, axis=1, keepdims=True)
    along = half * (b - a) / np.maximum(length, 1e-9)
    across = along[:, ::-1] * [-1, 1]
    return np.stack(
        [a - along - across, b + along - across, b + along + across, a - along + across], axis=1
    )
