"""From marker frames to poses: noise out, missing markers in, body frame, estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from bridge.body_frame import CONSTRUCTIONS, BodyFrame
from bridge.compiled import compiled
from bridge.imputation import Imputation
from bridge.imputer import NEAR, Imputer
from bridge.model import BoundNetworks, Model, ModelInfo
from bridge.networks import CompiledNetworks
from bridge.pose import Pose, Provenance
from bridge.regression import Estimate, features_of, regression_of
from bridge.smoothing import NoiseFilter
from bridge.vectors import about_z, at, minus, plus, put, seen_in, times, turned
from drivers.frame import Floats, Layout, MarkerFrame

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

NOISE = 0.001  # m: standard deviation of a measured coordinate
ENOUGH = 3  # tracked markers without which nobody can say where the body is and faces
HOLD = 1.0  # s that a pose is held with fewer; then it is lost
DRIFT = 0.5  # m/s: how fast a held pose grows wrong
REST = 0.1  # s: time constant with which a held pose comes to rest
STEADY = 0.1  # s: time constant with which a pose that moves as it should comes to where it should


def body_frame(info: ModelInfo) -> BodyFrame:
    """The body frame of a model's tracked markers, with what the model knows of them."""
    features = [info.tracked.index(label) for label in info.features]
    # A lone origin is no feature: at zero, and stiff to the body by definition.
    mean = np.zeros((len(info.tracked), 3))
    mean[features] = info.mean
    spread = np.zeros(len(info.tracked))
    spread[features] = np.sqrt(np.diag(info.covariance).reshape(-1, 3).mean(axis=1))
    return BodyFrame(info.tracked, mean, spread, CONSTRUCTIONS[info.body_frame])


def influence(info: ModelInfo) -> Array:
    """(M, T): the variance of each marker's estimate, per coordinate, for that of a tracked one;
    zero for tracked ones.

    By the model's global linear map, and by the body frame, which moves with its origin.
    """
    unworn = [info.labels.index(label) for label in info.unworn]
    origin = CONSTRUCTIONS[info.body_frame].origin
    maps = np.array(info.sensitivity).reshape(len(unworn), 3, len(info.features), 3)
    moved = np.zeros((len(unworn), 3, len(info.tracked), 3))
    moved[:, :, features_of(info)] = maps
    by_origin = (np.eye(3) - maps.sum(axis=2)) / len(origin)
    for label in origin:
        moved[:, :, info.tracked.index(label)] += by_origin
    found = np.zeros((len(info.labels), len(info.tracked)))
    found[unworn] = (moved**2).sum(axis=3).mean(axis=1)
    return found


