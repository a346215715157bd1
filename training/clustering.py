"""Groups segments that one linear model can serve: divisive 2-means (paper 3.2.2 and 3.2.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from sklearn.cluster import KMeans

Array = npt.NDArray[np.float64]

VARIANCE = 0.95  # share of the features' variance that is kept


def segment_features(segments: Sequence[npt.NDArray[np.floating]], weight: float) -> Array:
    """What characterises each segment (frames, D): (S, q), the reduced [w v, (1 - w) mu].

    v is the upper triangle of the covariance, mu the mean. Both parts are scaled to a total
    variance of 1 over the segments first, so that `weight`, w, alone sets their balance; then PCA
    keeps 95 % of the variance. The unit is thus the spread of all segments.
    """
    upper = np.triu_indices(segments[0].shape[1])
    v = _scaled(np.array([np.cov(part.astype(float), rowvar=False)[upper] for part in segments]))
    mu = _scaled(np.array([part.mean(axis=0, dtype=float) for part in segments]))
    return reduce(np.hstack([weight * v, (1 - weight) * mu]), VARIANCE)


def reduce(features: Array, variance: float) -> Array:
    """Principal components (S, q) of the rows, the fewest that keep this share of the variance."""
    left, values, _ = np.linalg.svd(features - features.mean(axis=0), full_matrices=False)
    share = np.cumsum(values**2)
    kept = 1 + int(np.searchsorted(share, variance * share[-1]))
    reduced: Array = left[:, :kept] * values[:kept]
    return reduced


def divide(features: Array, tolerance: float, seed: int) -> npt.NDArray[np.int64]:
    """The leaf (S,) of each row: clusters are halved until every member is near its mean.

    Near is within `tolerance` times the root mean square distance of all rows from their mean.
    Leaves are numbered in the order of their first rows.
    """
    limit = tolerance * float(np.sqrt(((features - features.mean(axis=0)) ** 2).sum(axis=1).mean()))
    leaves = []
    waiting = [np.arange(len(features))]
    while waiting:
        members = waiting.pop()
        rows = features[members]
        if np.linalg.norm(rows - rows.mean(axis=0), axis=1).max() <= limit:
            leaves.append(members)
            continue
        half = KMeans(2, n_init=10, random_state=seed).fit(rows).labels_ == 0
        waiting += [members[half], members[~half]]
    labels = np.empty(len(features), np.int64)
    for leaf, members in enumerate(sorted(leaves, key=lambda members: int(members[0]))):
        labels[members] = leaf
    return labels


def _scaled(rows: Array) -> Array:
    total = float(np.sqrt(rows.var(axis=0).sum()))
    return rows / total if total else rows
