"""The networks of a model, compiled: for one frame, or one missing marker, at a time.

The same as the graph of the model file computes (docs/model-file.md, training/export.py), from the
same weights, in less time, and where the thread has slept since the last frame in far less: there
is little code that has to come from memory. The graph is the check: whoever makes these compares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled, inlined
from bridge.onnx_file import Constant, Constants
from drivers.frame import Floats

Bits = npt.NDArray[np.int32]
Sizes = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What networks compute with; all that run them share it, and the caches that hold it.

    Sizes of the inputs and the hidden layers, and weights in the order in which they are used: of
    each layer the matrix, row by row, then the bias. mean: (3T,) m, and unit, m: how positions are
    told. slow: (m/s)², of a body as good as at rest. Of a missing marker: prior, what is linear in
    where it is, likewise; told, (6,) of which a last sighting is told, in the order of `_TOLD`; per
    fade and per memory, 1/s.
    """

    markers: int
    mean: Floats
    unit: float
    slow: float
    pose_sizes: Sizes
    pose: Floats
    velocity_sizes: Sizes
    velocity: Floats
    recall_sizes: Sizes
    recall: Floats
    prior: Floats
    told: Floats
    per_fade: Floats
    per_memory: Floats

    @classmethod
    def of(cls, constants: Constants, tracked: int, markers: int) -> Weights:
        """By the names that the constants of our graphs have. Raises KeyError or ValueError where
        it is another graph. Compiled code relies on all shapes and types here.
        """
        names = "mean", "per_fade", "per_memory"
        mean, per_fade, per_memory = (constants[name].ravel().astype(np.float32) for name in names)
        width = 3 * tracked
        if len(mean) != width:
            raise ValueError(f"{len(mean)} coordinates of {tracked} tracked markers")
        told = 5 * width + tracked + len(per_memory) + 1
        prior, bias = constants["prior_weights"], constants["prior_bias"]
        _check(prior, bias, told, len(per_fade) * width)
        numbers = [_number(constants[name]) for name in _TOLD]
        if not 0 <= numbers[-1] < len(per_fade):
            raise ValueError(f"there is no fade {numbers[-1]:g}")
        return cls(
            *(markers, mean, _number(constants["unit"]), _number(constants["slow"])),
            *_layers(constants, "pose", width, width, 4 * markers),
            *_layers(constants, "velocity", 2 * width, 2 * width, 3 * markers),
            *_layers(constants, "recall", told, 0, width + tracked),
            *(np.concatenate([prior.ravel(), bias]), np.array(numbers, np.float32)),
            *(per_fade, per_memory),
        )


# How far is far (m), a pace (m/s), the oldest age (s), the unit of its logarithm (s), how long a
# marker coasts (s); and the number of the fade that the network's own share comes in with.
_TOLD = ("per_far", "per_pace", "oldest", "per_age", "per_coast", "own_fade")


