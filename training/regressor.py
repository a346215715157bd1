"""The networks that estimate all markers from those present, each on top of a linear prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.network import Network

UNIT = 0.25  # m: inputs are told in it
STEP = 0.1  # m: the outputs of the members are told in it
POSE = 3 * len(MARKERS)


@dataclass(frozen=True, slots=True, eq=False)
class Regressor:
    """mean: (3F,) metres, of the features. rows: (3F,), which of the T tracked markers each feature
    coordinate is of. skip: (3F + T + 1, 123), the linear prior; share: of what the members add to
    it; members: networks of the same inputs, of which the mean is taken.

    Inputs u: features less their mean in units of UNIT, zero where missing, then the T marks of
    those present; for the prior, a one after them. Pose: prior + share * STEP * the members'
    first 123 outputs. Their other 41 outputs are logarithms of sigma / metre.
    """

    mean: Floats
    rows: npt.NDArray[np.int64]
    skip: Floats
    share: float
    members: tuple[Network, ...] = ()

    @property
    def markers(self) -> int:
        """T, how many are tracked."""
        return len(self.skip) - 1 - len(self.mean)

    def inputs(self, features: Floats, present: Floats) -> Floats:
        """u (n, 3F + T) of features (n, F, 3) and marks (n, T)."""
        flat = features.reshape(len(features), -1)
        shown = (flat - self.mean) * present[:, self.rows] / np.float32(UNIT)
        return np.concatenate([shown, present], axis=1)

    def prior(self, u: Floats) -> Floats:
        """Poses (n, 123), metres."""
        found: Floats = u @ self.skip[:-1] + self.skip[-1]
        return found

    def estimate(self, features: Floats, present: Floats) -> tuple[Floats, Floats]:
        """Poses (n, 41, 3) and sigma (n, 41), metres."""
        u = self.inputs(features, present)
        outputs = np.mean([member.outputs(u) for member in self.members], axis=0)
        pose = self.prior(u) + np.float32(self.share * STEP) * outputs[:, :POSE]
        return pose.reshape(len(u), -1, 3), np.exp(outputs[:, POSE:])

    def last_layer(self) -> tuple[Floats, Floats]:
        """One linear layer, weights (H + 3F + T, 164) and bias (164,), from the last hidden units
        of all members, in turn, and u to the pose in metres and the logarithms of sigma.
        """
        share = np.full(POSE + len(MARKERS), 1.0 / len(self.members), np.float32)
        share[:POSE] *= self.share * STEP
        prior = np.zeros((len(self.skip), len(share)), np.float32)
        prior[:, :POSE] = self.skip
        weights = [member.weights[-2] * share for member in self.members]
        bias = np.sum([member.weights[-1] * share for member in self.members], axis=0)
        return np.concatenate([*weights, prior[:-1]]), bias + prior[-1]

    def with_sigma(self, factor: npt.NDArray[np.float64]) -> Regressor:
        """The same with every sigma multiplied by its marker's factor (41,)."""
        more = np.zeros(POSE + len(MARKERS), np.float32)
        more[POSE:] = np.log(factor)
        changed = (
            Network([*member.weights[:-1], member.weights[-1] + more]) for member in self.members
        )
        return replace(self, members=tuple(changed))


@dataclass(frozen=True, slots=True, eq=False)
class Networks:
    """What runs per frame. whole: where all tracked markers are present; part: where some lack."""

    whole: Regressor
    part: Regressor

    def estimate(self, features: Floats, present: Floats) -> tuple[Floats, Floats]:
        """Poses (n, 41, 3) and sigma (n, 41), metres, as `Regressor.estimate`."""
        used = self.whole if present.all() else self.part
        return used.estimate(features, present)
