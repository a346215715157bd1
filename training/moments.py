"""Sums over frames of the products of all coordinates: all that training needs of whole segments.

The mean, the covariance and every least squares map of some frames follow from the second moment
of their poses with a one appended. Moments add up, so the frames need not be kept; and the mirror
image's moments are those of the pose, permuted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.mirroring import MIRRORED_COLUMNS, MIRRORED_SIGNS

Array = npt.NDArray[np.float64]

COORDINATES = 3 * len(MARKERS)
ONE = COORDINATES  # the row and column of the one that is appended to each pose
_ROWS, _COLUMNS = np.triu_indices(COORDINATES + 1)
PACKED = len(_ROWS)  # numbers of one upper triangle
_PLACE = np.zeros((COORDINATES + 1,) * 2, np.intp)  # where an entry of the matrix is when packed
_PLACE[_ROWS, _COLUMNS] = _PLACE[_COLUMNS, _ROWS] = np.arange(PACKED)
_TWIN = np.append(MIRRORED_COLUMNS, ONE)
_SIGN = np.append(MIRRORED_SIGNS, 1.0)
_TWIN_PLACE = _PLACE[_TWIN[_ROWS], _TWIN[_COLUMNS]]
_TWIN_SIGN = _SIGN[_ROWS] * _SIGN[_COLUMNS]
# Which entries of the packed moment are products of two coordinates, and which are their sums.
_IS_PRODUCT = _COLUMNS < ONE
_FIRST, _SECOND = _ROWS[_IS_PRODUCT], _COLUMNS[_IS_PRODUCT]
COVARIANCES = len(_FIRST)  # numbers of a covariance's upper triangle
_SUMS = _PLACE[:COORDINATES, ONE]
_COUNT = _PLACE[ONE, ONE]


def moments_of(poses: Floats) -> Array:
    """The moments (PACKED,) of poses (n, 41, 3) metres: the upper triangle, row by row."""
    rows = np.ones((len(poses), COORDINATES + 1))
    rows[:, :COORDINATES] = poses.reshape(len(poses), -1)
    packed: Array = (rows.T @ rows)[_ROWS, _COLUMNS]
    return packed


def mirrored_moments(moments: Array) -> Array:
    """The moments (..., PACKED) of the same frames with left and right exchanged."""
    twins: Array = moments[..., _TWIN_PLACE] * _TWIN_SIGN
    return twins


@dataclass(frozen=True, slots=True, eq=False)
class SegmentMoments:
    """The moments (S, PACKED) of some segments and, after them, where `mirror`, of their mirror
    images: made when rows are asked for, as all at once are large.
    """

    moments: Array
    segments: npt.NDArray[np.int64]
    mirror: bool

    def __len__(self) -> int:
        return len(self.segments) * (2 if self.mirror else 1)

    def __getitem__(self, rows: npt.NDArray[np.int64]) -> Array:
        count = len(self.segments)
        found: Array = self.moments[self.segments[rows % count]]
        found[rows >= count] = mirrored_moments(found[rows >= count])
        return found


def matrix(moments: Array) -> Array:
    """Unpacks moments (PACKED,) to (124, 124): coordinates in the order of MARKERS, then one."""
    whole: Array = moments[_PLACE]
    return whole


def mean_and_covariances(moments: Array) -> tuple[Array, Array]:
    """Of each row of moments (S, PACKED): the mean (S, 123), metres, and the upper triangle
    (S, COVARIANCES) of the covariance, m²; of a single frame it is zero.
    """
    count = moments[:, _COUNT, None]
    mean = moments[:, _SUMS] / count
    second = moments[:, _IS_PRODUCT] - count * mean[:, _FIRST] * mean[:, _SECOND]
    return mean, second / np.maximum(count - 1, 1)


def mean_and_covariance(whole: Array, columns: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """Mean (D,) and covariance (D, D) of some coordinates, from an unpacked matrix (124, 124)."""
    count = whole[ONE, ONE]
    mean = whole[columns, ONE] / count
    second = whole[np.ix_(columns, columns)] - count * np.outer(mean, mean)
    return mean, second / max(count - 1, 1)


def columns_of(labels: tuple[str, ...]) -> npt.NDArray[np.intp]:
    """The columns (3M,) that hold the coordinates of some markers."""
    rows = np.array([MARKERS.index(label) for label in labels], np.intp)
    return (3 * rows[:, None] + np.arange(3)).ravel()