class CompiledNetworks:
    """Call `estimate` or `recall`. Not for several threads at a time."""

    def __init__(self, weights: Weights) -> None:
        self.weights = weights
        width, markers = len(weights.mean), weights.markers
        sizes = *weights.pose_sizes, *weights.velocity_sizes, *weights.recall_sizes
        widest = int(max(sizes)) + 2 * width
        self._units: Floats = np.zeros((2, widest), np.float32)
        self._bits: Bits = np.zeros(widest, np.int32)
        self._inputs: Floats = np.zeros(widest, np.float32)
        self._linear: Floats = np.zeros(len(weights.per_fade) * width, np.float32)
        self._outputs: Floats = np.zeros(4 * markers, np.float32)
        self._recalled: Floats = np.zeros(width + width // 3, np.float32)
        self._moving: Floats = np.zeros(3 * markers, np.float32)
        self._sigma: Floats = np.zeros(markers, np.float32)
        pose = self._outputs[: 3 * markers].reshape(-1, 3)
        self._found = [(pose, self._sigma, self._moving.reshape(-1, 3))]

    def estimate(self, tracked: Floats, velocity: Floats) -> list[tuple[Floats, Floats, Floats]]:
        """Of one frame: all markers (M, 3), their sigma (M,) and velocities (M, 3), from those
        tracked (1, T, 3) and their velocities (1, T, 3); the next call overwrites them.
        """
        weights = self.weights
        _estimate(
            *(_own(tracked), _own(velocity), weights.mean, weights.unit, weights.slow),
            weights.pose_sizes,
            weights.pose,
            weights.velocity_sizes,
            weights.velocity,
            self._units,
            self._bits,
            self._inputs,
            self._outputs,
            self._sigma,
            self._moving,
        )
        return self._found

    def recall(
        self,
        tracked: Floats,
        present: npt.NDArray[np.bool_],
        then: Floats,
        left: Floats,
        pace: Floats,
        age: npt.NDArray[np.float64],
    ) -> tuple[Floats, Floats]:
        """Where missing markers are, by n last sightings (`bridge.regression.Sightings`): the
        tracked ones (n, T, 3) and their sigma (n, T), from those tracked (T, 3) and present (T,).
        """
        weights = self.weights
        found: Floats = np.empty(then.shape, np.float32)
        sigma: Floats = np.empty(then.shape[:2], np.float32)
        _recall(
            *(_own(tracked), present, _own(then), _own(left), _own(pace), age),
            weights.mean,
            weights.unit,
            weights.recall_sizes,
            weights.recall,
            weights.prior,
            weights.told,
            weights.per_fade,
            weights.per_memory,
            self._units,
            self._bits,
            self._inputs,
            self._linear,
            self._recalled,
            found,
            sigma,
        )
        return found, sigma


def _own(values: npt.NDArray[np.floating]) -> Floats:
    """As compiled code takes it."""
    return np.ascontiguousarray(values, np.float32)


def _number(constant: Constant) -> float:
    if constant.shape != (1,):
        raise ValueError(f"{constant.shape} in place of a number")
    return float(constant[0])


def _layers(
    constants: Constants, name: str, inputs: int, more: int, outputs: int
) -> tuple[Sizes, Floats]:
    """Sizes and weights of a network, as `Weights` has them. more: inputs of the last layer beside
    the last hidden units.
    """
    sizes: list[int] = [inputs]
    parts: list[Constant] = []
    while f"{name}_{len(sizes) - 1}_weights" in constants:
        at = f"{name}_{len(sizes) - 1}"
        weights, bias = constants[f"{at}_weights"], constants[f"{at}_bias"]
        _check(weights, bias, sizes[-1], bias.size)
        sizes.append(len(bias))
        parts += [weights, bias]
    weights, bias = constants[f"{name}_last_weights"], constants[f"{name}_last_bias"]
    _check(weights, bias, sizes[-1] + more, outputs)
    flat = [part.ravel() for part in (*parts, weights, bias)]
    return np.array(sizes), np.concatenate(flat).astype(np.float32)


def _check(weights: Constant, bias: Constant, inputs: int, outputs: int) -> None:
    if weights.shape != (inputs, outputs) or bias.shape != (outputs,):
        raise ValueError(f"weights {weights.shape} for {inputs} inputs and {outputs} outputs")


@inlined
def _dense(x: Floats, weights: Floats, at: int, y: Floats) -> int:
    """A layer of the weights from `at` on; returns where the next begins. Four rows at a time: the
    outputs are then read and written a fourth as often.
    """
    inputs, outputs = len(x), len(y)
    y[:] = weights[at + inputs * outputs : at + (inputs + 1) * outputs]
    four = inputs - inputs % 4
    for row in range(0, four, 4):
        start = at + row * outputs
        a, b, c, d = x[row], x[row + 1], x[row + 2], x[row + 3]
        wa = weights[start : start + outputs]
        wb = weights[start + outputs : start + 2 * outputs]
        wc = weights[start + 2 * outputs : start + 3 * outputs]
        wd = weights[start + 3 * outputs : start + 4 * outputs]
        for column in range(outputs):
            y[column] += (a * wa[column] + b * wb[column]) + (c * wc[column] + d * wd[column])
    for row in range(four, inputs):
        start = at + row * outputs
        a, wa = x[row], weights[start : start + outputs]
        for column in range(outputs):
            y[column] += a * wa[column]
    return at + (inputs + 1) * outputs


@inlined
def _sigmoid_units(y: Floats, bits: Bits) -> None:
    """y / (1 + exp(-y)), within rounding. exp is 2^n, which is written as the bits of a float,
    times a polynomial of the rest: so it is done for many at once, as the library's is not.
    """
    powers = bits.view(np.float32)
    for unit in range(len(y)):
        exponent = y[unit] * np.float32(-1.4426950408889634)  # to the base 2
        exponent = min(max(exponent, np.float32(-126.0)), np.float32(126.0))
        whole = np.floor(exponent + np.float32(0.5))
        rest = exponent - whole
        # Taylor's series of 2^rest, |rest| <= 1/2: ln(2)^k / k!
        power = np.float32(1.5403530e-4)
        power = power * rest + np.float32(1.3333558e-3)
        power = power * rest + np.float32(9.6181291e-3)
        power = power * rest + np.float32(5.5504109e-2)
        power = power * rest + np.float32(2.4022651e-1)
        power = power * rest + np.float32(6.9314718e-1)
        power = power * rest + np.float32(1.0)
        bits[unit] = (np.int32(whole) + np.int32(127)) << np.int32(23)
        y[unit] = y[unit] / (np.float32(1.0) + power * powers[unit])


@inlined
def _run(
    x: Floats, more: Floats, sizes: Sizes, weights: Floats, units: Floats, bits: Bits, y: Floats
) -> None:
    """A network, whose last layer takes `more` inputs beside the last hidden units."""
    now, width, at = 0, len(x), 0
    units[0, :width] = x
    for layer in range(1, len(sizes)):
        count = sizes[layer]
        at = _dense(units[now, :width], weights, at, units[1 - now, :count])
        now, width = 1 - now, count
        _sigmoid_units(units[now, :width], bits)
    units[now, width : width + len(more)] = more
    _dense(units[now, : width + len(more)], weights, at, y)


@compiled(
    "void(f4[:,:,::1], f4[:,:,::1], f4[::1], f4, f4, i8[::1], f4[::1], i8[::1], f4[::1],"
    " f4[:,::1], i4[::1], f4[::1], f4[::1], f4[::1], f4[::1])"
)
def _estimate(
    tracked: Floats,
    velocity: Floats,
    mean: Floats,
    unit: float,
    slow: float,
    pose_sizes: Sizes,
    pose: Floats,
    velocity_sizes: Sizes,
    velocities: Floats,
    units: Floats,
    bits: Bits,
    inputs: Floats,
    outputs: Floats,
    sigma: Floats,
    moving: Floats,
) -> None:
    """Both networks; inputs: positions in their unit, then velocities in the body's speed."""
    width = len(mean)
    places, v = tracked.ravel(), velocity.ravel()
    square = np.float32(0.0)
    for row in range(width):
        inputs[row] = (places[row] - mean[row]) * unit
        square += v[row] * v[row]
    speed = np.float32(math.sqrt(square / np.float32(width) + slow))
    for row in range(width):
        inputs[width + row] = v[row] / speed
    x = inputs[:width]
    _run(x, x, pose_sizes, pose, units, bits, outputs)
    for marker in range(len(sigma)):
        sigma[marker] = math.exp(outputs[3 * len(sigma) + marker])
    both = inputs[: 2 * width]
    _run(both, both, velocity_sizes, velocities, units, bits, moving)
    for row in range(len(moving)):
        moving[row] *= speed


@compiled(
    "void(f4[:,::1], b1[::1], f4[:,:,::1], f4[:,:,::1], f4[:,:,::1], f8[::1], f4[::1], f4,"
    " i8[::1], f4[::1], f4[::1], f4[::1], f4[::1], f4[::1],"
    " f4[:,::1], i4[::1], f4[::1], f4[::1], f4[::1], f4[:,:,::1], f4[:,::1])"
)
def _recall(
    tracked: Floats,
    present: npt.NDArray[np.bool_],
    then: Floats,
    left: Floats,
    pace: Floats,
    ages: npt.NDArray[np.float64],
    mean: Floats,
    unit: float,
    sizes: Sizes,
    weights: Floats,
    prior: Floats,
    told: Floats,
    per_fade: Floats,
    per_memory: Floats,
    units: Floats,
    bits: Bits,
    inputs: Floats,
    linear: Floats,
    outputs: Floats,
    found: Floats,
    sigma: Floats,
) -> None:
    """What the prior says, part by part as its fades come in, and the network's share, added to
    where a marker would be that had gone on as it went.
    """
    width, markers = len(mean), len(present)
    per_far, per_pace, oldest, per_age, per_coast, own = told
    none = inputs[:0]
    for one in range(len(ages)):
        age = np.float32(ages[one])
        inputs[: 5 * width] = np.float32(0.0)
        for marker in range(markers):
            inputs[5 * width + marker] = present[marker]
            for axis in range(3):
                row = 3 * marker + axis
                past = then[one, marker, axis]
                if present[marker]:
                    inputs[row] = (tracked[marker, axis] - mean[row]) * unit
                    inputs[width + row] = (tracked[marker, axis] - past) * unit
                else:
                    way = left[one, marker, axis] - past
                    far = np.float32(math.sqrt(np.float32(1.0) + (way * per_far) ** 2))
                    inputs[2 * width + row] = (past - mean[row]) * unit
                    inputs[3 * width + row] = way / far * unit
                    inputs[4 * width + row] = pace[one, marker, axis] * per_pace
        at = 5 * width + markers
        for memory in range(len(per_memory)):
            inputs[at + memory] = math.exp(min(age, oldest) * per_memory[memory])
        inputs[at + len(per_memory)] = math.log(min(age, oldest) * per_age)
        x = inputs[: at + len(per_memory) + 1]
        _dense(x, prior, 0, linear)
        _run(x, none, sizes, weights, units, bits, outputs)
        coasted = age * per_coast
        slowing = np.float32(1.0) + coasted * coasted * coasted * coasted
        for row in range(width):
            marker, axis = row // 3, row % 3
            past, moving = then[one, marker, axis], pace[one, marker, axis]
            expected = past + (left[one, marker, axis] - past + moving * age) / slowing
            for fade in range(len(per_fade)):
                share = np.float32(1.0) - np.float32(math.exp(age * per_fade[fade]))
                share = share * share * share
                expected += linear[fade * width + row] * share
                if fade == int(own):
                    expected += outputs[row] * share
            found[one, marker, axis] = expected
        for marker in range(markers):
            sigma[one, marker] = math.exp(outputs[width + marker])