class PoseEstimator:
    """One performer's state and the model. Call `step` with each frame in turn.

    It never reads a clock, and uses the tracked markers alone: what else a stream carries is
    ignored, so the same person moves the same whatever else the device sends.

    history: frames of 1/120 s before the present one that a mixture weighs in; the model's own
    where not given. imputation: what fills in missing markers, in place of all that the model and
    this class do about them; to compare with. regression: the model's, with what it keeps of the
    past. asked: between `begin` and `finish`, what it is to be asked: the tracked markers (T, 3)
    in the body frame and their velocities (T, 3).
    """

    def __init__(
        self,
        model: Model,
        history: int | None = None,
        imputation: Imputation | None = None,
    ) -> None:
        info = model.info
        tracked, markers = len(info.tracked), len(info.labels)
        self.model = model
        self.history = model.info.history if history is None else history
        self.regression = regression_of(model, self.history)
        x: Floats = np.zeros((tracked, 3), np.float32)
        self.asked = x, np.zeros_like(x)
        self._features = features_of(info)
        self._rows = np.array([info.labels.index(label) for label in info.tracked])
        self._body = body_frame(info)
        self._filter = NoiseFilter(tracked)
        usual = np.zeros((tracked, 3))
        usual[self._features] = info.mean
        self._imputer = Imputer(self.regression, self._body, usual)
        self._influence = influence(info)
        self._imputation = imputation
        self._markers = np.zeros_like(x)  # the tracked ones as they came
        self._carried = np.zeros(3)  # m: how the body's origin moved
        self._nowhere: Floats = np.full((markers, 3), np.nan, np.float32)
        # Where all tracked markers are measured.
        self._measured = np.full(markers, Provenance.ESTIMATED, np.uint8)
        self._measured[self._rows] = Provenance.MEASURED
        self.reset()

    def reset(self) -> None:
        """Forgets the past: a new performer or sequence."""
        self._body.reset()
        self._filter.reset()
        self._imputer.reset()
        if self._imputation:
            self._imputation.reset()
        self._layout: Layout | None = None
        # The last pose, with its sigma (M,), and the pose before it, so many seconds.
        self._pose: Floats = self._nowhere
        self._sigma: Floats = np.full(len(self._nowhere), np.inf, np.float32)
        self._before: Floats = self._nowhere
        self._step = 1.0
        self._velocity: Floats = self._nowhere  # m/s, of the pose held
        self._shown: Floats | None = None  # the tracked markers as they were taken to be
        self._lacking: Floats | None = None  # the sigma (T,) of those missing, if any are
        self._back: Mask | None = None  # those (T,) that are where they are measured, if not all
        self._held = 0.0  # s since enough markers were there
        self._index: int | None = None
        self._interval = 1.0  # s since the frame before

    def step(self, frame: MarkerFrame) -> Pose:
        """The pose at a frame; with too few tracked markers the last one, and soon all lost."""
        held = self.begin(frame)
        return held or self.finish(frame, self.ask())

    def begin(self, frame: MarkerFrame) -> Pose | None:
        """The first half of a step: all tracked markers, wherever they come from, as `asked`.

        Where too few are there to ask anything, the pose; there is no second half then.
        """
        frames = 1 if self._index is None else frame.index - self._index
        if not 0 < frames <= HOLD * frame.layout.rate:
            self.reset()  # the line was gone for long, or the device started anew
            frames = 1
        if frame.layout is not self._layout:
            self._adopt(frame.layout)
        self._index = frame.index
        self._interval = frames / frame.layout.rate  # lost frames count
        if len(frame.xyz):  # else all are foreign
            frame.xyz.take(self._columns, 0, self._markers, "clip")
        if len(self._foreign):
            self._markers[self._foreign] = np.nan
        measured = self._filter.update(self._markers, self._interval)
        if self._filter.seen < ENOUGH:
            return self._hold(frame)
        tracked = self._complete(measured)
        shown = tracked if self._shown is None else self._shown
        self._shown = tracked
        _into_body(
            *(tracked, shown, self._body.origins, self._body.placement, self._interval),
            *(*self.asked, self._carried),
        )
        return None

    def ask(self) -> Estimate:
        """What the regression says of `asked`; the next call may overwrite it."""
        return self.regression.estimate(*self.asked)

    def finish(self, frame: MarkerFrame, estimate: Estimate) -> Pose:
        """The second half: the pose in the world, by what the regression says of `asked`."""
        in_body, sigma, moving = estimate
        begun = self._pose is not self._nowhere
        if moving is None or not begun:
            moving, keeps = in_body, 0.0
        else:
            keeps = math.exp(-self._interval / STEADY)
        world: Floats = np.empty(in_body.shape, np.float32)
        assert self._shown is not None
        _into_world(
            *(in_body, moving, self._pose, self._body.placement, self._carried),
            *(self._interval, keeps, self._rows, self._shown, world),
        )
        sigma = self._doubted(sigma)
        provenance = self._measured.copy()
        if self._back is not None:
            provenance[self._rows[~self._back]] = Provenance.IMPUTED
        # Where it has just begun, or begun again, nothing is known of how it moves.
        self._before = self._pose if begun and not self._held else world
        self._pose, self._sigma, self._step, self._held = world, sigma, self._interval, 0.0
        return Pose(frame.index, frame.t, world, provenance, sigma)

    def _adopt(self, layout: Layout) -> None:
        """Finds the tracked markers by label."""
        here, columns = layout.places(self.model.info.tracked)
        self._columns = np.zeros(len(self._markers), np.intp)
        self._columns[here] = columns
        self._foreign = np.setdiff1d(np.arange(len(self._markers)), here)  # to the stream
        if self._layout is None or layout.rate != self._layout.rate:
            self.regression.reset(layout.rate)
        self._layout = layout

    def _complete(self, measured: Floats) -> Floats:
        """All tracked markers (T, 3) in the world; the body frame is where they put it."""
        imputer = self._imputer
        self._lacking = self._back = None
        if imputer.whole and self._filter.seen == len(measured) and not self._imputation:
            self._body.update(measured)
            return imputer.pass_on(measured)
        present: Mask = ~np.isnan(measured[:, 0])
        if self._imputation:
            self._back = present
            return self._filled(measured, present, self._imputation)
        tracked, self._lacking = imputer.complete(
            measured, present, self._filter.velocity, self._interval
        )
        self._back = present & (imputer.away < NEAR)
        self._body.place(tracked)
        self._body.learn(measured)
        return tracked

    def _doubted(self, sigma: Floats) -> Floats:
        """The sigma (M,) of a pose, from that of one whose tracked markers are all measured."""
        found = sigma.copy()
        if self._lacking is None:
            found[self._rows] = NOISE
        else:
            _doubt(self._lacking, self._imputer.away, self._influence, self._rows, found)
        return found

    def _filled(self, measured: Floats, present: Mask, imputation: Imputation) -> Floats:
        """All tracked markers (T, 3) in the world, missing ones filled in by another way."""
        self._body.update(measured)
        tracked = self._body.to_body(measured)
        tracked[~present] = 0.0  # a lone origin is there
        tracked[self._features] = imputation.fill(
            np.where(present[:, None], tracked, np.float32(np.nan))[self._features],
            present[self._features],
            self._interval,
        )
        world = self._body.to_world(tracked)
        world[present] = measured[present]
        return world

    def _hold(self, frame: MarkerFrame) -> Pose:
        """With too few markers the pose comes to rest and holds; after a while all of it is lost.

        So do markers that are there: the body stays whole.
        """
        interval, begun = self._interval, self._pose is not self._nowhere
        if begun:
            if not self._held:
                self._velocity = (self._pose - self._before) / np.float32(self._step)
            self._pose = self._pose + self._velocity * np.float32(interval)
            self._velocity = self._velocity * np.float32(np.exp(-interval / REST))
            self._sigma = np.hypot(self._sigma, np.float32(DRIFT * interval))
        self._held += interval
        pose, sigma = self._pose.copy(), self._sigma.copy()
        provenance = np.full(len(pose), Provenance.ESTIMATED, np.uint8)
        provenance[self._rows] = Provenance.IMPUTED
        if not begun or self._held > HOLD:
            provenance[:] = Provenance.LOST
            sigma[:] = np.inf
        if begun:
            self._shown = pose[self._rows]
            self._imputer.hold(self._shown, self._filter.velocity, interval)
        return Pose(frame.index, frame.t, pose, provenance, sigma)


