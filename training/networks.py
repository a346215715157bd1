"""The three networks of a model, each on top of a linear prior (docs/decisions/0016, 0019).

T tracked markers, M = 41 in all. Positions are metres in the body frame, velocities m/s in its
axes, against its origin's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.local_models import affine
from training.network import Network

UNIT = 0.25  # m: positions are told in it
STEP = 0.1  # m: what a network adds to a position is told in it
POSE = 3 * len(MARKERS)
SLOW = 0.05  # m/s: a body slower than this is as one at rest
PACE = 1.0  # m/s: the velocities of missing markers are told in it
COAST = 0.15  # s: for about so long a missing marker goes on as it went
FADES = (0.08, 0.15, 0.5)  # s: time constants with which what the others tell comes in
FADE = 1  # the one of FADES that the network's own share comes in with
MEMORIES = (0.1, 0.3, 1.0)  # s: time constants that a missing marker's age is told in
AGE = 0.3  # s: unit of the age's logarithm
FAR = 0.5  # m: what a body has left farther behind is as far
OLDEST = 3.0  # s: ages beyond are told as this


@dataclass(frozen=True, slots=True, eq=False)
class PoseNetwork:
    """From tracked markers to all. mean: (3T,); prior: (3T + 1, 123), with its constant.

    Inputs u: positions less their mean, in UNIT. Pose: prior + STEP * the first 123 outputs; the
    other 41 are logarithms of sigma / metre.
    """

    mean: Floats
    prior: Floats
    network: Network

    def inputs(self, tracked: Floats) -> Floats:
        """u (n, 3T) of tracked markers (n, T, 3)."""
        return _scaled(tracked, self.mean)

    def linear(self, u: Floats) -> Floats:
        """(n, 123) metres: what the prior says."""
        found: Floats = u @ self.prior[:-1] + self.prior[-1]
        return found

    def estimate(self, tracked: Floats) -> tuple[Floats, Floats]:
        """Poses (n, 41, 3) and sigma (n, 41), metres."""
        u = self.inputs(tracked)
        outputs = self.network.outputs(u)
        pose = self.linear(u) + np.float32(STEP) * outputs[:, :POSE]
        return pose.reshape(len(u), -1, 3), np.exp(outputs[:, POSE:])

    def last_layer(self) -> tuple[Floats, Floats]:
        """Weights (H + 3T, 164) and bias (164,), from the last hidden units and u to the pose in
        metres and the logarithms of sigma.
        """
        scale = np.ones(POSE + len(MARKERS), np.float32)
        scale[:POSE] = STEP
        prior = np.zeros((len(self.prior), len(scale)), np.float32)
        prior[:, :POSE] = self.prior
        weights, bias = self.network.weights[-2:]
        return np.concatenate([weights * scale, prior[:-1]]), bias * scale + prior[-1]


@dataclass(frozen=True, slots=True, eq=False)
class VelocityNetwork:
    """From the tracked markers' velocities to those of all. prior: (3T, 123).

    Velocities are told in the body's speed, the root mean square of the tracked markers' and SLOW:
    a pose is gone through alike at any. Inputs: u of the positions as `PoseNetwork` has it, then
    the velocities. Outputs are added to the prior of the velocities, all in the body's speed.
    """

    mean: Floats
    prior: Floats
    network: Network

    def inputs(self, tracked: Floats, velocity: Floats) -> tuple[Floats, Floats]:
        """(n, 6T) of tracked markers (n, T, 3) and their velocities (n, T, 3); speed (n, 1)."""
        flat = velocity.reshape(len(velocity), -1)
        speed = np.sqrt((flat**2).mean(axis=1, keepdims=True) + np.float32(SLOW**2))
        return np.concatenate([_scaled(tracked, self.mean), flat / speed], axis=1), speed

    def last_layer(self) -> tuple[Floats, Floats]:
        """Weights (H + 6T, 123) and bias (123,), from the last hidden units and the inputs."""
        weights, bias = self.network.weights[-2:]
        still = np.zeros((len(self.mean), POSE), np.float32)
        return np.concatenate([weights, still, self.prior]), bias

    def estimate(self, tracked: Floats, velocity: Floats) -> Floats:
        """The velocities (n, 41, 3) of all markers, m/s."""
        inputs, speed = self.inputs(tracked, velocity)
        found = inputs[:, len(self.mean) :] @ self.prior + self.network.outputs(inputs)
        scaled: Floats = (found * speed).reshape(len(inputs), -1, 3)
        return scaled


@dataclass(frozen=True, slots=True, eq=False)
class Missing:
    """Frames that lack a marker, and the last frame that had it. tracked: (n, T, 3), zero where
    missing; present: (n, T), 0 or 1. then: (n, T, 3), as the markers were in the body frame then;
    left: (n, T, 3), the same places of the world in the body frame of now; pace: (n, T, 3) m/s,
    velocities in the world then, in the axes of now; age: (n,), seconds since.
    """

    tracked: Floats
    present: Floats
    then: Floats
    left: Floats
    pace: Floats
    age: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RecallNetwork:
    """Missing markers, from those present and the last sighting.

    prior: (3 (D + 1), 3T), the inputs' linear maps that come in with each of FADES. A marker that
    goes missing goes on through the world as it went, and after COAST it is with the body where it
    was. The prior comes in beside that, and STEP * the first 3T outputs with the fade FADE; the
    other T are logarithms of sigma / metre.
    """

    mean: Floats
    prior: Floats
    network: Network

    def inputs(self, missing: Missing) -> Floats:
        """(n, D): positions now; how far those present have come since, within the body; where the
        missing were, how far the body has left that behind, and their velocity; which are present;
        how long it is since. D = 16 T + 4.
        """
        mean = self.mean.reshape(-1, 3)
        there = missing.present[:, :, None]
        gone = np.float32(1.0) - there
        unit = np.float32(1.0 / UNIT)
        age = np.minimum(missing.age, np.float32(OLDEST))[:, None]
        parts = [
            (missing.tracked - mean) * there * unit,
            (missing.tracked - missing.then) * there * unit,
            (missing.then - mean) * gone * unit,
            _bounded(missing.left - missing.then) * gone * unit,
            missing.pace * gone * np.float32(1.0 / PACE),
        ]
        memory = np.exp(-age / np.array(MEMORIES, np.float32))
        flat = [part.reshape(len(age), -1) for part in parts]
        told = [*flat, missing.present, memory, np.log(age / np.float32(AGE))]
        found: Floats = np.concatenate(told, axis=1).astype(np.float32)
        return found

    def begin(self, missing: Missing) -> Floats:
        """(n, 3T): where markers are that go on as they went, at first."""
        age = missing.age[:, None, None]
        going = 1.0 / (1.0 + (age / np.float32(COAST)) ** 4)
        gone_on = missing.left + missing.pace * age
        found = missing.then + going * (gone_on - missing.then)
        return found.reshape(len(age), -1).astype(np.float32)

    def linear(self, inputs: Floats, age: Floats) -> Floats:
        """(n, 3T): what the prior adds to where they began."""
        return faded(inputs, age) @ self.prior

    def estimate(self, missing: Missing) -> tuple[Floats, Floats]:
        """All tracked markers (n, T, 3), of which the missing ones count, and sigma (n, T)."""
        inputs = self.inputs(missing)
        outputs = self.network.outputs(inputs)
        width = len(self.mean)
        found = self.begin(missing) + self.linear(inputs, missing.age)
        found += share(missing.age) * np.float32(STEP) * outputs[:, :width]
        return found.reshape(len(inputs), -1, 3), np.exp(outputs[:, width:])


@dataclass(frozen=True, slots=True, eq=False)
class Networks:
    """What runs per frame: `pose` and `velocity` from all tracked markers, and before them `recall`
    where some are missing.
    """

    pose: PoseNetwork
    velocity: VelocityNetwork
    recall: RecallNetwork

    def with_sigma(
        self, pose: npt.NDArray[np.float64], recall: npt.NDArray[np.float64]
    ) -> Networks:
        """The same with every sigma multiplied by its marker's factor: (41,), and (T,) of missing
        tracked markers.
        """
        return replace(
            self,
            pose=replace(self.pose, network=_with_sigma(self.pose.network, pose)),
            recall=replace(self.recall, network=_with_sigma(self.recall.network, recall)),
        )


def faded(inputs: Floats, age: Floats) -> Floats:
    """(n, 3 (D + 1)): inputs (n, D) and a one, as they come in with each of FADES."""
    rows = affine(inputs)
    parts = [rows * fade_in(age, fade) for fade in FADES]
    return np.concatenate(parts, axis=1)


def fade_in(age: Floats, fade: float) -> Floats:
    """(n, 1): from 0 to 1 as a marker's own past says less of it, by its age (n,), s.

    A marker does not leave the way that it was on at once: at first this grows by the cube.
    """
    found: Floats = (-np.expm1(-age[:, None] / np.float32(fade))) ** 3
    return found


def share(age: Floats) -> Floats:
    """(n, 1): how much of the network's own output counts at an age (n,), s."""
    return fade_in(age, FADES[FADE])


def _scaled(tracked: Floats, mean: Floats) -> Floats:
    """Positions (n, 3T) of tracked markers (n, T, 3), less their mean (3T,), in UNIT."""
    found: Floats = (tracked.reshape(len(tracked), -1) - mean) / np.float32(UNIT)
    return found


def _bounded(way: Floats) -> Floats:
    """Each coordinate, m, to FAR at most: one that is far is no more than that."""
    found: Floats = way / np.sqrt(1.0 + (way * np.float32(1.0 / FAR)) ** 2)
    return found


def _with_sigma(network: Network, factor: npt.NDArray[np.float64]) -> Network:
    """The last outputs, as many as there are factors, are logarithms of sigma."""
    bias = network.weights[-1].copy()
    bias[-len(factor) :] += np.log(factor).astype(np.float32)
    return Network([*network.weights[:-1], bias])
