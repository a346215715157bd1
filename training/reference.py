"""The model in plain numpy, read from its file: what the ONNX runtime is checked against.

Independent of the export and of onnxruntime: it walks the trees node by node.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper

from drivers.frame import Floats

Array = npt.NDArray[np.float64]


class ReferenceModel:
    """A model file, run in double precision. Same call as `bridge.model.Model.run`."""

    def __init__(self, path: str | Path) -> None:
        graph = onnx.load(str(path)).graph
        constants = {entry.name: numpy_helper.to_array(entry) for entry in graph.initializer}
        self._offsets = constants["offsets"].astype(float)  # (K, U)
        self._maps = constants["maps"].astype(float)  # (D, K * U)
        self._hard = any(node.op_type == "OneHot" for node in graph.node)
        node = next(node for node in graph.node if node.op_type == "TreeEnsembleRegressor")
        forest: dict[str, Any] = {
            entry.name: onnx.helper.get_attribute_value(entry) for entry in node.attribute
        }
        self._nodes: dict[tuple[int, int], tuple[bytes, int, np.float32, int, int]] = {
            (tree, number): (mode, feature, np.float32(threshold), yes, no)
            for tree, number, mode, feature, threshold, yes, no in zip(
                forest["nodes_treeids"],
                forest["nodes_nodeids"],
                forest["nodes_modes"],
                forest["nodes_featureids"],
                forest["nodes_values"],
                forest["nodes_truenodeids"],
                forest["nodes_falsenodeids"],
                strict=True,
            )
        }
        self._entries: dict[tuple[int, int], list[tuple[int, float]]] = {}
        for tree, number, leaf, weight in zip(
            forest["target_treeids"],
            forest["target_nodeids"],
            forest["target_ids"],
            forest["target_weights"],
            strict=True,
        ):
            self._entries.setdefault((tree, number), []).append((leaf, weight))
        self._trees = sorted({tree for tree, _ in self._nodes})

    def run(self, x: Floats, history: Floats) -> tuple[Floats, Floats]:
        """z (1, 3U) and p (1, K) of one frame x (1, D) with the leaf weights history (h, K)."""
        p = np.zeros(len(self._offsets))
        for tree in self._trees:
            number = 0
            while True:
                mode, feature, threshold, yes, no = self._nodes[tree, number]
                if mode == b"LEAF":
                    break
                number = yes if x[0, feature] <= threshold else no
            for leaf, weight in self._entries[tree, number]:
                p[leaf] += weight
        if self._hard:
            p = (np.arange(len(p)) == p.argmax()).astype(float)
        counts = history.sum(axis=0, dtype=float) + p
        w = counts / counts.sum()
        estimates = (x[0].astype(float) @ self._maps).reshape(self._offsets.shape) + self._offsets
        z = w @ estimates
        return z[None].astype(np.float32), p[None].astype(np.float32)


class ReferenceNetworks:
    """The file of networks, run in double precision. Same calls as `bridge.model.Model` has."""

    def __init__(self, path: str | Path) -> None:
        graph = onnx.load(str(path)).graph
        self._constants = {
            entry.name: numpy_helper.to_array(entry).astype(float) for entry in graph.initializer
        }

    def estimate(self, tracked: Floats, velocity: Floats) -> tuple[Floats, Floats, Floats]:
        """All markers (M, 3), sigma (M,) and velocities (M, 3) of one frame: the tracked markers
        (T, 3) and their velocities.
        """
        u = self._scaled(tracked.ravel())
        outputs = self._last("pose", u)
        markers = len(outputs) // 4
        speed = np.sqrt((velocity.astype(float) ** 2).mean() + self._constants["slow"][0])
        moving = speed * self._last("velocity", np.append(u, velocity.ravel() / speed))
        return (
            outputs[: 3 * markers].reshape(-1, 3).astype(np.float32),
            np.exp(outputs[3 * markers :]).astype(np.float32),
            moving.reshape(-1, 3).astype(np.float32),
        )

    def recall(self, tracked: Floats, present: Floats, memory: Floats) -> tuple[Floats, Floats]:
        """The tracked markers (n, T, 3) and their sigma (n, T), of n frames that lack some."""
        rows = zip(tracked, present, memory, strict=True)
        found = [self._recalled(*(part.astype(float) for part in row)) for row in rows]
        markers, sigma = (np.array(part, np.float32) for part in zip(*found, strict=True))
        return markers, sigma

    def _recalled(self, now: Array, present: Array, memory: Array) -> tuple[Array, Array]:
        constants, width = self._constants, len(now)
        then, left, pace = memory[:-1].reshape(3, width)
        age, way = memory[-1], left - then
        there = np.repeat(present, 3)
        told = min(age, constants["oldest"][0])
        inputs = np.hstack(
            [
                there * self._scaled(now),
                there * (now - then) * constants["unit"],
                (1 - there) * self._scaled(then),
                (1 - there)
                * constants["unit"]
                * way
                / np.sqrt(1 + (way * constants["per_far"]) ** 2),
                (1 - there) * pace * constants["per_pace"],
                present,
                np.exp(told * constants["per_memory"]),
                np.log(told * constants["per_age"]),
            ]
        )
        units = self._units("recall", inputs)
        outputs = units @ constants["recall_last_weights"] + constants["recall_last_bias"]
        fades = (1 - np.exp(age * constants["per_fade"])) ** 3
        prior = inputs @ constants["prior_weights"] + constants["prior_bias"]
        found = then + (way + pace * age) / (1 + (age * constants["per_coast"]) ** 4)
        found = found + fades @ prior.reshape(len(fades), -1)
        found = found + fades[int(constants["own_fade"][0])] * outputs[:width]
        return found.reshape(-1, 3), np.exp(outputs[width:])

    def _scaled(self, x: Array | Floats) -> Array:
        scaled: Array = (x - self._constants["mean"]) * self._constants["unit"]
        return scaled

    def _units(self, name: str, inputs: Array) -> Array:
        """The last hidden units of a network."""
        layer = 0
        while f"{name}_{layer}_weights" in self._constants:
            a = inputs @ self._constants[f"{name}_{layer}_weights"]
            a = a + self._constants[f"{name}_{layer}_bias"]
            inputs, layer = a / (1.0 + np.exp(-a)), layer + 1
        return inputs

    def _last(self, name: str, inputs: Array) -> Array:
        """The outputs of a network with its prior."""
        last = np.append(self._units(name, inputs), inputs)
        weights, bias = (self._constants[f"{name}_last_{part}"] for part in ("weights", "bias"))
        found: Array = last @ weights + bias
        return found
