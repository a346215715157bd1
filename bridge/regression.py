"""What a model says of one frame: the whole pose in the body frame, from the tracked markers.

A pose has the M markers of the model, in its order.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from bridge.imputation import PATTERNS, ConditionalGaussian
from bridge.model import Model, ModelInfo
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_RATE = 120.0  # Hz: what the model's history is counted in


class Regression(Protocol):
    """A way to estimate poses, with what it keeps of the frames before."""

    def reset(self, rate: float) -> None:
        """Forgets the past: a new performer, or another rate, Hz."""

    def guess(self, tracked: Floats, present: Mask, placed: float) -> tuple[Floats, Floats]:
        """The tracked markers (T, 3) where those that are missing are likely to be, and the
        standard deviation (M,) of a pose that only the others are known of, metres.

        tracked: (T, 3) metres, in the body frame; present: (T,), those that count. placed: standard
        deviation of the body frame's origin, metres.
        """

    def estimate(self, tracked: Floats) -> tuple[Floats, Floats]:
        """The pose (M, 3) and its standard deviation (M,) per coordinate, metres; what it says of
        tracked markers is of no use. The frame becomes the past of those to come.

        tracked: (T, 3) metres, in the body frame, all there.
        """

    def leaf(self) -> int:
        """The local model that weighed most in the frame estimated last; 0 where there is one."""


def features_of(info: ModelInfo) -> npt.NDArray[np.intp]:
    """(F,): which of the tracked markers are features."""
    return np.array([info.tracked.index(label) for label in info.features], np.intp)


def regression_of(model: Model, history: int) -> Regression:
    """The regression that a model file holds."""
    return MixtureRegression(model, history) if model.leaves else NetworkRegression(model)


class NetworkRegression:
    """Networks, one of which is told which markers are missing. Each frame is for itself."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._shape = len(model.info.labels), 3
        self._features = features_of(model.info)
        self._rows = np.array([model.info.labels.index(label) for label in model.info.tracked])
        self._all = np.ones((1, len(model.info.tracked)), np.float32)

    def reset(self, rate: float) -> None:
        """There is no past to forget."""

    def leaf(self) -> int:
        """There is one model for all frames."""
        return 0

    def guess(self, tracked: Floats, present: Mask, placed: float) -> tuple[Floats, Floats]:
        """See `Regression`. The network has learned what a body frame out of place costs."""
        shown = np.where(present[:, None], tracked, np.float32(0.0))
        x = shown[self._features].reshape(1, -1)
        z, sigma = self._model.regress(x, present[None].astype(np.float32))
        return z.reshape(self._shape)[self._rows], sigma[0]

    def estimate(self, tracked: Floats) -> tuple[Floats, Floats]:
        """See `Regression`."""
        z, sigma = self._model.regress(tracked[self._features].reshape(1, -1), self._all)
        return z.reshape(self._shape), sigma[0]


class MixtureRegression:
    """Local linear models, mixed by a forest over the frames before (paper 3.3 and 3.4).

    Missing features are those that a Gaussian expects from the others. history: frames of 1/120 s
    before the present one that the mixture weighs in.
    """

    def __init__(self, model: Model, history: int) -> None:
        info = model.info
        self._model = model
        self._history = history
        self._features = features_of(info)
        self._unworn = np.array([info.labels.index(label) for label in info.unworn])
        self._rows = np.array([info.labels.index(label) for label in info.features])
        self._gaussian = ConditionalGaussian(info.mean, info.covariance)
        self._variance = np.zeros(len(info.labels))
        self._variance[self._unworn] = np.array(info.sigma) ** 2
        self._sensitivity = np.array(info.sensitivity)
        self._variances: dict[bytes, Array] = {}
        self.reset(_RATE)

    def reset(self, rate: float) -> None:
        """Forgets the leaf weights of the frames before."""
        length = max(0, round(self._history * rate / _RATE))
        self._weights: Floats = np.zeros((length, self._model.leaves), np.float32)
        self._oldest = 0
        self.leaf_weights: Floats = np.zeros(self._model.leaves, np.float32)

    def leaf(self) -> int:
        """The leaf with most votes."""
        return int(self.leaf_weights.argmax())

    def guess(self, tracked: Floats, present: Mask, placed: float) -> tuple[Floats, Floats]:
        """See `Regression`."""
        there = present[self._features]
        guessed = np.zeros_like(tracked)  # a lone origin is no feature: at zero
        guessed[self._features] = self._gaussian.fill(tracked[self._features], there)
        sigma: Floats = np.sqrt(self._lacking(there) + placed**2).astype(np.float32)
        return guessed, sigma

    def estimate(self, tracked: Floats) -> tuple[Floats, Floats]:
        """See `Regression`."""
        x = tracked[self._features].reshape(1, -1)[:, : self._model.width]
        z, p = self._model.run(x, self._weights)
        self.leaf_weights = p[0]
        if len(self._weights):
            self._weights[self._oldest] = p[0]
            self._oldest = (self._oldest + 1) % len(self._weights)
        pose = np.zeros((len(self._variance), 3), np.float32)
        pose[self._unworn] = z.reshape(-1, 3)
        return pose, np.sqrt(self._variance).astype(np.float32)

    def _lacking(self, there: Mask) -> Array:
        """Variance (M,) of the estimate, and of what was imputed."""
        key = there.tobytes()
        if key not in self._variances:
            if len(self._variances) >= PATTERNS:
                self._variances.clear()
            covariance = self._gaussian.uncertainty(there)
            moved = np.einsum("if,fg,ig->i", self._sensitivity, covariance, self._sensitivity)
            variance = self._variance.copy()
            variance[self._unworn] += moved.reshape(-1, 3).mean(axis=1)
            variance[self._rows] = np.diag(covariance).reshape(-1, 3).mean(axis=1)
            self._variances[key] = variance
        return self._variances[key]
