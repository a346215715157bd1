"""What networks are trained on: poses as a tracker might see them.

Each example is a pose of the corpus or its mirror image, of a body somewhat larger or smaller,
measured with noise. All is made anew for every batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.body_frame import FLOOR, Construction
from bridge.estimator import ENOUGH
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.mirroring import mirrored
from training.networks import OLDEST, Missing

Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

_LONGEST_GAP = 0.9  # s: half of the ages are drawn evenly up to this
_AGES = 1 / 30, 20.0  # s: the logarithms of the others evenly between these
_LACKING = 0.6  # the largest share of markers that an example lacks, in the mean
_ALONE = 0.5  # of the examples lack one marker alone
_NEVER = 0.05  # of the examples have never seen what they lack


@dataclass(frozen=True, slots=True)
class ExampleOptions:
    """real: how often a pose of a real capture is drawn, to one of a synthetic one. noise: m, per
    coordinate. slip: noise of a velocity, of the body's speed; pace: m/s, of a missing marker's
    velocity. scale: standard deviation of a body's size, of 1.
    """

    real: float = 8.0
    noise: float = 0.009
    slip: float = 0.02
    pace: float = 0.05
    scale: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """N poses to learn from. poses: (N, 41, 3) metres in the body frame; velocities: (N, 41, 3)
    m/s, in the world, told in its axes; origin: (N, 3) metres and yaw: (N,), the body frame in the
    world; capture: (N,), which poses are of one capture, in order; seconds: (N,), when in the
    capture; real: (N,), which are of real ones.
    """

    poses: Floats
    velocities: Floats
    origin: npt.NDArray[np.float64]
    yaw: npt.NDArray[np.float64]
    capture: Indices
    seconds: npt.NDArray[np.float64]
    real: Mask


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    """Frames that lack nothing. tracked: (n, T, 3) as measured; the true poses and velocities
    (n, 41, 3), these against the origin's.
    """

    tracked: Floats
    poses: Floats
    velocities: Floats


class Examples:
    """Draws batches from poses, for a model that tracks these markers."""

    def __init__(
        self,
        poses: Poses,
        tracked: tuple[str, ...],
        construction: Construction,
        options: ExampleOptions,
        random: np.random.Generator,
    ) -> None:
        self._poses = np.concatenate([poses.poses, mirrored(poses.poses)])
        self._velocities = np.concatenate([poses.velocities, mirrored(poses.velocities)])
        self._world = np.concatenate([poses.origin, poses.origin * [-1.0, 1.0, 1.0]])
        self._yaw = np.concatenate([poses.yaw, -poses.yaw])
        self._seconds = np.tile(poses.seconds, 2)
        capture = np.concatenate([poses.capture, poses.capture.max() + 1 + poses.capture])
        # When in all captures, one after the other: to find what was some time before.
        begins = np.flatnonzero(np.diff(capture, prepend=-1))
        self._begin = np.repeat(begins, np.diff(np.append(begins, len(capture))))
        # Of the last pose of a capture no share is ever taken.
        self._next = np.minimum(np.arange(len(capture)) + 1, len(capture) - 1)
        weight = np.tile(np.where(poses.real, options.real, 1.0), 2)
        self._drawn = weight.cumsum() / weight.sum()
        self._drawn[-1] = 1.0  # whatever was rounded
        self._tracked = np.array([MARKERS.index(label) for label in tracked])
        self._origin = np.array([tracked.index(label) for label in construction.origin])
        self._axis = np.array([tracked.index(label) for label in construction.axis])
        self._references = np.array([tracked.index(label) for label in construction.references])
        # A lone origin is at zero in the body frame, without noise.
        features = construction.features(tracked)
        self._measured = np.isin(tracked, features).astype(np.float32)[:, None]
        shown = self._poses[:, self._tracked]
        self.mean: Floats = shown.mean(axis=0)
        variance = shown.var(axis=0).mean(axis=1)
        self._stiffness = (1.0 / (variance + FLOOR**2)).astype(np.float32)
        self._options = options
        self._random = random

    def whole(self, count: int) -> Whole:
        """The next `count` examples that lack no marker."""
        rows, scale = self._draw(count)
        poses = self._poses[rows] * scale
        tracked = poses[:, self._tracked]
        tracked = tracked + self._noise(tracked.shape)
        moving = self._velocities[rows]
        carried = moving[:, self._tracked[self._origin]].mean(axis=1, keepdims=True)
        return Whole(tracked, poses, (moving - carried) * scale)

    def missing(self, count: int) -> tuple[Missing, Floats]:
        """The next `count` examples that lack some, and where all tracked markers are (n, T, 3), in
        the body frame that those present give.
        """
        rows, scale = self._draw(count)
        before, after, age = self._before(rows)
        present = self._present(count)
        # Markers sit a little elsewhere on everybody, and stay there.
        placing = self._noise((count, len(self._tracked), 3))
        now = self._poses[rows][:, self._tracked] * scale + placing
        then = self._between(self._poses, before, after) * scale + placing
        pace = self._between(self._velocities, before, after) * scale
        pace += np.float32(self._options.pace) * self._normal(pace.shape)
        left, pace = self._left_behind(rows, before, after, then, pace, scale)
        unsettled = ~present[:, self._references].all(axis=1)
        if unsettled.any():
            turn, origin = self._placed(now[unsettled], then[unsettled], present[unsettled])
            now[unsettled] = (now[unsettled] - origin) @ turn
            left[unsettled] = (left[unsettled] - origin) @ turn
            pace[unsettled] = pace[unsettled] @ turn
        never = self._random.random(count) < _NEVER
        then[never] = left[never] = self.mean
        pace[never], age[never] = 0.0, OLDEST
        marks = present.astype(np.float32)
        seen = now * marks[:, :, None]
        return Missing(seen, marks, then, left, pace, age.astype(np.float32)), now

    def _left_behind(
        self,
        rows: Indices,
        before: Indices,
        after: Floats,
        then: Floats,
        pace: Floats,
        scale: Floats,
    ) -> tuple[Floats, Floats]:
        """Places and velocities in the body frame of before, in that of now."""
        share = after[:, 0, 0]
        turned = self._yaw[self._next[before]] - self._yaw[before]
        turned = (turned + np.pi) % (2 * np.pi) - np.pi
        yaw = self._yaw[before] + share * turned - self._yaw[rows]
        came = self._world[self._next[before]] - self._world[before]
        moved = self._world[before] + share[:, None] * came - self._world[rows]
        moved = moved * scale[:, :, 0]
        # A row vector times this is turned by yaw.
        turn = _turns(-yaw).astype(np.float32)
        at = np.einsum("nc,ncd->nd", moved, _turns(self._yaw[rows]))[:, None].astype(np.float32)
        return then @ turn + at, pace @ turn

    def _draw(self, count: int) -> tuple[Indices, Floats]:
        """Rows of poses (n,), and sizes of the bodies (n, 1, 1)."""
        rows = self._drawn.searchsorted(self._random.random(count), side="right")
        scale = 1.0 + np.float32(self._options.scale) * self._normal((count, 1, 1))
        return rows, scale

    def _normal(self, shape: tuple[int, ...]) -> Floats:
        return self._random.standard_normal(shape, dtype=np.float32)

    def _noise(self, shape: tuple[int, ...]) -> Floats:
        noise: Floats = np.float32(self._options.noise) * self._measured * self._normal(shape)
        return noise

    def _between(self, values: Floats, before: Indices, after: Floats) -> Floats:
        """Of the tracked markers (n, T, 3), the share `after` (n, 1, 1) from a pose to the next."""
        columns = self._tracked[None]
        one = values[before[:, None], columns]
        following = values[self._next[before][:, None], columns]
        found: Floats = one + after * (following - one)
        return found

    def _before(self, rows: Indices) -> tuple[Indices, Floats, npt.NDArray[np.float64]]:
        """The pose (n,) of the same capture some time before each, the share (n, 1, 1) of the way
        to the next pose that it is after that, and how long before, s.
        """
        random, count = self._random, len(rows)
        wanted = np.where(
            random.random(count) < 0.5,
            random.uniform(0.0, _LONGEST_GAP, count),
            np.exp(random.uniform(math.log(_AGES[0]), math.log(_AGES[1]), count)),
        )
        # Poses are about evenly spaced: where the wanted time is by the spacing just before.
        begin = self._begin[rows]
        last = np.maximum(rows - 1, begin)
        step = np.maximum(self._seconds[rows] - self._seconds[last], 1e-3)
        back = np.maximum(np.ceil(wanted / step).astype(int), 1)
        before = np.maximum(rows - back, begin)
        after = np.where(rows - back >= begin, back - wanted / step, 0.0)
        there = self._seconds[before] * (1.0 - after) + self._seconds[self._next[before]] * after
        age = np.maximum(self._seconds[rows] - there, 1e-3)
        return before, after.astype(np.float32)[:, None, None], age

    def _present(self, count: int) -> Mask:
        """(n, T): all but one, or each with a chance that is the example's; never all."""
        random = self._random
        shape = count, len(self._tracked)
        present = random.random(shape) >= random.random((count, 1)) * _LACKING
        present[random.random(count) < _ALONE] = True
        present[np.arange(count), random.integers(0, shape[1], count)] = False
        # Of too few for the estimator, as many as it needs come back.
        order = random.random(shape).argsort(axis=1)
        present |= (order < ENOUGH) & (present.sum(axis=1, keepdims=True) < ENOUGH)
        return np.asarray(present)

    def _placed(self, now: Floats, before: Floats, present: Mask) -> tuple[Floats, Floats]:
        """The body frame, its axes (n, 3, 3) and origin (n, 1, 3), that the tracked markers
        (n, T, 3) give of which those are present (n, T), `before` being the last that was known
        exactly: as `BodyFrame.place`, for many at once.
        """
        weights = present * self._stiffness
        weights /= weights.sum(axis=1, keepdims=True)
        exact = np.asarray(present[:, self._origin].all(axis=1))
        middle = [
            np.where(
                exact[:, None],
                part[:, self._origin].mean(axis=1),
                np.einsum("nt,ntc->nc", weights, part),
            )
            for part in (now, before)
        ]
        a, b = now - middle[0][:, None], before - middle[1][:, None]
        dot = np.einsum("nt,ntc,ntc->n", weights, a[..., :2], b[..., :2])
        cross = np.einsum("nt,nt->n", weights, b[..., 0] * a[..., 1] - b[..., 1] * a[..., 0])
        yaw = np.arctan2(cross, dot)
        yaw[np.asarray(present[:, self._axis].all(axis=1))] = 0.0
        rotation = _turns(yaw).astype(np.float32)
        turned = before @ rotation.transpose(0, 2, 1)
        fitted = np.einsum("nt,ntc->nc", weights, now - turned)
        origin = np.where(exact[:, None], 0.0, fitted).astype(np.float32)
        return rotation, origin[:, None]


def _turns(yaw: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n, 3, 3), the axes in columns: what is told in others is, times them, told in these."""
    cos, sin, no, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    return np.array([[cos, -sin, no], [sin, cos, no], [no, no, one]]).transpose(2, 0, 1)
