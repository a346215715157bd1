"""What a network is trained on: poses as a tracker might see them.

Each example is a pose of the corpus or its mirror image, of a body somewhat larger or smaller, some
of its tracked markers missing, the rest measured with noise, in the body frame that those give. All
is made anew for every batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.body_frame import FLOOR, Construction
from bridge.estimator import ENOUGH
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.mirroring import mirrored

Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ExampleOptions:
    """real: how often a pose of a real capture is drawn, to one of a synthetic one. noise: m, per
    coordinate. scale: standard deviation of a body's size, of 1. earlier: poses of
    the corpus back, at most, that the last exact body frame may be.
    """

    real: float = 8.0
    noise: float = 0.009
    scale: float = 0.05
    earlier: int = 60


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """features: (n, F, 3) metres, zero where missing. present: (n, T), of the tracked markers, 0 or
    1. poses: (n, 41, 3) metres. wanted: (n, 41), 1 for markers whose estimate is of use.
    """

    features: Floats
    present: Floats
    poses: Floats
    wanted: Floats


class Examples:
    """Draws batches from poses (N, 41, 3) in the body frame.

    capture: (N,), which poses are of one capture, in order. real: (N,), which are of real ones.
    whole: the share of examples that lack no marker.
    """

    def __init__(
        self,
        poses: Floats,
        capture: Indices,
        real: Mask,
        tracked: tuple[str, ...],
        construction: Construction,
        options: ExampleOptions,
        whole: float,
        random: np.random.Generator,
    ) -> None:
        self._poses = np.concatenate([poses, mirrored(poses)])
        self._capture = np.concatenate([capture, -1 - capture])
        weight = np.tile(np.where(real, options.real, 1.0), 2)
        self._drawn = weight.cumsum() / weight.sum()
        self._drawn[-1] = 1.0  # whatever was rounded
        self._tracked = np.array([MARKERS.index(label) for label in tracked])
        features = construction.features(tracked)
        self._features = np.array([tracked.index(label) for label in features])
        self._origin = np.array([tracked.index(label) for label in construction.origin])
        self._axis = np.array([tracked.index(label) for label in construction.axis])
        self._references = np.array([tracked.index(label) for label in construction.references])
        variance = self._poses[:, self._tracked].var(axis=0).mean(axis=1)
        self._stiffness = (1.0 / (variance + FLOOR**2)).astype(np.float32)
        self._options = options
        self._whole = whole
        self._random = random

    def draw(self, count: int) -> Batch:
        """The next `count` examples."""
        options, random = self._options, self._random
        rows = self._drawn.searchsorted(random.random(count), side="right")
        scale = 1.0 + options.scale * random.standard_normal((count, 1, 1), dtype=np.float32)
        poses: Floats = self._poses[rows] * scale
        present = self._present(count)
        missing = ~present
        unsettled = np.asarray(missing[:, self._references].any(axis=1))
        if unsettled.any():
            back = random.integers(1, options.earlier + 1, count)
            before = np.maximum(rows - back, 0)
            other = self._capture[before] != self._capture[rows]
            before[other] = rows[other]
            known: Floats = self._poses[before[unsettled]] * scale[unsettled]
            poses[unsettled] = self._placed(poses[unsettled], known, present[unsettled])
        features = poses[:, self._tracked[self._features]]
        features += options.noise * random.standard_normal(features.shape, dtype=np.float32)
        features *= present[:, self._features, None]
        wanted = np.ones((count, len(MARKERS)), np.float32)
        wanted[:, self._tracked] = missing
        return Batch(features, present.astype(np.float32), poses, wanted)

    def _present(self, count: int) -> Mask:
        """(n, T): all markers, or each with a chance that is the example's."""
        random = self._random
        chance = random.random((count, 1)) * 0.6
        chance[random.random(count) < self._whole] = 0.0
        shape = count, len(self._tracked)
        present = random.random(shape) >= chance
        # Of too few for the estimator, as many as it needs come back.
        order = random.random(shape).argsort(axis=1)
        present |= (order < ENOUGH) & (present.sum(axis=1, keepdims=True) < ENOUGH)
        return np.asarray(present)

    def _placed(self, poses: Floats, known: Floats, present: Mask) -> Floats:
        """Poses (n, 41, 3) in the body frame that the markers present (n, T) give, `known` being
        the last that was known exactly: as `BodyFrame.place`, for many at once.
        """
        now, before = poses[:, self._tracked], known[:, self._tracked]
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
        cos, sin, no, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
        rotation = np.array([[cos, -sin, no], [sin, cos, no], [no, no, one]]).transpose(2, 0, 1)
        turned = before @ rotation.transpose(0, 2, 1)
        fitted = np.einsum("nt,ntc->nc", weights, now - turned)
        origin = np.where(exact[:, None], 0.0, fitted)
        placed: Floats = ((poses - origin[:, None]) @ rotation).astype(np.float32)
        return placed
