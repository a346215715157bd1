"""How well markers fit a body, by what a model knows of its tracked ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bridge.body_frame import CONSTRUCTIONS
from bridge.model import ModelInfo

Array = npt.NDArray[np.float64]

FLOOR = 0.01  # m: added to the model's spread, for bodies that it has not seen


class BodyFit:
    """The model's Gaussian of the tracked markers in the body frame.

    labels: the T tracked markers to be judged, those of the body frame among them (ValueError
    where they are not); positions are given in this order.
    """

    def __init__(self, info: ModelInfo, labels: tuple[str, ...]) -> None:
        construction = CONSTRUCTIONS[info.body_frame]
        lacking = [name for name in construction.references if name not in labels]
        if lacking:
            raise ValueError(f"without {', '.join(lacking)} nobody knows how the body stands")
        self.labels = labels
        names = construction.references
        self.references = [labels.index(name) for name in names]  # rows of the T
        self._origin = [names.index(name) for name in construction.origin]
        self._left, self._right = (names.index(name) for name in construction.axis)
        # A lone origin is no feature: zero by definition.
        mean = dict(zip(info.features, np.array(info.mean), strict=True))
        self.mean: Array = np.stack([mean.get(name, np.zeros(3)) for name in labels])
        self._features = [row for row, name in enumerate(labels) if name in mean]
        rows = [info.features.index(labels[row]) for row in self._features]
        coordinates = (3 * np.array(rows)[:, None] + np.arange(3)).ravel()
        covariance = np.array(info.covariance)[np.ix_(coordinates, coordinates)]
        self._moments = self._second_moments(covariance)
        covariance += FLOOR**2 * np.eye(len(covariance))
        self._whiten: Array = np.linalg.inv(np.linalg.cholesky(covariance)).T
        blocks = covariance.reshape(len(rows), 3, len(rows), 3)
        self._precisions: Array = np.tile(np.eye(3) / FLOOR**2, (len(labels), 1, 1))
        for n, row in enumerate(self._features):
            self._precisions[row] = np.linalg.inv(blocks[n, :, n])

    def _second_moments(self, covariance: Array) -> Array:
        """(T, T) m^2: means of the products of positions, and so all about distances."""
        count, features = len(self.labels), np.array(self._features)
        shape = (len(features), 3, len(features), 3)
        spread = np.zeros((count, count))
        spread[np.ix_(features, features)] = np.einsum("icjc->ij", covariance.reshape(shape))
        found: Array = spread + self.mean @ self.mean.T
        return found

    def distance(self, one: int, other: int) -> float:
        """Root mean square distance of two of the markers, metres."""
        moments = self._moments
        return float(np.sqrt(moments[one, one] + moments[other, other] - 2 * moments[one, other]))

    def times_too_large(self, xyz: Array) -> float:
        """How many times as large as the model's the body in (n, T, 3) is, whatever its axes, and
        whichever labels are exchanged.
        """
        away = xyz - xyz.mean(axis=1, keepdims=True)
        square = float(np.median((away**2).sum(axis=2).mean(axis=1)))
        moments = self._moments
        return float(np.sqrt(square / (np.trace(moments) / len(moments) - moments.mean())))

    def in_body(self, references: Array, xyz: Array) -> Array:
        """World positions xyz, (..., K, 3), in the body frame that `references`, (..., R, 3), make:
        those markers in the order of `self.references`.
        """
        origin = references[..., self._origin, :].mean(axis=-2)
        across = references[..., self._right, :2] - references[..., self._left, :2]
        length = np.maximum(np.hypot(across[..., 0], across[..., 1]), 1e-9)
        cos, sin = across[..., 0] / length, across[..., 1] / length
        zero, one = np.zeros_like(cos), np.ones_like(cos)
        turn = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], axis=-1)
        found: Array = (xyz - origin[..., None, :]) @ turn.reshape(*turn.shape[:-1], 3, 3)
        return found

    def misfit(self, xyz: Array) -> Array:
        """(..., T, 3) metres, world: (...,) squared Mahalanobis distances."""
        away = self.in_body(xyz[..., self.references, :], xyz) - self.mean
        away = away[..., self._features, :]
        away = away.reshape(*away.shape[:-2], -1) @ self._whiten
        found: Array = (away**2).sum(axis=-1)
        return found

    def misfit_each(self, in_body: Array) -> Array:
        """(..., K, 3) in the body frame: (..., K, T), of each as each of the labels, alone."""
        away = in_body[..., :, None, :] - self.mean
        found: Array = np.einsum("...ktc,tcd,...ktd->...kt", away, self._precisions, away)
        return found
