"""The baseline (paper section 4.1): the training pose whose tracked markers are nearest."""

from __future__ import annotations

import numpy as np

from bridge.model import ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS

_BATCH = 128  # frames at a time: 100,000 poses then need 100 MB


class NearestNeighbour:
    """Searches whole training poses (N, 41, 3), in the body frame, by the markers of a model.

    Brute force: the squared distances over the coordinates that are present, a matrix product.
    """

    def __init__(self, poses: Floats, info: ModelInfo) -> None:
        features = [MARKERS.index(label) for label in info.features]
        self._unworn = poses[:, [MARKERS.index(label) for label in info.unworn]]
        rows = poses[:, features].reshape(len(poses), -1).astype(float)
        # sum m (row - x)^2 over the present coordinates m is linear in [row^2, row] but for a
        # term that is the same for all rows.
        self._searched = np.hstack([rows**2, rows]).T.copy()

    def find(self, features: Floats) -> Floats:
        """The unworn markers (n, U, 3) of the poses nearest to the markers (n, F, 3), NaN missing.

        A frame without any marker keeps the pose of the frame before.
        """
        x = features.reshape(len(features), -1).astype(float)
        present = ~np.isnan(x)
        queries = np.hstack([present.astype(float), -2.0 * np.where(present, x, 0.0)])
        nearest = np.zeros(len(x), np.int64)
        for start in range(0, len(x), _BATCH):
            part = slice(start, start + _BATCH)
            nearest[part] = (queries[part] @ self._searched).argmin(axis=1)
        searched = np.where(present.any(axis=1), np.arange(len(x)), 0)
        found: Floats = self._unworn[nearest[np.maximum.accumulate(searched)]]
        return found
