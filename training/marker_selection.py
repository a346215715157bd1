"""Chooses the principal markers from data: principal feature analysis per marker (paper 3.1.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.cluster import KMeans

from training.ppca import components_for
from training.workers import single_threaded

Array = npt.NDArray[np.float64]

VARIANCE = 0.95  # share of the variance that the components keep
SPARE_CLUSTERS = 1  # K is "slightly greater than q"
RESTARTS = 1000  # of K-means: with 10 the choice still hangs on the seed


@dataclass(frozen=True, slots=True)
class Selection:
    """The markers chosen, most important first; q components were kept, and K clusters made."""

    markers: tuple[str, ...]
    components: int
    clusters: int


@single_threaded
def select_markers(
    covariance: Array,
    labels: Sequence[str],
    seed: int = 0,
    spare_clusters: int = SPARE_CLUSTERS,
    restarts: int = RESTARTS,
) -> Selection:
    """The fewest important markers that cover all clusters of coordinates.

    covariance: (3M, 3M) of coordinates in the body frame, only of the markers that may be chosen;
    labels: theirs. More spare clusters give more markers.
    """
    weights = component_weights(covariance, VARIANCE)
    count = min(weights.shape[1] + spare_clusters, len(weights))
    means = KMeans(count, n_init=restarts, random_state=seed).fit(weights)
    cluster = means.labels_.reshape(-1, 3)
    distance = ((weights - means.cluster_centers_[means.labels_]) ** 2).sum(axis=1)
    kept = cover(cluster, distance.reshape(-1, 3).sum(axis=1))
    return Selection(tuple(labels[marker] for marker in kept), weights.shape[1], count)


def component_weights(covariance: Array, variance: float) -> Array:
    """|V| (D, q): what each coordinate weighs in the first components, by their variance."""
    values, axes = np.linalg.eigh(covariance)
    kept = components_for(values[::-1], variance)
    weights: Array = np.abs(axes[:, ::-1][:, :kept])
    return weights


def cover(cluster: npt.NDArray[np.integer], distance: Array) -> list[int]:
    """Markers that cover all clusters: the least important are removed while the rest do.

    cluster: (M, 3), of each marker's coordinates; distance: (M,), the sum of their squared
    distances to the means of their clusters. A marker in more clusters is more important, among
    equals the nearer one. Returns rows, most important first.
    """
    clusters = [set(row) for row in cluster.tolist()]
    order = sorted(range(len(clusters)), key=lambda row: (len(clusters[row]), -distance[row]))
    everything = set().union(*clusters)
    kept = list(order)
    # Removing a marker only makes the others more needed: one pass finds all that can go.
    for marker in order:
        rest = [other for other in kept if other != marker]
        if set().union(*(clusters[other] for other in rest)) == everything:
            kept = rest
    return kept[::-1]
