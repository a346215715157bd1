"""`bridge.body_frame` in numpy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.body_frame import FLOOR, MIN_PROJECTION, MIN_SPREAD, PAPER_FRAME, Construction
from drivers.frame import Floats

Array = npt.NDArray[np.float64]


class BodyFrame:
    """See `bridge.body_frame.BodyFrame`."""

    def __init__(
        self,
        labels: tuple[str, ...],
        mean: npt.ArrayLike | None = None,
        spread: npt.ArrayLike | None = None,
        construction: Construction = PAPER_FRAME,
    ) -> None:
        self._origin = [labels.index(name) for name in construction.origin]
        self._left, self._right = (labels.index(name) for name in construction.axis)
        self._mean = np.zeros((len(labels), 3)) if mean is None else np.array(mean, float)
        deviation = np.ones(len(labels)) if spread is None else np.array(spread, float)
        self._weights = 1.0 / (deviation**2 + FLOOR**2)
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        self.known = False  # True once any marker was there
        self.origin = np.zeros(3)
        self.yaw = 0.0
        self.rotation = np.eye(3)  # columns: the body's axes in the world
        self._to_world = np.eye(3, dtype=np.float32)  # a row vector times this is in the world's
        self.sigma = 0.0  # m, standard deviation of the origin per coordinate; 0 where exact
        self._configuration = self._mean.copy()

    def update(self, xyz: Floats) -> None:
        """Follows the body to the tracked markers `xyz`, (T, 3) metres, world, NaN missing."""
        self.place(xyz)
        self.learn(xyz)

    def place(self, xyz: Floats) -> None:
        """Puts the frame where the markers say, as `update` does, without learning from them how
        the body is now: for what might have been seen. May be called many times.
        """
        points = xyz.astype(float)
        origin, yaw = self._middle(points), self._shoulder_yaw(points)
        if origin is None or yaw is None:
            present = ~np.isnan(points[:, 0])
            if not present.any():
                self.sigma = math.inf
                return
            if yaw is None:
                yaw = self._fitted_yaw(points, present, origin)
        if yaw != self.yaw or not self.known:
            self._turn(yaw)
        if origin is not None:
            self.origin = origin
            self.sigma = 0.0
        else:
            weights = self._weights[present]
            offsets = points[present] - self._configuration[present] @ self.rotation.T
            self.origin = weights @ offsets / weights.sum()
            self.sigma = float(weights.sum() ** -0.5)
        self.known = True

    def learn(self, xyz: Floats) -> None:
        """Takes the markers, where they tell origin and yaw exactly, as the configuration known."""
        present = ~np.isnan(xyz[:, 0])
        if present.all():
            self._configuration = (xyz - self.origin) @ self.rotation
        elif present[[*self._origin, self._left, self._right]].all():
            self._configuration[present] = (xyz[present] - self.origin) @ self.rotation

    def _middle(self, points: Array) -> Array | None:
        """The origin; None where one of its markers is missing."""
        middle = self.at_origin(points)
        return None if math.isnan(middle[0]) else middle

    def _turn(self, yaw: float) -> None:
        self.yaw = yaw
        cos, sin = math.cos(yaw), math.sin(yaw)
        self.rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._to_world = self.rotation.T.astype(np.float32)

    def _shoulder_yaw(self, points: Array) -> float | None:
        """The yaw of the shoulder line; None where a shoulder is missing or the line too steep."""
        dx, dy, dz = (points[self._right] - points[self._left]).tolist()
        across = math.hypot(dx, dy)
        # A NaN compares false.
        if across > 0.0 and across >= MIN_PROJECTION * math.hypot(across, dz):
            return math.atan2(dy, dx)
        return None

    def _fitted_yaw(
        self, points: Array, present: npt.NDArray[np.bool_], origin: Array | None
    ) -> float:
        """The yaw that best turns the last configuration onto the markers present."""
        if present[self._left] and present[self._right] and self.known:
            return self.yaw  # the shoulder line is too steep
        weights = self._weights[present]
        now, before = points[present, :2], self._configuration[present, :2]
        if origin is not None:
            middle = self._configuration[self._origin, :2].mean(axis=0)
            now, before = now - origin[:2], before - middle
        else:
            now = now - weights @ now / weights.sum()
            before = before - weights @ before / weights.sum()
        if weights @ (before**2).sum(axis=1) / weights.sum() < MIN_SPREAD**2:
            return self.yaw
        dot = weights @ (before * now).sum(axis=1)
        cross = weights @ (before[:, 0] * now[:, 1] - before[:, 1] * now[:, 0])
        return math.atan2(cross, dot)

    def at_origin(self, values: npt.NDArray[np.floating]) -> Array:
        """(3,): of values of the tracked markers (T, 3), that of the origin."""
        if len(self._origin) == 1:
            origin: Array = values[self._origin[0]]
        else:
            origin = values[self._origin].mean(axis=0)
        return origin

    def to_body(self, xyz: npt.NDArray[np.floating]) -> Floats:
        """World to body frame, (..., 3) metres."""
        return ((xyz - self.origin) @ self.rotation).astype(np.float32)

    def to_world(self, xyz: Floats) -> Floats:
        """Body frame to world, (..., 3) metres."""
        return (xyz @ self._to_world + self.origin).astype(np.float32)
