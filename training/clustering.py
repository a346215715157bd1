"""Groups segments that one linear model can serve: divisive 2-means (paper 3.2.2 and 3.2.3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClusterMixin
from sklearn.cluster import KMeans
from sklearn.utils.validation import validate_data

from training.moments import COORDINATES, COVARIANCES, SegmentMoments, mean_and_covariances
from training.ppca import components_for

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

VARIANCE = 0.95  # share of the features' variance that is kept
BASIS = 2048  # segments that the features' scale and axes are learned from, at most
_ROUNDING = 1e-9
_BATCH = 256  # segments at a time: their features take 16 MB


@dataclass(frozen=True, slots=True, eq=False)
class SegmentFeatures:
    """What characterises segments: [w v, (1 - w) mu] of each, reduced by PCA.

    rows: (S, q). variances: of all principal axes, largest first; the first q are kept.
    """

    rows: Array
    variances: Array


def segment_features(moments: SegmentMoments, weight: float) -> SegmentFeatures:
    """The features of segments, of which these are the moments; `weight` is w.

    v is the upper triangle of the covariance, mu the mean. Both parts are scaled to a total
    variance of 1 over the segments first, so that w alone sets their balance; then PCA keeps 95 %
    of the variance. The unit is thus the spread of all segments. Of more than BASIS segments every
    so many-th tells scale and axes: memory and time then grow with the segments, not their square.
    """
    some = np.linspace(0, len(moments) - 1, min(len(moments), BASIS)).round().astype(int)
    seen = np.empty((len(some), COVARIANCES + COORDINATES))
    for place, features in _batches(moments, some):
        seen[place] = features
    centre = seen.mean(axis=0)
    seen -= centre
    scale = np.empty(len(centre))
    scale[:COVARIANCES] = weight * _inverse_spread(seen[:, :COVARIANCES])
    scale[COVARIANCES:] = (1 - weight) * _inverse_spread(seen[:, COVARIANCES:])
    seen *= scale
    axes, variances = principal_axes(seen, VARIANCE)
    del seen
    rows = np.empty((len(moments), axes.shape[1]))
    for place, features in _batches(moments, np.arange(len(moments))):
        rows[place] = (features - centre) * scale @ axes
    return SegmentFeatures(rows, variances)


def _batches(moments: SegmentMoments, rows: Indices) -> Iterator[tuple[slice, Array]]:
    """Some of the rows at a time: their place among them, and [v, mu] of each."""
    for start in range(0, len(rows), _BATCH):
        place = slice(start, start + _BATCH)
        mu, v = mean_and_covariances(moments[rows[place]])
        yield place, np.hstack([v, mu])


def principal_axes(centred: Array, share: float) -> tuple[Array, Array]:
    """The fewest axes (D, q) that hold this share of the variance of the rows (S, D), and the
    variances of all axes.

    By the products of the rows with each other: there are far fewer rows than columns.
    """
    values, left = np.linalg.eigh(centred @ centred.T)
    values, left = np.maximum(values[::-1], 0.0), left[:, ::-1]
    kept = components_for(values, share)
    lengths = np.sqrt(values[:kept])
    axes: Array = centred.T @ left[:, :kept] / np.where(lengths > 0, lengths, 1.0)
    return axes, values / len(centred)


class DivisiveKMeans(ClusterMixin, BaseEstimator):  # type: ignore[misc]
    """Clusters are halved by 2-means until every member is near its cluster's mean.

    Near is within `tolerance` times the root mean square distance of all rows from their mean.

    labels_: the leaf (S,) of each row; leaves are numbered in the order of their first rows.
    n_leaves_: how many. children_: (n_leaves_ - 1, 2), the halvings as scikit-learn's hierarchies
    have them: below n_leaves_ a leaf, else row `child - n_leaves_`; the last row halves all.
    radius_: (2 n_leaves_ - 1,), of each leaf and halving: the largest distance of a member from
    its mean. limit_: the radius that a leaf may have.
    """

    def __init__(self, tolerance: float = 0.6, random_state: int | None = None) -> None:
        self.tolerance = tolerance
        self.random_state = random_state

    def fit(self, X: npt.ArrayLike, y: Any = None) -> Self:  # noqa: N803 (scikit-learn's name)
        """Groups the rows (S, D); `y` is not used."""
        rows = validate_data(self, X, dtype=np.float64)
        spread = np.sqrt(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean())
        # Below that, distances are rounding: copies of a row are one leaf.
        self.limit_ = max(self.tolerance * float(spread), _ROUNDING * float(np.abs(rows).max()))
        # Depth first: (members, the halving above, which of its children).
        waiting: list[tuple[Indices, int, int]] = [(np.arange(len(rows)), -1, 0)]
        leaves: list[tuple[Indices, float, int, int]] = []
        halvings: list[tuple[float, int, int]] = []
        while waiting:
            members, above, side = waiting.pop()
            part = rows[members]
            radius = float(np.linalg.norm(part - part.mean(axis=0), axis=1).max())
            if radius <= self.limit_:
                leaves.append((members, radius, above, side))
                continue
            first = KMeans(2, n_init=10, random_state=self.random_state).fit(part).labels_ == 0
            waiting += [(members[first], len(halvings), 0), (members[~first], len(halvings), 1)]
            halvings.append((radius, above, side))
        leaves.sort(key=lambda leaf: int(leaf[0][0]))
        self.n_leaves_ = len(leaves)
        self.labels_ = np.empty(len(rows), np.int64)
        self.children_ = np.empty((len(halvings), 2), np.int64)
        for number, (members, _, above, side) in enumerate(leaves):
            self.labels_[members] = number
            if above >= 0:
                self.children_[above, side] = number
        for number, (_, above, side) in enumerate(halvings):
            if above >= 0:
                # The rows are turned round below.
                self.children_[above, side] = 2 * len(leaves) - 2 - number
        self.children_ = self.children_[::-1].copy()
        self.radius_ = np.array([leaf[1] for leaf in leaves] + [h[0] for h in halvings[::-1]])
        return self


def _inverse_spread(centred: Array) -> float:
    """One over the root of the total variance of the rows; 1 where they are all the same."""
    total = float(np.sqrt(np.einsum("sd,sd->", centred, centred) / len(centred)))
    return 1 / total if total else 1.0
