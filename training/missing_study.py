"""How many tracked markers may be missing, and for how long (paper section 5).

Each way of filling them in gets the same captures with the same samples missing.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.estimator import PoseEstimator
from bridge.imputation import ConditionalGaussian
from bridge.model import Model, ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from simulators.corruption import Faults, Gaps
from training.dataset import Take
from training.evaluation import measured_markers, score_take
from training.metrics import mean_known
from training.progress import Advance
from training.proximity import ProximityImputer, spread_evenly

NUMBER, GAP, DROP = "number", "gap", "drop"
EXPERIMENTS = {
    NUMBER: (0, 1, 2, 3, 4, 5, 6),  # markers hidden at once
    GAP: (10, 20, 40, 60, 120, 240),  # frames of 1/120 s
    DROP: (10, 20, 30, 50),  # % of the samples, frame by frame
}
TITLES = {
    NUMBER: "markers hidden, every other second",
    GAP: "length of the gaps (frames of 1/120 s)",
    DROP: "samples dropped at random (%)",
}
GAP_SHARE = 0.2  # of the samples, whatever the length of the gaps
SEEN = 0.5  # s at the start of a take before the first markers are hidden
HIDDEN = 1.0  # s that they are, and then for as long are not
DAMPING = 0.1  # s: time constant with which a marker comes to rest (docs/decisions/0013)
METHODS = ("conditional", "temporal", "bridge", "proximity")  # the last of mixtures alone
STEPS = sum(map(len, EXPERIMENTS.values()))  # of the work, for its progress

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class MissingScore:
    """One point of a curve: errors in mm over the unworn markers, mean over sequences.

    value: in the unit of the experiment (EXPERIMENTS). missing_percent: the share of all samples
    that was missing; captures being finite, not just what was asked for. rms_missing_mm: over the
    frames that lack a tracked marker. None where nothing is there to be scored.
    """

    method: str
    experiment: str
    value: float
    missing_percent: float
    rms_mm: float | None
    rms_missing_mm: float | None
    jerk_mm: float | None

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def missing_study(
    model: Model, takes: Sequence[Take], poses: Floats, seed: int, advance: Advance
) -> list[MissingScore]:
    """Scores every method in every experiment.

    poses: (N, 41, 3) metres, in the body frame: those of training, for the proximities. advance is
    told of each of the STEPS.
    """
    estimators = compared(model, poses)
    scores = []
    for experiment, values in EXPERIMENTS.items():
        for value in values:
            if experiment == NUMBER and value >= len(model.info.tracked):
                advance(f"{TITLES[experiment]}: {value} are more than are tracked", 1)
                continue
            measured = [lacking(take, model.info, experiment, value, seed) for take in takes]
            samples = np.concatenate([np.isnan(lacks[..., 0]).ravel() for lacks in measured])
            percent = 100 * float(samples.mean())
            for method, estimator in estimators.items():
                errors = [
                    _errors(estimator, take, lacks)
                    for take, lacks in zip(takes, measured, strict=True)
                ]
                means = (
                    mean_known(np.array(column, float)) for column in zip(*errors, strict=True)
                )
                scores.append(MissingScore(method, experiment, value, percent, *means))
            advance(f"{TITLES[experiment]}: {value}", 1)
    return scores


def compared(model: Model, poses: Floats) -> dict[str, PoseEstimator]:
    """The methods, by name. Breiman's needs the forest that a mixture has."""
    gaussian = ConditionalGaussian(model.info.mean, model.info.covariance)
    conditional, temporal, bridge, proximity = METHODS
    ways = {
        conditional: PoseEstimator(model, imputation=ConditionalMean(gaussian)),
        temporal: PoseEstimator(model, imputation=Extrapolation(model.info.mean)),
        bridge: PoseEstimator(model),
    }
    if model.leaves:
        imputer = ProximityImputer(model, spread_evenly(poses))
        ways[proximity] = PoseEstimator(model, imputation=imputer)
    return ways


def methods_of(names: Iterable[str]) -> list[str]:
    """The methods among the names, each once, in their order."""
    there = set(names)
    return [method for method in METHODS if method in there]


def lacking(take: Take, info: ModelInfo, experiment: str, value: float, seed: int) -> Floats:
    """The tracked markers (N, T, 3) of a take with samples missing, the same for the same seed."""
    if experiment == NUMBER:
        return _hidden(take, info, int(value), seed)
    if experiment == GAP:
        length = max(1, round(value * take.rate / 120.0))
        return measured_markers(take, info, Faults(gaps=Gaps(GAP_SHARE, length, length)), seed)
    return measured_markers(take, info, Faults(drop=value / 100), seed)


def _hidden(take: Take, info: ModelInfo, count: int, seed: int) -> Floats:
    """So many markers are hidden for a second, then all are seen for one; then others are."""
    markers: Floats = take.xyz[:, [MARKERS.index(label) for label in info.tracked]]
    random = np.random.default_rng([seed, zlib.crc32(take.name.encode())])
    for start in np.arange(SEEN, len(markers) / take.rate, 2 * HIDDEN):
        # One order for every count: whoever is hidden among two is so among three.
        rows = random.permutation(len(info.tracked))[:count]
        markers[round(start * take.rate) : round((start + HIDDEN) * take.rate), rows] = np.nan
    return markers


def _errors(
    estimator: PoseEstimator, take: Take, measured: Floats
) -> tuple[float | None, float | None, float | None]:
    """RMS, RMS where a marker is missing, and jerkiness, mm."""
    result = score_take(estimator, take, measured)
    lacks = np.isnan(measured).any(axis=(1, 2))
    where_missing = mean_known(result.trace.rms[lacks])
    return result.scores.rms_mm, where_missing, result.scores.jerk_mm


class ConditionalMean:
    """The conditional Gaussian alone: each frame for itself."""

    def __init__(self, gaussian: ConditionalGaussian) -> None:
        self._gaussian = gaussian

    def reset(self) -> None:
        """There is no past to forget."""

    def fill(self, xyz: Floats, present: Mask, interval: float) -> Floats:
        """The markers (F, 3) with the rows that are not present (F,) filled in."""
        return self._gaussian.fill(xyz, present)


class Extrapolation:
    """Each marker for itself, out of its past alone: it goes on as it went, and comes to rest.

    mean: (F, 3) metres, in the body frame, where a marker is before it was ever seen. damping:
    seconds; with 0 a marker stays where it was seen last.
    """

    def __init__(self, mean: npt.ArrayLike, damping: float = DAMPING) -> None:
        self._mean = np.array(mean, float)
        self._damping = damping
        self.reset()

    def reset(self) -> None:
        """Forgets the past: a new performer or sequence."""
        self._position = self._mean.copy()
        self._velocity = np.zeros_like(self._mean)
        self._seen = self._mean.copy()
        self._age = np.full((len(self._mean), 1), np.inf)  # s since then

    def fill(self, xyz: Floats, present: Mask, interval: float) -> Floats:
        """The next frame's markers (F, 3), in the body frame, with the missing ones filled in."""
        self._age += interval
        now = present[:, None]
        if self._damping:
            decay = np.exp(-interval / self._damping)
            self._position += self._velocity * self._damping * (1 - decay)
            self._velocity = np.where(now, (xyz - self._seen) / self._age, self._velocity * decay)
        self._position = np.where(now, xyz, self._position)
        self._seen = np.where(now, xyz, self._seen)
        self._age[present] = 0.0
        filled: Floats = self._position.astype(np.float32)
        return filled
