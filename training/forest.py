"""The random forest that names a pose's local model (paper 3.3), held sparsely.

scikit-learn keeps a value per class in every node; here a leaf keeps only the classes it has seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import RandomForestClassifier

from drivers.frame import Floats

Indices = npt.NDArray[np.int64]

BATCH = 10  # trees that are held as scikit-learn has them


@dataclass(frozen=True, slots=True)
class ForestOptions:
    """Size and shape of a forest; leaf: fewest training rows that a leaf may hold."""

    trees: int
    leaf: int
    depth: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Forest:
    """All trees in one set of arrays, a row per node, the nodes of a tree in order.

    tree, node: which. feature: -1 in a leaf, else the coordinate that is compared; a row goes to
    node `left` where it is at most `threshold` (float32), else to `right`. A row per entry of a
    leaf: entry_tree, entry_node, entry_class, and entry_weight, which sums to 1 / trees over the
    leaf. So the weights of all leaves that a row falls into sum to its class weights (K,).
    """

    classes: int
    tree: Indices
    node: Indices
    feature: Indices
    threshold: Floats
    left: Indices
    right: Indices
    entry_tree: Indices
    entry_node: Indices
    entry_class: Indices
    entry_weight: Floats


def grow_forest(
    x: Floats,
    labels: npt.NDArray[np.int64],
    options: ForestOptions,
    seed: int,
) -> Iterator[RandomForestClassifier]:
    """Fits rows x (N, D) to the numbers (N,) of their local models, by the workers in force.

    Yields the forest in parts of BATCH trees: scikit-learn keeps a value per class in every node,
    which for all trees at once takes most of the memory. Together they are the forest that it would
    have grown from this seed.
    """
    random = np.random.RandomState(seed)  # each part goes on with it
    for start in range(0, options.trees, BATCH):
        part = RandomForestClassifier(
            min(BATCH, options.trees - start),
            min_samples_leaf=options.leaf,
            max_depth=options.depth,
            random_state=random,
        )
        part.fit(x, labels)
        yield part


def sparse_forest(parts: Iterable[RandomForestClassifier], hard: bool) -> Forest:
    """The nodes of all parts, and the non-zero class weights of their leaves.

    hard: each tree votes for one class, as in Breiman's paper, in place of its class shares.
    """
    columns: dict[str, list[npt.NDArray[Any]]] = {}
    count = classes = 0
    for part in parts:
        classes = len(part.classes_)
        for estimator in part.estimators_:
            for name, column in _sparse_tree(estimator.tree_, count, hard).items():
                columns.setdefault(name, []).append(column)
            count += 1
    arrays = {name: np.concatenate(column) for name, column in columns.items()}
    weights = (arrays.pop("entry_weight") / count).astype(np.float32)
    return Forest(classes=classes, entry_weight=weights, **arrays)


def _sparse_tree(tree: Any, number: int, hard: bool) -> dict[str, npt.NDArray[Any]]:
    """One tree's columns of `Forest`, its weights summing to 1 over each leaf."""
    is_leaf = tree.children_left < 0
    shares = tree.value[:, 0, :] / tree.value[:, 0, :].sum(axis=1, keepdims=True)
    if hard:
        shares = np.eye(shares.shape[1])[shares.argmax(axis=1)]
    node, entry = np.nonzero(shares * is_leaf[:, None])
    return {
        "tree": np.full(tree.node_count, number),
        "node": np.arange(tree.node_count),
        "feature": np.where(is_leaf, -1, tree.feature),
        "threshold": round_down(np.where(is_leaf, 0.0, tree.threshold)),
        "left": np.maximum(tree.children_left, 0),
        "right": np.maximum(tree.children_right, 0),
        "entry_tree": np.full(len(node), number),
        "entry_node": node,
        "entry_class": entry,
        "entry_weight": shares[node, entry],
    }


def round_down(values: npt.NDArray[np.float64]) -> Floats:
    """The largest float32 that is not above each value.

    For float32 rows `row <= value` then stays as true or false as it was in double precision.
    """
    single = values.astype(np.float32)
    below = np.nextafter(single, np.float32(-np.inf))
    return np.where(single > values, below, single)
