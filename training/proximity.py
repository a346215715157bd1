"""Missing markers as random forests fill them in: Breiman's proximities (paper section 5).

Two poses are near each other in as far as the trees send them to the same leaf. A missing
coordinate is the mean of it over a fixed set of reference poses, weighted by their proximity;
what is filled in changes the leaves, so this is repeated.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.model import Model
from drivers.frame import Floats
from drivers.marker_set import MARKERS

REFERENCES = 2_000  # poses, evenly taken from those of training
ITERATIONS = 6  # at most; Breiman's four to six, fewer once the leaves stay the same

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


class Trees:
    """The forest of a model file, its nodes numbered through all trees."""

    def __init__(self, path: Path) -> None:
        import onnx  # the only part of the study that wants the extra `train`

        graph = onnx.load(str(path)).graph
        forest = next(node for node in graph.node if node.op_type == "TreeEnsembleRegressor")
        columns: dict[str, Any] = {
            entry.name: onnx.helper.get_attribute_value(entry) for entry in forest.attribute
        }
        tree, node = (np.array(columns[f"nodes_{name}"]) for name in ("treeids", "nodeids"))
        self._roots: Indices = np.flatnonzero(node == 0)
        # The nodes of a tree are written in order (training/export.py).
        first = self._roots[tree]
        is_leaf = np.array([mode == b"LEAF" for mode in columns["nodes_modes"]])
        self.nodes = len(tree)
        self._feature = np.array(columns["nodes_featureids"])
        # A leaf leads back to itself.
        self._threshold = np.where(is_leaf, np.inf, columns["nodes_values"]).astype(np.float32)
        yes, no = (np.array(columns[f"nodes_{name}nodeids"]) for name in ("true", "false"))
        self._next = np.stack(
            [np.where(is_leaf, np.arange(self.nodes), first + node) for node in (yes, no)], axis=1
        ).ravel()

    def leaves(self, x: Floats) -> Indices:
        """The leaf (N, trees) that each row of x (N, D) reaches in each tree."""
        at = np.repeat(self._roots[None], len(x), axis=0)
        row = np.arange(len(x))[:, None]
        while True:
            above = x[row, self._feature[at]] > self._threshold[at]
            below = self._next[2 * at + above]
            if (below == at).all():
                return at
            at = below


class ProximityImputer:
    """Fills in each frame for itself from reference poses (N, 41, 3), in the body frame, metres.

    The median of the references is the first guess, and stays where none of them shares a leaf.
    """

    def __init__(self, model: Model, poses: Floats) -> None:
        self._trees = Trees(model.path)
        self._width = model.width
        markers = poses[:, [MARKERS.index(label) for label in model.info.features]]
        rows = markers.reshape(len(poses), -1).astype(float)
        self._median: Floats = np.median(rows, axis=0).astype(np.float32)
        # The sum over references weighted by shared leaves is a sum over leaves of their
        # references: these sums are all that is needed of them.
        self._sums = np.zeros((self._trees.nodes, rows.shape[1]))
        self._counts = np.zeros(self._trees.nodes)
        for leaves in self._trees.leaves(rows[:, : self._width].astype(np.float32)).T:
            np.add.at(self._sums, leaves, rows)
            np.add.at(self._counts, leaves, 1)

    def reset(self) -> None:
        """There is no past to forget."""

    def fill(self, xyz: Floats, present: Mask, interval: float) -> Floats:
        """The markers (F, 3), in the body frame, with the rows that are not present (F,) filled in.

        interval is not used.
        """
        if present.all():
            return xyz
        missing = np.repeat(~present, 3)
        filled = np.where(missing, self._median, xyz.ravel())
        before = None
        for _ in range(ITERATIONS):
            (leaves,) = self._trees.leaves(filled[None, : self._width])
            near = self._counts[leaves].sum()
            if not near or (before is not None and (leaves == before).all()):
                break
            filled[missing] = self._sums[leaves][:, missing].sum(axis=0) / near
            before = leaves
        return filled.reshape(-1, 3)


def spread_evenly(poses: Floats, count: int = REFERENCES) -> Floats:
    """At most `count` of the poses, evenly over all."""
    chosen: Floats = poses[np.linspace(0, len(poses) - 1, min(count, len(poses))).astype(int)]
    return chosen
