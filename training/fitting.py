"""A mixture of local models from segments: leaves, a map for each, and the forest that names them
(paper 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.body_frame import CONSTRUCTIONS
from bridge.model import ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.clustering import DivisiveKMeans, SegmentFeatures, segment_features
from training.corpus import Corpus
from training.export import Mixture
from training.forest import grow_forest, sparse_forest
from training.local_models import NormalEquations, least_squares, ridge, shrunk
from training.mirroring import mirrored
from training.moments import (
    COORDINATES,
    ONE,
    PACKED,
    SegmentMoments,
    columns_of,
    matrix,
    mean_and_covariance,
    mirrored_moments,
)
from training.networks import Networks
from training.recipe import MixtureRecipe

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Leaves:
    """The segments in their clusters. Where the recipe says so, each segment has a mirrored twin.

    segments: (S,), rows of the corpus. leaf: (S,) of each, twin: (S,) of its twin, None without.
    """

    segments: Indices
    leaf: Indices
    twin: Indices | None
    features: SegmentFeatures
    hierarchy: DivisiveKMeans

    @property
    def count(self) -> int:
        return int(self.hierarchy.n_leaves_)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What the forest is trained on. x: (N, D); leaf: (N,) its answer; segment: (N,) of the corpus;
    pose: (N,) of the corpus.
    """

    x: Floats
    leaf: Indices
    segment: Indices
    pose: Indices


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What becomes the graph, its description without any accuracy yet, a mixture's leaves."""

    graph: Mixture | Networks
    info: ModelInfo
    leaves: Leaves | None = None  # of a mixture


def fit_mixture(
    corpus: Corpus, segments: Indices, principal: tuple[str, ...], recipe: MixtureRecipe, seed: int
) -> Fitted:
    """The mixture that these segments of the corpus give."""
    construction = CONSTRUCTIONS[recipe.body_frame]
    tracked = (*principal, *construction.references)
    features = construction.features(tracked)
    unworn = tuple(label for label in MARKERS if label not in tracked)
    x, z = columns_of(features), columns_of(unworn)
    leaves = cluster(corpus, segments, recipe, seed)
    own = [matrix(moments) for moments in _leaf_moments(corpus, leaves)]
    everything = sum(own[1:], own[0])
    whole = NormalEquations.between(everything, np.append(x, ONE), z)
    # What the graph takes: the plain method knows the principal markers alone, which come first.
    width = 3 * len(principal) if recipe.plain else len(x)
    maps = np.array([_map(moments, x[:width], z, whole, recipe) for moments in own], np.float32)
    rows = forest_rows(corpus, leaves, x[:width])
    forest = sparse_forest(grow_forest(rows.x, rows.leaf, recipe.forest, seed), recipe.plain)
    mean, covariance = mean_and_covariance(everything, x)
    info = ModelInfo(
        estimator="paper" if recipe.plain else "local",
        labels=MARKERS,
        principal=principal,
        references=construction.references,
        history=recipe.history,
        body_frame=recipe.body_frame,
        mean=mean.reshape(-1, 3).tolist(),
        covariance=covariance.tolist(),
        sigma=[0.0] * len(unworn),
        sensitivity=ridge(whole, recipe.noise)[:, :-1].tolist(),
        training={"leaves": leaves.count, "forest_nodes": len(forest.node)},
    )
    graph = Mixture(forest, recipe.plain, maps[..., :-1], maps[..., -1])
    return Fitted(graph, info, leaves)


def cluster(corpus: Corpus, segments: Indices, recipe: MixtureRecipe, seed: int) -> Leaves:
    """The leaves of these segments, and of their mirror images where the recipe wants them."""
    moments = SegmentMoments(corpus.moments, segments, recipe.mirror)
    features = segment_features(moments, recipe.covariance_weight)
    hierarchy = DivisiveKMeans(recipe.tolerance, seed).fit(features.rows)
    count = len(segments)
    twin = hierarchy.labels_[count:] if recipe.mirror else None
    return Leaves(segments, hierarchy.labels_[:count], twin, features, hierarchy)


def forest_rows(corpus: Corpus, leaves: Leaves, columns: npt.NDArray[np.intp]) -> Rows:
    """The poses of the corpus in these segments, then their mirror images, as the forest sees them:
    these coordinates of theirs.
    """
    place = np.full(len(corpus.frames), -1)
    place[leaves.segments] = np.arange(len(leaves.segments))
    pose = np.flatnonzero(place[corpus.segment] >= 0)
    segment = corpus.segment[pose]
    poses = corpus.poses[pose]
    shown, leaf = [poses], [leaves.leaf[place[segment]]]
    if leaves.twin is not None:
        shown.append(mirrored(poses))
        leaf.append(leaves.twin[place[segment]])
    return Rows(
        np.concatenate([part.reshape(-1, COORDINATES)[:, columns] for part in shown]),
        np.concatenate(leaf),
        np.tile(segment, len(shown)),
        np.tile(pose, len(shown)),
    )


def _leaf_moments(corpus: Corpus, leaves: Leaves) -> Array:
    """(K, PACKED): the moments of all frames in each leaf."""
    total = np.zeros((leaves.count, PACKED))
    for leaf in range(leaves.count):
        total[leaf] = corpus.moments[leaves.segments[leaves.leaf == leaf]].sum(axis=0)
        if leaves.twin is not None:
            twins = corpus.moments[leaves.segments[leaves.twin == leaf]].sum(axis=0)
            total[leaf] += mirrored_moments(twins)
    return total


def _map(
    moments: Array,
    x: npt.NDArray[np.intp],
    z: npt.NDArray[np.intp],
    whole: NormalEquations,
    recipe: MixtureRecipe,
) -> Array:
    """One leaf's map (U, D + 1), the constant being last.

    The plain method's is least squares, the constant being zero; else it is held back towards the
    map of all frames.
    """
    if recipe.plain:
        return np.pad(least_squares(NormalEquations.between(moments, x, z)), ((0, 0), (0, 1)))
    own = NormalEquations.between(moments, np.append(x, ONE), z)
    return shrunk(own, whole, recipe.share, recipe.noise)
