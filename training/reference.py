"""The model in plain numpy, read from its file: what the ONNX runtime is checked against.

Independent of the export and of onnxruntime: it walks the trees node by node.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from drivers.frame import Floats


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
    """The file of networks, run in double precision. Same call as `bridge.model.Model.regress`."""

    def __init__(self, path: str | Path) -> None:
        graph = onnx.load(str(path)).graph
        self._constants = {
            entry.name: numpy_helper.to_array(entry).astype(float) for entry in graph.initializer
        }

    def regress(self, x: Floats, present: Floats) -> tuple[Floats, Floats]:
        """z (n, 3M) and sigma (n, M) of n frames x (n, 3F), the markers present being (n, T)."""
        constants = self._constants
        there = present[:, constants["rows"].astype(int)]
        u = np.hstack([(x - constants["mean"]) * constants["unit"] * there, present])
        name = "whole" if present.all() else "part"
        ends: list[Floats] = []
        while f"{name}_{len(ends)}_0_weights" in constants:
            units, layer = u, 0
            while (at := f"{name}_{len(ends)}_{layer}") + "_weights" in constants:
                a = units @ constants[f"{at}_weights"] + constants[f"{at}_bias"]
                units = a / (1.0 + np.exp(-a))
                layer += 1
            ends.append(units)
        last = np.hstack([*ends, u])
        outputs = last @ constants[f"{name}_last_weights"] + constants[f"{name}_last_bias"]
        width = int(constants["parts"][0])
        z, sigma = outputs[:, :width], np.exp(outputs[:, width:])
        return z.astype(np.float32), sigma.astype(np.float32)
