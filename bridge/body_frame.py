"""The frame that poses are learned and estimated in (paper section 4.1).

z up as in the world; x the horizontal projection of LSHO to RSHO; y = z x x. The origin is C7, or,
for those who wear nothing but the tracked markers they are estimated from, the shoulders' middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled
from bridge.vectors import about_z, at, minus, plus, put, seen_in, times, turned
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_AXIS = ("LSHO", "RSHO")


@dataclass(frozen=True, slots=True)
class Construction:
    """Which markers make the body frame. origin: those whose middle it is. axis: from which to
    which x points.
    """

    name: str
    origin: tuple[str, ...]
    axis: tuple[str, str] = _AXIS

    @property
    def references(self) -> tuple[str, ...]:
        """All markers that it takes."""
        return tuple(dict.fromkeys(self.origin + self.axis))

    def features(self, tracked: tuple[str, ...]) -> tuple[str, ...]:
        """The tracked markers that tell anything in this frame: all but a lone origin."""
        return tuple(label for label in tracked if (label,) != self.origin)


PAPER_FRAME = Construction("c7-shoulders", ("C7",))
SIX_FRAME = Construction("six", _AXIS)
CONSTRUCTIONS = {frame.name: frame for frame in (PAPER_FRAME, SIX_FRAME)}
REFERENCES = PAPER_FRAME.references

# Below this share of the shoulders' distance their horizontal projection says nothing of the yaw
# (somebody bent sideways or upside down): the yaw holds.
MIN_PROJECTION = 0.3
# Present markers must be spread this far (m, weighted root mean square) to tell the yaw.
MIN_SPREAD = 0.05
FLOOR = 0.02  # m: no marker is stiffer than this to the body, so none outweighs all others


class BodyFrame:
    """Yaw and translation of the body, followed from frame to frame.

    Each part is exact where its own markers are there: the origin and the yaw. What cannot be had
    exactly is what best carries the last known configuration of the tracked markers onto those
    present (least squares, weighted by how little a marker moves against the body); with none it
    holds. The yaw holds while the shoulder line is too steep to tell it, and is the line's again at
    once when it is not.

    labels: the T tracked markers, in the order of the rows given to `update`. mean: (T, 3) metres,
    their mean positions in the body frame, the configuration before any is known. spread: (T,)
    metres, their standard deviations there; ones where not known. placement: (4,) where the body
    is: its origin in metres, and its yaw. origins: rows of the markers whose middle the origin is.
    """

    def __init__(
        self,
        labels: tuple[str, ...],
        mean: npt.ArrayLike | None = None,
        spread: npt.ArrayLike | None = None,
        construction: Construction = PAPER_FRAME,
    ) -> None:
        self.origins = np.array([labels.index(name) for name in construction.origin])
        self._axis = np.array([labels.index(name) for name in construction.axis])
        self._mean = np.zeros((len(labels), 3)) if mean is None else np.array(mean, float)
        deviation = np.ones(len(labels)) if spread is None else np.array(spread, float)
        self._weights = 1.0 / (deviation**2 + FLOOR**2)
        self._points = np.empty((len(labels), 3))
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        self.known = False  # True once any marker was there
        self.placement = np.zeros(4)
        self.sigma = 0.0  # m, standard deviation of the origin per coordinate; 0 where exact
        self._configuration = self._mean.copy()

    @property
    def origin(self) -> Array:
        """(3,) metres."""
        return self.placement[:3].copy()

    @property
    def yaw(self) -> float:
        """Radians about z."""
        return float(self.placement[3])

    @property
    def rotation(self) -> Array:
        """(3, 3): its columns are the body's axes in the world."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    def update(self, xyz: npt.NDArray[np.floating]) -> None:
        """Follows the body to the tracked markers `xyz`, (T, 3) metres, world, NaN missing."""
        self.place(xyz)
        self.learn(xyz)

    def place(self, xyz: npt.NDArray[np.floating]) -> None:
        """As `update`, but what the markers look like now is not learned as the configuration that
        the body is now: for what might have been seen. May be called many times.
        """
        self._points[:] = xyz
        self.sigma = _place(
            *(self._points, self.origins, self._axis, self._weights, self._configuration),
            *(self.known, self.placement),
        )
        self.known = self.known or self.sigma < math.inf

    def learn(self, xyz: npt.NDArray[np.floating]) -> None:
        """Takes the markers, where they tell origin and yaw exactly, as the configuration known."""
        self._points[:] = xyz
        _learn(self._points, self.origins, self._axis, self.placement, self._configuration)

    def to_body(self, xyz: npt.NDArray[np.floating]) -> Floats:
        """World to body frame, (..., 3) metres."""
        return ((xyz - self.origin) @ self.rotation).astype(np.float32)

    def to_world(self, xyz: Floats) -> Floats:
        """Body frame to world, (..., 3) metres."""
        return (xyz @ self.rotation.T + self.origin).astype(np.float32)


