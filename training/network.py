"""A small feed-forward network in numpy, and the loop that trains it.

Layers of sigmoid-weighted units (a * sigmoid(a): smooth, so that the pose is), dropout, and Adam
(Kingma and Ba 2015) with a learning rate that rises at first and then falls to nothing along half
a cosine. All is float32.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from drivers.frame import Floats

Gradient = Callable[[Floats], Floats]  # of the loss by the outputs (n, O), at those outputs
Weights = list[Floats]  # a matrix and a bias row per layer, in turn

_WARM_UP = 200  # steps
_BETA = 0.9, 0.99  # memory of Adam's mean and of its mean square
_EPSILON = 1e-8


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """hidden: units of each layer. dropout: share of the units left out at a time. steps: of
    training, `batch` examples each. rate: the highest learning rate.
    """

    hidden: tuple[int, ...] = (384, 384, 384)
    dropout: float = 0.2
    steps: int = 4000
    batch: int = 512
    rate: float = 1.5e-3


class Network:
    """weights: (in, units) and (units,) of each layer, the last being linear."""

    def __init__(self, weights: Weights) -> None:
        self.weights = weights

    @classmethod
    def random(cls, sizes: Sequence[int], random: np.random.Generator) -> Network:
        """Layers between so many inputs, hidden units and outputs."""
        weights: Weights = []
        for inputs, units in pairwise(sizes):
            spread = np.float32(math.sqrt(2.0 / inputs))
            weights += [
                spread * random.standard_normal((inputs, units), dtype=np.float32),
                np.zeros(units, np.float32),
            ]
        weights[-2] *= np.float32(0.1)  # begin near the linear prior
        return cls(weights)

    @property
    def layers(self) -> list[tuple[Floats, Floats]]:
        """Weights and bias of each hidden layer."""
        return list(zip(self.weights[:-2:2], self.weights[1:-2:2], strict=True))

    def hidden(self, x: Floats) -> Floats:
        """The units of the last hidden layer (n, H) at inputs (n, D)."""
        for matrix, bias in self.layers:
            a = x @ matrix + bias
            x = a * _sigmoid(a)
        return x

    def outputs(self, x: Floats) -> Floats:
        """The outputs (n, O) at inputs (n, D)."""
        found: Floats = self.hidden(x) @ self.weights[-2] + self.weights[-1]
        return found

    def gradients(
        self, x: Floats, gradient: Gradient, dropout: float, random: np.random.Generator
    ) -> Weights:
        """Of the loss by the weights, at inputs (n, D), some units being left out."""
        layers, slopes = [x], []
        threshold = round(256 * dropout)
        for matrix, bias in self.layers:
            a = layers[-1] @ matrix
            a += bias
            gate = _sigmoid(a)
            slope = gate * (1.0 + a * (1.0 - gate))
            a *= gate
            if threshold:
                kept = random.integers(0, 256, a.shape, np.uint8) >= threshold
                scale = kept * np.float32(256 / (256 - threshold))
                a *= scale
                slope *= scale
            layers.append(a)
            slopes.append(slope)
        back = gradient(layers[-1] @ self.weights[-2] + self.weights[-1])
        found: Weights = []
        for layer in range(len(layers) - 1, -1, -1):
            found = [layers[layer].T @ back, back.sum(axis=0), *found]
            if layer:
                back = back @ self.weights[2 * layer].T
                back *= slopes[layer - 1]
        return found


class Adam:
    """Changes weights in place, step by step."""

    def __init__(self, weights: Weights, steps: int, rate: float) -> None:
        self._weights = weights
        self._mean = [np.zeros_like(part) for part in weights]
        self._square = [np.zeros_like(part) for part in weights]
        self._steps, self._rate = steps, rate
        self._done = 0

    def step(self, gradients: Weights) -> None:
        """Takes the gradients of one batch."""
        warm = min(1.0, (self._done + 1) / _WARM_UP)
        rate = self._rate * warm * 0.5 * (1.0 + math.cos(math.pi * self._done / self._steps))
        self._done += 1
        first, second = _BETA
        # Both memories begin at zero: what they lack of their weight.
        rate *= math.sqrt(1.0 - second**self._done) / (1.0 - first**self._done)
        for part, gradient, mean, square in zip(
            self._weights, gradients, self._mean, self._square, strict=True
        ):
            mean += np.float32(1.0 - first) * (gradient - mean)
            square += np.float32(1.0 - second) * (gradient * gradient - square)
            part -= np.float32(rate) * mean / (np.sqrt(square) + np.float32(_EPSILON))


def _sigmoid(a: Floats) -> Floats:
    # By the hyperbolic tangent, which cannot overflow.
    gate: Floats = np.tanh(np.float32(0.5) * a)
    gate += np.float32(1.0)
    gate *= np.float32(0.5)
    return gate
