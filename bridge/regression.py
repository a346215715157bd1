"""What a model says of one frame: the whole pose in the body frame, from the tracked markers, and
where missing ones are.

A pose has the M markers of the model, in its order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bridge.imputation import ConditionalGaussian
from bridge.model import Model, ModelInfo
from bridge.networks import CompiledNetworks
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The pose (M, 3) in the body frame, its standard deviation (M,) per coordinate, and how it moves
# (M, 3), m/s, where that is known.
Estimate = tuple[Floats, Floats, Floats | None]

FADE = 0.5  # s: time constant with which a mixture forgets a last sighting (docs/decisions/0005)
COAST = 0.1  # s: for about so long a missing marker goes on as it went
_RATE = 120.0  # Hz: what the model's history is counted in


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """The last frames with n markers each. then: (n, T, 3) metres, where all tracked markers were
    in the body frame; left: (n, T, 3), the same places of the world in the body frame of now; pace:
    (n, T, 3) m/s, how they moved in the world, in the axes of now; age: (n,), seconds since.
    """

    then: Floats
    left: Floats
    pace: Floats
    age: Array


class Regression(Protocol):
    """A way to estimate poses, with what it keeps of the frames before."""

    def reset(self, rate: float) -> None:
        """Forgets the past: a new performer, or another rate, Hz."""

    def recall(
        self, tracked: Floats, present: Mask, sightings: Sightings, placed: float
    ) -> tuple[Floats, Floats]:
        """Where missing markers are, by n last sightings: the tracked markers (n, T, 3), of which
        those missing count, and their standard deviations per coordinate (n, T), metres.

        tracked: (T, 3) metres, in the body frame; present: (T,), those that count. placed: standard
        deviation of the body frame's origin now, metres.
        """

    def estimate(self, tracked: Floats, velocity: Floats) -> Estimate:
        """The estimate at a frame; what it says of tracked markers is of no use. The frame becomes
        the past of those to come.

        tracked: (T, 3) metres, in the body frame, all there; velocity: (T, 3) m/s, theirs against
        the origin's, in the body's axes, as all velocities here. The next call may overwrite what
        this one gives.
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
    """Networks for the pose, its velocities and missing markers. Each frame is for itself."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._networks = model.networks(1)

    def reset(self, rate: float) -> None:
        """There is no past to forget."""

    def leaf(self) -> int:
        """There is one model for all frames."""
        return 0

    def recall(
        self, tracked: Floats, present: Mask, sightings: Sightings, placed: float
    ) -> tuple[Floats, Floats]:
        """See `Regression`. The network has learned what a body frame out of place costs."""
        if isinstance(self._networks, CompiledNetworks):
            parts = sightings.then, sightings.left, sightings.pace, sightings.age
            return self._networks.recall(tracked, present, *parts)
        count, width = len(sightings.age), tracked.size
        shown: Floats = np.zeros((count, *tracked.shape), np.float32)
        shown[:, present] = tracked[present]
        memory: Floats = np.empty((count, 3 * width + 1), np.float32)
        for part, held in enumerate((sightings.then, sightings.left, sightings.pace)):
            memory[:, part * width : (part + 1) * width] = held.reshape(count, width)
        memory[:, -1] = sightings.age
        there: Floats = np.empty((count, len(present)), np.float32)
        there[:] = present
        return self._model.recall(shown.reshape(count, width), there, memory)

    def estimate(self, tracked: Floats, velocity: Floats) -> Estimate:
        """See `Regression`."""
        return self._networks.estimate(tracked[None], velocity[None])[0]


class MixtureRegression:
    """Local linear models, mixed by a forest over the frames before (paper 3.3 and 3.4).

    Missing markers are those that a Gaussian expects from the others, with what the last sighting
    was off by it, which fades. history: frames of 1/120 s before the present one that the mixture
    weighs in.
    """

    def __init__(self, model: Model, history: int) -> None:
        info = model.info
        self._model = model
        self._history = history
        self._features = features_of(info)
        self._unworn = np.array([info.labels.index(label) for label in info.unworn])
        self._gaussian = ConditionalGaussian(info.mean, info.covariance)
        self._sigma: Floats = np.zeros(len(info.labels), np.float32)
        self._sigma[self._unworn] = info.sigma
        self._pose: Floats = np.zeros((len(info.labels), 3), np.float32)
        self.reset(_RATE)

    def reset(self, rate: float) -> None:
        """Forgets the leaf weights of the frames before."""
        length = max(0, round(self._history * rate / _RATE))
        self._mixture = self._model.mixture(np.zeros((length, self._model.leaves), np.float32))
        self._oldest = 0

    @property
    def leaf_weights(self) -> Floats:
        """(K,) of the frame estimated last; zero before the first."""
        weights: Floats = self._mixture.p[0]
        return weights

    def leaf(self) -> int:
        """The leaf with most votes."""
        return int(self.leaf_weights.argmax())

    def recall(
        self, tracked: Floats, present: Mask, sightings: Sightings, placed: float
    ) -> tuple[Floats, Floats]:
        """See `Regression`."""
        then, age = sightings.then, sightings.age[:, None, None]
        keeps = np.exp(-age / FADE)
        # On through the world as it went, at first; then with the body.
        way = sightings.left + sightings.pace * age - then
        gone_on = way / (1.0 + (age / COAST) ** 4)
        guessed = np.array([self._expected(one, present) for one in then])
        found = self._expected(tracked, present) + keeps * (then - guessed + gone_on)
        uncertainty = self._gaussian.uncertainty(present[self._features])
        variance = np.zeros(len(tracked))
        variance[self._features] = np.diag(uncertainty).reshape(-1, 3).mean(axis=1)
        sigma = np.sqrt((1.0 - keeps[:, :, 0] ** 2) * variance + placed**2)
        return found.astype(np.float32), sigma.astype(np.float32)

    def _expected(self, tracked: Floats, present: Mask) -> Floats:
        """The tracked markers (T, 3) as those present tell them; a lone origin is at zero."""
        found = np.zeros_like(tracked)
        there = present[self._features]
        found[self._features] = self._gaussian.fill(tracked[self._features], there)
        return found

    def estimate(self, tracked: Floats, velocity: Floats) -> Estimate:
        """See `Regression`. Local models know nothing of velocities."""
        mixture, history = self._mixture, self._mixture.history
        mixture.x[0] = tracked[self._features].ravel()[: mixture.x.size]
        mixture.run()
        if len(history):
            history[self._oldest] = mixture.p[0]
            self._oldest = (self._oldest + 1) % len(history)
        self._pose[self._unworn] = mixture.z.reshape(-1, 3)
        return self._pose, self._sigma, None
