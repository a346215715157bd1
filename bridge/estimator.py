"""From marker frames to poses: body frame, imputation, estimate, back to the world."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bridge.body_frame import BodyFrame
from bridge.imputation import PATTERNS, ConditionalGaussian, Imputation, Imputer
from bridge.model import Model, ModelInfo
from bridge.pose import Pose, Provenance
from drivers.frame import Floats, Layout, MarkerFrame

Mask = npt.NDArray[np.bool_]
NOISE = 0.001  # m: standard deviation of a measured coordinate


def body_frame(info: ModelInfo) -> BodyFrame:
    """The body frame of a model's tracked markers, with what the model knows of them."""
    features = [info.tracked.index(label) for label in info.features]
    # The origin is C7: at zero, and stiff to the body by definition.
    mean = np.zeros((len(info.tracked), 3))
    mean[features] = info.mean
    spread = np.zeros(len(info.tracked))
    spread[features] = np.sqrt(np.diag(info.covariance).reshape(-1, 3).mean(axis=1))
    return BodyFrame(info.tracked, mean, spread)


class PoseEstimator:
    """One performer's state and the model. Call `step` with each frame in turn.

    It never reads a clock, and uses the tracked markers alone: what else a stream carries is
    ignored, so the same person moves the same whatever else the device sends.

    history: frames of 1/120 s before the present one that the mixture weighs in; the model's own
    where not given. leaf_weights: (K,) float32, those of the last frame with a marker in it; zeros
    before the first. imputation: what fills in missing markers; `Imputer` where not given.
    """

    def __init__(
        self,
        model: Model,
        history: int | None = None,
        imputation: Imputation | None = None,
    ) -> None:
        info = model.info
        self.model = model
        self.history = info.history if history is None else history
        self._tracked = info.tracked
        self._features = np.array([info.tracked.index(label) for label in info.features])
        self._out_tracked = np.array([info.labels.index(label) for label in info.tracked])
        self._out_unworn = np.array([info.labels.index(label) for label in info.unworn])
        self._body = body_frame(info)
        self._gaussian = ConditionalGaussian(info.mean, info.covariance)
        self._imputer = imputation or Imputer(self._gaussian)
        self._sigma = np.array(info.sigma)
        self._sensitivity = np.array(info.sensitivity)
        self._sigma_cache: dict[bytes, tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]] = {}
        self._layout: Layout | None = None
        self.reset()

    def reset(self) -> None:
        """Forgets the past: a new performer or sequence."""
        self._body.reset()
        self._imputer.reset()
        self._history: Floats = np.zeros((0, self.model.leaves), np.float32)
        self._oldest = 0
        self.leaf_weights: Floats = np.zeros(self.model.leaves, np.float32)
        self._layout = None
        self._last: Floats = np.full((len(self.model.info.labels), 3), np.nan, np.float32)

    def step(self, frame: MarkerFrame) -> Pose:
        """The pose at a frame; with no tracked marker in it, the last one, all of it lost."""
        if frame.layout is not self._layout:
            self._adopt(frame.layout)
        info, body = self.model.info, self._body
        tracked: Floats = np.full((len(self._tracked), 3), np.nan, np.float32)
        tracked[self._carried] = frame.xyz[self._rows]
        present: Mask = ~np.isnan(tracked[:, 0])
        tracked[~present] = np.nan
        body.update(tracked)

        labels = len(info.labels)
        if not present.any():
            provenance = np.full(labels, Provenance.LOST, np.uint8)
            sigma = np.full(labels, np.inf, np.float32)
            return Pose(frame.index, frame.t, self._last, provenance, sigma)

        features = self._imputer.fill(
            body.to_body(tracked[self._features]),
            present[self._features],
            1.0 / frame.layout.rate,
        )
        z, p = self.model.run(features.reshape(1, -1)[:, : self.model.width], self._history)
        self.leaf_weights = p[0]
        if len(self._history):
            self._history[self._oldest] = p[0]
            self._oldest = (self._oldest + 1) % len(self._history)

        filled = np.zeros((len(self._tracked), 3), np.float32)
        filled[self._features] = features
        xyz: Floats = np.empty((labels, 3), np.float32)
        xyz[self._out_unworn] = body.to_world(z.reshape(-1, 3))
        # What was measured goes out as it came in, to the last bit.
        xyz[self._out_tracked] = np.where(present[:, None], tracked, body.to_world(filled))
        provenance = np.full(labels, Provenance.ESTIMATED, np.uint8)
        provenance[self._out_tracked] = np.where(present, Provenance.MEASURED, Provenance.IMPUTED)
        self._last = xyz
        return Pose(frame.index, frame.t, xyz, provenance, self._pose_sigma(present))

    def _adopt(self, layout: Layout) -> None:
        """Finds the tracked markers by label; keeps the history's length in seconds."""
        rows = {label: row for row, label in enumerate(layout.labels)}
        self._carried = np.array([label in rows for label in self._tracked])
        self._rows = np.array([rows[label] for label in self._tracked if label in rows], int)
        if self._layout is None or layout.rate != self._layout.rate:
            length = max(0, round(self.history * layout.rate / 120.0))
            self._history = np.zeros((length, self.model.leaves), np.float32)
            self._oldest = 0
        self._layout = layout

    def _pose_sigma(self, present: Mask) -> Floats:
        """Error per coordinate: of the estimate, of what was imputed, and of the body frame."""
        key = present.tobytes()
        if key not in self._sigma_cache:
            if len(self._sigma_cache) >= PATTERNS:
                self._sigma_cache.clear()
            covariance = self._gaussian.uncertainty(present[self._features])
            moved = np.einsum("if,fg,ig->i", self._sensitivity, covariance, self._sensitivity)
            variance = np.zeros(len(self.model.info.labels))
            variance[self._out_unworn] = self._sigma**2 + moved.reshape(-1, 3).mean(axis=1)
            tracked = np.full(len(self._tracked), 0.0)
            tracked[self._features] = np.diag(covariance).reshape(-1, 3).mean(axis=1)
            variance[self._out_tracked] = np.where(present, NOISE**2, tracked)
            follows = np.ones(len(variance), bool)
            follows[self._out_tracked] = ~present
            self._sigma_cache[key] = variance, follows.astype(float)
        variance, follows = self._sigma_cache[key]
        sigma: Floats = np.sqrt(variance + follows * self._body.sigma**2).astype(np.float32)
        return sigma