@compiled("void(f8[:,::1], i8[::1], f8[::1], b1, f8[::1], f8[:,::1], f8[::1])")
def _fit_yaw(
    points: Array,
    origins: Rows,
    middle: Array,
    exact: bool,
    weights: Array,
    configuration: Array,
    placement: Array,
) -> None:
    """The yaw that best turns the last configuration onto the markers present, about the origin
    where that is exact, else about their mean; as before where they are too near to it.
    """
    total = 0.0
    now, before = np.zeros(2), np.zeros(2)  # the middles that are turned about
    for row in range(len(points)):
        if not math.isnan(points[row, 0]):
            total += weights[row]
            now += weights[row] * points[row, :2]
            before += weights[row] * configuration[row, :2]
    if total == 0.0:
        return
    now /= total
    before /= total
    if exact:
        now[:] = middle[:2]
        before[:] = 0.0
        for row in origins:
            before += configuration[row, :2] / len(origins)
    spread = dot = cross = 0.0
    for row in range(len(points)):
        if math.isnan(points[row, 0]):
            continue
        weight = weights[row]
        x, y = points[row, 0] - now[0], points[row, 1] - now[1]
        x0, y0 = configuration[row, 0] - before[0], configuration[row, 1] - before[1]
        spread += weight * (x0 * x0 + y0 * y0)
        dot += weight * (x0 * x + y0 * y)
        cross += weight * (x0 * y - y0 * x)
    if spread / total >= MIN_SPREAD**2:
        placement[3] = math.atan2(cross, dot)


@compiled("f8(f8[:,::1], i8[::1], i8[::1], f8[::1], f8[:,::1], b1, f8[::1])")
def _place(
    points: Array,
    origins: Rows,
    axis: Rows,
    weights: Array,
    configuration: Array,
    known: bool,
    placement: Array,
) -> float:
    """Sets the placement as the points (T, 3) have it; returns the sigma of the origin, infinite
    where no marker is there.
    """
    middle = np.zeros(3)
    for row in origins:
        middle += points[row] / len(origins)
    exact = not math.isnan(middle[0])
    left, right = points[axis[0]], points[axis[1]]
    # The yaw of the shoulder line, where it is not too steep. A NaN compares false.
    dx, dy, dz = right[0] - left[0], right[1] - left[1], right[2] - left[2]
    across = math.hypot(dx, dy)
    if across > 0.0 and across >= MIN_PROJECTION * math.hypot(across, dz):
        placement[3] = math.atan2(dy, dx)
    elif not (known and across >= 0.0):  # a line that is too steep says: as before
        _fit_yaw(points, origins, middle, exact, weights, configuration, placement)
    if exact:
        placement[:3] = middle
        return 0.0
    # Where the markers that are there have the origin, in the mean.
    body = about_z(placement[3])
    total, mean = 0.0, (0.0, 0.0, 0.0)
    for row in range(len(points)):
        if not math.isnan(points[row, 0]):
            own = minus(at(points, row), turned(body, at(configuration, row)))
            mean = plus(mean, times(weights[row], own))
            total += weights[row]
    if total == 0.0:
        return math.inf
    placement[0], placement[1], placement[2] = times(1.0 / total, mean)
    return 1.0 / math.sqrt(total)


@compiled("void(f8[:,::1], i8[::1], i8[::1], f8[::1], f8[:,::1])")
def _learn(
    points: Array, origins: Rows, axis: Rows, placement: Array, configuration: Array
) -> None:
    """Takes over what is there, where all that makes the frame is."""
    for row in origins:
        if math.isnan(points[row, 0]):
            return
    for row in axis:
        if math.isnan(points[row, 0]):
            return
    body, origin = about_z(placement[3]), (placement[0], placement[1], placement[2])
    for row in range(len(points)):
        if not math.isnan(points[row, 0]):
            put(configuration, row, seen_in(body, minus(at(points, row), origin)))