class Jointly:
    """Asks for several performers at a time: networks in one run, which costs little more than for
    one. All estimators are of one model.
    """

    def __init__(self, estimators: Sequence[PoseEstimator]) -> None:
        self._model = estimators[0].model
        self._networks: dict[int, BoundNetworks | CompiledNetworks] = {}

    def estimate(self, estimators: Sequence[PoseEstimator]) -> list[Estimate]:
        """What the regression says of what each of them asks; the next call may overwrite it."""
        if self._model.leaves or len(estimators) < 2:
            return [one.ask() for one in estimators]
        count = len(estimators)
        if count not in self._networks:
            self._networks[count] = self._model.networks(count)
        tracked, velocities = zip(*(one.asked for one in estimators), strict=True)
        return [*self._networks[count].estimate(np.array(tracked), np.array(velocities))]


@compiled("void(f4[::1], f8[::1], f8[:,::1], i8[::1], f4[::1])")
def _doubt(lacking: Floats, away: Array, influence: Array, rows: Rows, sigma: Floats) -> None:
    """Adds to the sigma (M,) of all what those of the tracked markers do to it."""
    variance = lacking.astype(np.float64) ** 2 + away**2
    for marker in range(len(sigma)):
        total = float(sigma[marker]) ** 2
        for row in range(len(variance)):
            total += influence[marker, row] * variance[row]
        sigma[marker] = math.sqrt(total)
    for row in range(len(rows)):
        sigma[rows[row]] = math.sqrt(variance[row] + NOISE**2)


@compiled("void(f4[:,::1], f4[:,::1], i8[::1], f8[::1], f8, f4[:,::1], f4[:,::1], f8[::1])")
def _into_body(
    tracked: Floats,
    shown: Floats,
    origins: Rows,
    placement: Array,
    interval: float,
    x: Floats,
    v: Floats,
    carried: Array,
) -> None:
    """The markers (T, 3), shown elsewhere before, in the body frame, x, and their velocities
    against its origin's, v; and how the origin was carried along.
    """
    body, origin = about_z(placement[3]), (placement[0], placement[1], placement[2])
    moved = (0.0, 0.0, 0.0)
    for row in origins:
        moved = plus(moved, times(1.0 / len(origins), minus(at(tracked, row), at(shown, row))))
    carried[0], carried[1], carried[2] = moved
    for row in range(len(tracked)):
        place = at(tracked, row)
        put(x, row, seen_in(body, minus(place, origin)))
        own = minus(minus(place, at(shown, row)), moved)
        put(v, row, seen_in(body, times(1.0 / interval, own)))


@compiled(
    "void(f4[:,:], f4[:,:], f4[:,::1], f8[::1], f8[::1], f8, f8, i8[::1], f4[:,::1], f4[:,::1])"
)
def _into_world(
    in_body: Floats,
    moving: Floats,
    before: Floats,
    placement: Array,
    carried: Array,
    interval: float,
    keeps: float,
    rows: Rows,
    tracked: Floats,
    world: Floats,
) -> None:
    """The pose (M, 3) as it is said to be in the body frame, but where `keeps` is more than 0 for
    that share on from the pose before, as the body is said to move: how it moves is known better
    than where it is. Of the tracked markers, `rows`, it is known.
    """
    body, origin = about_z(placement[3]), (placement[0], placement[1], placement[2])
    for row in range(len(in_body)):
        place = at(in_body, row)
        if keeps > 0.0:
            way = minus(times(interval, at(moving, row)), place)
            own = turned(body, plus(place, times(keeps, way)))
            kept = minus(plus(at(before, row), (carried[0], carried[1], carried[2])), origin)
            put(world, row, plus(plus(own, times(keeps, kept)), origin))
        else:
            put(world, row, plus(turned(body, place), origin))
    for marker, row in enumerate(rows):
        world[row] = tracked[marker]
