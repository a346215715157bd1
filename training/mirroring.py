"""The other-handed twin of a pose: what somebody who moves the other way round would have done."""

from __future__ import annotations

import numpy as np

from drivers.frame import Floats
from drivers.marker_set import MARKERS

_SIDES = {"L": "R", "R": "L"}


def _twin(label: str) -> str:
    """The label of the other side; a marker on the middle of the body is its own (RBAC too)."""
    other = _SIDES.get(label[0], label[0]) + label[1:]
    return other if other in MARKERS else label


_TWINS = np.array([MARKERS.index(_twin(label)) for label in MARKERS], np.intp)
# Coordinate c of the twin is SIGNS[c] times coordinate COLUMNS[c] of the pose.
MIRRORED_COLUMNS = (3 * _TWINS[:, None] + np.arange(3)).ravel()
MIRRORED_SIGNS = np.tile(np.array([-1, 1, 1], np.float32), len(MARKERS))


def mirrored(poses: Floats) -> Floats:
    """Poses (N, 41, 3) in the body frame with left and right exchanged."""
    rows = poses.reshape(len(poses), -1)
    return (rows[:, MIRRORED_COLUMNS] * MIRRORED_SIGNS).reshape(poses.shape)
