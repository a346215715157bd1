"""`bridge.estimator` in numpy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.body_frame import CONSTRUCTIONS
from bridge.estimator import DRIFT, ENOUGH, HOLD, NOISE, REST, STEADY, influence
from bridge.imputation import Imputation
from bridge.imputer import NEAR
from bridge.model import Model, ModelInfo
from bridge.pose import Pose, Provenance
from bridge.regression import features_of, regression_of
from drivers.frame import Floats, Layout, MarkerFrame
from tests.bridge.reference.body_frame import BodyFrame
from tests.bridge.reference.imputer import Imputer
from tests.bridge.reference.smoothing import NoiseFilter

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def body_frame(info: ModelInfo) -> BodyFrame:
    """The body frame of a model's tracked markers, with what the model knows of them."""
    features = [info.tracked.index(label) for label in info.features]
    # A lone origin is no feature: at zero, and stiff to the body by definition.
    mean = np.zeros((len(info.tracked), 3))
    mean[features] = info.mean
    spread = np.zeros(len(info.tracked))
    spread[features] = np.sqrt(np.diag(info.covariance).reshape(-1, 3).mean(axis=1))
    return BodyFrame(info.tracked, mean, spread, CONSTRUCTIONS[info.body_frame])


class PoseEstimator:
    """See `bridge.estimator.PoseEstimator`."""

    def __init__(
        self,
        model: Model,
        history: int | None = None,
        imputation: Imputation | None = None,
    ) -> None:
        info = model.info
        self.model = model
        self.history = model.info.history if history is None else history
        self.regression = regression_of(model, self.history)
        self._tracked = info.tracked
        self._features = features_of(info)
        self._rows = np.array([info.labels.index(label) for label in info.tracked])
        self._body = body_frame(info)
        self._filter = NoiseFilter(len(info.tracked))
        usual = np.zeros((len(info.tracked), 3))
        usual[self._features] = info.mean
        self._imputer = Imputer(self.regression, self._body, usual)
        self._influence = influence(info)
        self._imputation = imputation
        self._nowhere: Floats = np.full((len(info.labels), 3), np.nan, np.float32)
        # Where all tracked markers are measured.
        self._measured = np.full(len(info.labels), Provenance.ESTIMATED, np.uint8)
        self._measured[self._rows] = Provenance.MEASURED
        self._layout: Layout | None = None
        self.reset()

    def reset(self) -> None:
        """Forgets the past: a new performer or sequence."""
        self._body.reset()
        self._filter.reset()
        self._imputer.reset()
        if self._imputation:
            self._imputation.reset()
        self._layout = None
        # The last pose, with its sigma (M,), and the pose before it, so many seconds.
        self._pose: Floats = self._nowhere
        self._sigma: Floats = np.full(len(self._nowhere), np.inf, np.float32)
        self._before: Floats = self._nowhere
        self._step = 1.0
        self._velocity: Floats = self._nowhere  # m/s, of the pose held
        self._shown: Floats | None = None  # the tracked markers as they were taken to be
        self._held = 0.0  # s since enough markers were there
        self._index: int | None = None

    def step(self, frame: MarkerFrame) -> Pose:
        """The pose at a frame; with too few tracked markers the last one, and soon all lost."""
        frames = 1 if self._index is None else frame.index - self._index
        if not 0 < frames <= HOLD * frame.layout.rate:
            self.reset()  # the line was gone for long, or the device started anew
            frames = 1
        if frame.layout is not self._layout:
            self._adopt(frame.layout)
        self._index = frame.index
        interval = frames / frame.layout.rate  # lost frames count
        measured: Floats = np.full((len(self._tracked), 3), np.nan, np.float32)
        measured[self._carried] = frame.xyz[self._columns]
        measured = self._filter.update(measured, interval)
        present: Mask = ~np.isnan(measured[:, 0])
        if present.sum() < ENOUGH:
            return self._hold(frame, interval)
        if self._imputation:
            pose, sigma = self._filled(measured, present, interval, self._imputation)
            back = present
        else:
            pose, sigma = self._estimate(measured, present, interval)
            back = present & (self._imputer.away < NEAR)
        provenance = self._measured.copy()
        if not back.all():
            provenance[self._rows[~back]] = Provenance.IMPUTED
        # Where it has just begun, or begun again, nothing is known of how it moves.
        goes_on = not self._held and self._pose is not self._nowhere
        self._before, self._step = (self._pose, interval) if goes_on else (pose, interval)
        self._pose, self._sigma, self._held = pose, sigma, 0.0
        return Pose(frame.index, frame.t, pose, provenance, sigma)

    def _adopt(self, layout: Layout) -> None:
        """Finds the tracked markers by label."""
        self._carried, self._columns = layout.places(self._tracked)
        if self._layout is None or layout.rate != self._layout.rate:
            self.regression.reset(layout.rate)
        self._layout = layout

    def _estimate(self, measured: Floats, present: Mask, interval: float) -> tuple[Floats, Floats]:
        """The pose (M, 3) in the world and its sigma (M,): all tracked markers first, wherever
        they come from, then all others.
        """
        imputer = self._imputer
        if imputer.whole and present.all():
            tracked, lacking = imputer.pass_on(measured), None
        else:
            tracked, lacking = imputer.complete(measured, present, self._filter.velocity, interval)
        self._body.place(tracked)
        self._body.learn(measured)
        world, sigma = self._whole(tracked, interval)
        if lacking is not None:
            variance = lacking.astype(float) ** 2 + imputer.away**2
            sigma = np.sqrt(sigma**2 + self._influence @ variance).astype(np.float32)
            sigma[self._rows] = np.sqrt(variance + NOISE**2)
        return world, sigma

    def _whole(self, tracked: Floats, interval: float) -> tuple[Floats, Floats]:
        """The pose (M, 3) in the world and its sigma (M,), as if all tracked markers (T, 3) were
        measured. The body frame is where they put it.
        """
        body = self._body
        moved = tracked - (tracked if self._shown is None else self._shown)
        self._shown = tracked
        carried = body.at_origin(moved)
        velocity = (moved - carried) @ body.rotation / interval
        pose, sigma, moving = self.regression.estimate(
            body.to_body(tracked), velocity.astype(np.float32)
        )
        if moving is not None and self._pose is not self._nowhere:
            # On from the pose before, as the body moves, and a little towards where it is said to
            # be: how it moves is known better than where it is.
            keeps = np.float32(math.exp(-interval / STEADY))
            way = moving * np.float32(interval) - pose
            kept = self._pose + (carried - body.origin).astype(np.float32)
            world: Floats = body.to_world(pose + keeps * way) + keeps * kept
        else:
            world = body.to_world(pose)
        world[self._rows] = tracked
        sigma[self._rows] = NOISE
        return world, sigma

    def _filled(
        self, measured: Floats, present: Mask, interval: float, imputation: Imputation
    ) -> tuple[Floats, Floats]:
        """The pose and its sigma with missing markers filled in by another way."""
        self._body.update(measured)
        tracked = self._body.to_body(measured)
        tracked[~present] = 0.0  # a lone origin is there
        tracked[self._features] = imputation.fill(
            np.where(present[:, None], tracked, np.float32(np.nan))[self._features],
            present[self._features],
            interval,
        )
        world = self._body.to_world(tracked)
        world[present] = measured[present]
        return self._whole(world, interval)

    def _hold(self, frame: MarkerFrame, interval: float) -> Pose:
        """With too few markers the pose comes to rest and holds; after a while all of it is lost.

        So do markers that are there: the body stays whole.
        """
        begun = self._pose is not self._nowhere
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
