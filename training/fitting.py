"""One model from segments: leaves, a map for each, and the forest that names them (paper 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import RandomForestClassifier

from bridge.body_frame import REFERENCES
from bridge.model import ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.clustering import divide, segment_features
from training.dataset import Take
from training.export import Graph
from training.forest import sparse_forest, train_forest
from training.local_models import Array, Moments, affine, least_squares, ridge, shrunk
from training.recipe import Recipe

Labels = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A stretch of one take with one simple behaviour: poses (n, 41, 3) in the body frame."""

    take: Take
    poses: Floats

    def rows(self, labels: Sequence[str]) -> Floats:
        """The coordinates (n, 3M) of some markers."""
        columns = [MARKERS.index(label) for label in labels]
        return self.poses[:, columns].reshape(len(self.poses), -1)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The graph, and its description without any accuracy yet."""

    graph: Graph
    info: ModelInfo


def fit(
    segments: Sequence[Segment], principal: tuple[str, ...], recipe: Recipe, seed: int
) -> Fitted:
    """The model that these segments give."""
    tracked = (*principal, *REFERENCES)
    features = [label for label in tracked if label != "C7"]
    unworn = [label for label in MARKERS if label not in tracked]
    rows = [segment.rows(MARKERS) for segment in segments]
    leaf = divide(segment_features(rows, recipe.covariance_weight), recipe.tolerance, seed)
    x = [segment.rows(features) for segment in segments]
    z = [segment.rows(unworn) for segment in segments]
    everything = _sum([Moments.of(affine(a), b) for a, b in zip(x, z, strict=True)])
    # What the graph takes: the plain method knows the principal markers alone, which come first.
    inputs = [a[:, : 3 * len(principal)] for a in x] if recipe.plain else x
    maps = (
        _plain_maps(inputs, z, leaf)
        if recipe.plain
        else _local_maps(inputs, z, leaf, everything, recipe)
    )
    forest = _forest(segments, inputs, leaf, recipe, seed)
    frames = np.concatenate(x).astype(float)
    info = ModelInfo(
        estimator="paper" if recipe.plain else "local",
        labels=MARKERS,
        principal=principal,
        references=REFERENCES,
        history=recipe.history,
        mean=frames.mean(axis=0).reshape(-1, 3).tolist(),
        covariance=np.cov(frames, rowvar=False).tolist(),
        sigma=[0.0] * len(unworn),
        sensitivity=ridge(everything, recipe.noise)[:, :-1].tolist(),
        training={
            "leaves": len(maps),
            "forest_nodes": sum(tree.tree_.node_count for tree in forest.estimators_),
        },
    )
    graph = Graph(sparse_forest(forest, recipe.plain), recipe.plain, maps[..., :-1], maps[..., -1])
    return Fitted(graph, info)


def _plain_maps(x: Sequence[Floats], z: Sequence[Floats], leaf: Labels) -> Floats:
    """(K, U, D + 1): least squares on each leaf's frames, the constant being zero."""
    moments = _by_leaf([Moments.of(a, b) for a, b in zip(x, z, strict=True)], leaf)
    return _stack([np.pad(least_squares(own), ((0, 0), (0, 1))) for own in moments])


def _local_maps(
    x: Sequence[Floats], z: Sequence[Floats], leaf: Labels, everything: Moments, recipe: Recipe
) -> Floats:
    """(K, U, D + 1): affine, held back towards the map of all frames."""
    moments = _by_leaf([Moments.of(affine(a), b) for a, b in zip(x, z, strict=True)], leaf)
    return _stack([shrunk(own, everything, recipe.share, recipe.noise) for own in moments])


def _forest(
    segments: Sequence[Segment], x: Sequence[Floats], leaf: Labels, recipe: Recipe, seed: int
) -> RandomForestClassifier:
    """Trained on some frames of each segment, all of them labelled with its leaf."""
    rows = [
        frames[:: max(1, round(recipe.forest_step * segment.take.rate))]
        for segment, frames in zip(segments, x, strict=True)
    ]
    labels = np.repeat(leaf, [len(part) for part in rows])
    return train_forest(np.concatenate(rows), labels, recipe.forest, seed)


def _by_leaf(moments: Sequence[Moments], leaf: Labels) -> list[Moments]:
    return [
        _sum([own for own, mine in zip(moments, leaf == number, strict=True) if mine])
        for number in range(leaf.max() + 1)
    ]


def _sum(moments: Sequence[Moments]) -> Moments:
    return reduce(add, moments)


def _stack(maps: Sequence[Array]) -> Floats:
    return np.array(maps, np.float32)
