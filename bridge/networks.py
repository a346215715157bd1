"""The networks of a model that lacks nothing, compiled: for one frame at a time.

The same as the graph of the model file computes (docs/model-file.md), from the same weights, in
four fifths of the time; and where the thread has slept since the last frame in half of it, as there
is far less code to come from memory. The graph is the check: whoever makes these compares them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled, inlined
from drivers.frame import Floats

Bits = npt.NDArray[np.int32]
Sizes = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """What networks compute with; all that run them share it, and the caches that hold it.

    mean: (3T,) m, and unit, m: how positions are told. slow: (m/s)², of a body as good as at rest.
    Sizes of the inputs and the hidden layers, and weights in the order in which they are used: of
    each layer the matrix, row by row, then the bias.
    """

    mean: Floats
    unit: float
    slow: float
    pose_sizes: Sizes
    pose: Floats
    velocity_sizes: Sizes
    velocity: Floats
    markers: int

    @classmethod
    def of(cls, constants: Mapping[str, Floats], markers: int) -> Weights:
        """By the names that the constants of our graphs have. Raises KeyError or ValueError where
        it is another graph.
        """
        mean = constants["mean"].ravel()
        return cls(
            *(mean, _number(constants["unit"]), _number(constants["slow"])),
            *_layers(constants, "pose", len(mean), 4 * markers),
            *_layers(constants, "velocity", 2 * len(mean), 3 * markers),
            markers,
        )


class CompiledNetworks:
    """Call `estimate`. Not for several threads at a time."""

    def __init__(self, weights: Weights) -> None:
        width = len(weights.mean)
        widest = max(*weights.pose_sizes, *weights.velocity_sizes) + 2 * width
        markers = weights.markers
        self._weights = weights
        self._units: Floats = np.zeros((2, widest), np.float32)
        self._bits: Bits = np.zeros(widest, np.int32)
        self._inputs: Floats = np.zeros(2 * width, np.float32)
        self._outputs: Floats = np.zeros(4 * markers, np.float32)
        self._moving: Floats = np.zeros(3 * markers, np.float32)
        self._sigma: Floats = np.zeros(markers, np.float32)
        pose = self._outputs[: 3 * markers].reshape(-1, 3)
        self._found = [(pose, self._sigma, self._moving.reshape(-1, 3))]

    def estimate(self, tracked: Floats, velocity: Floats) -> list[tuple[Floats, Floats, Floats]]:
        """Of one frame: all markers (M, 3), their sigma (M,) and velocities (M, 3), from those
        tracked (1, T, 3) and their velocities (1, T, 3); the next call overwrites them.
        """
        weights = self._weights
        _estimate(
            *(tracked, velocity, weights.mean, weights.unit, weights.slow),
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


def _number(constant: Floats) -> float:
    if constant.shape != (1,):
        raise ValueError(f"{constant.shape} in place of a number")
    return float(constant[0])


def _layers(
    constants: Mapping[str, Floats], name: str, width: int, outputs: int
) -> tuple[Sizes, Floats]:
    """Sizes and weights of a network, as `Weights` has them."""
    sizes, parts = [width], []
    while f"{name}_{len(sizes) - 1}_weights" in constants:
        at = f"{name}_{len(sizes) - 1}"
        weights, bias = constants[f"{at}_weights"], constants[f"{at}_bias"]
        _check(weights, bias, sizes[-1], len(bias))
        sizes.append(len(bias))
        parts += [weights, bias]
    weights, bias = constants[f"{name}_last_weights"], constants[f"{name}_last_bias"]
    _check(weights, bias, sizes[-1] + width, outputs)
    flat = [part.ravel() for part in (*parts, weights, bias)]
    return np.array(sizes), np.concatenate(flat).astype(np.float32)


def _check(weights: Floats, bias: Floats, inputs: int, outputs: int) -> None:
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
def _run(x: Floats, sizes: Sizes, weights: Floats, units: Floats, bits: Bits, y: Floats) -> None:
    """A network whose last layer takes the last hidden units and the inputs."""
    now, width, at = 0, len(x), 0
    units[0, :width] = x
    for layer in range(1, len(sizes)):
        count = sizes[layer]
        at = _dense(units[now, :width], weights, at, units[1 - now, :count])
        now, width = 1 - now, count
        _sigmoid_units(units[now, :width], bits)
    units[now, width : width + len(x)] = x
    _dense(units[now, : width + len(x)], weights, at, y)


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
    x, v = tracked.ravel(), velocity.ravel()
    square = np.float32(0.0)
    for row in range(width):
        inputs[row] = (x[row] - mean[row]) * unit
        square += v[row] * v[row]
    speed = np.float32(math.sqrt(square / np.float32(width) + slow))
    for row in range(width):
        inputs[width + row] = v[row] / speed
    _run(inputs[:width], pose_sizes, pose, units, bits, outputs)
    for marker in range(len(sigma)):
        sigma[marker] = math.exp(outputs[3 * len(sigma) + marker])
    _run(inputs, velocity_sizes, velocities, units, bits, moving)
    for row in range(len(moving)):
        moving[row] *= speed
