"""Runs the estimator over captures, frame by frame as the bridge does, and scores it."""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.estimator import PoseEstimator, body_frame
from bridge.model import Model, ModelInfo
from drivers.frame import Floats, Layout, MarkerFrame
from drivers.marker_set import MARKERS
from simulators.corruption import Corruption, Faults
from training.dataset import Take
from training.metrics import jerk, mean_known, rms, roughness
from training.nearest_neighbour import NearestNeighbour

_WARM = 10  # calls at the start of a sequence that its latency leaves out


@dataclass(frozen=True, slots=True)
class Scores:
    """Errors in mm; None where there is nothing to score, or no baseline. Ratios are to it."""

    rms_mm: float | None
    rms_all_mm: float | None
    jerk_mm: float | None
    roughness: float | None
    nn_rms_mm: float | None = None
    nn_jerk_mm: float | None = None

    def to_json(self) -> dict[str, float | None]:
        return asdict(self) | {
            "rms_ratio": _ratio(self.rms_mm, self.nn_rms_mm),
            "jerk_ratio": _ratio(self.jerk_mm, self.nn_jerk_mm),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One sequence's scores. squared_error: (U,) m², per unworn marker, mean over coordinates and
    frames, NaN where the truth lacks it; within: (2, U), share of its coordinate errors within one
    and two sigma; seconds: (N,), each warm call from frame to pose.
    """

    file: str
    frames: int
    scores: Scores
    squared_error: npt.NDArray[np.float64]
    within: npt.NDArray[np.float64]
    seconds: npt.NDArray[np.float64]


def evaluate(
    model: Model,
    takes: Sequence[Take],
    faults: Faults | None = None,
    seed: int = 0,
    baseline: NearestNeighbour | None = None,
) -> list[Result]:
    """Scores each take."""
    estimator = PoseEstimator(model)
    return [
        _evaluate_one(
            estimator, take, measured_markers(take, model.info, faults or Faults(), seed), baseline
        )
        for take in takes
    ]


def measured_markers(take: Take, info: ModelInfo, faults: Faults, seed: int) -> Floats:
    """The tracked markers (N, T, 3) as they reach the estimator.

    Each take has faults of its own, by `seed` and its name: the order does not matter.
    """
    tracked = [MARKERS.index(label) for label in info.tracked]
    corruption = Corruption(faults, len(tracked), [seed, zlib.crc32(take.name.encode())])
    return np.array([corruption.apply(frame) for frame in take.xyz[:, tracked]])


def mean_scores(results: Sequence[Result]) -> Scores:
    """The mean over sequences of each score, those without it left out."""
    rows = [asdict(result.scores) for result in results]
    return Scores(**{name: _mean([row[name] for row in rows]) for name in rows[0]})


def report(results: Sequence[Result], unworn: Sequence[str]) -> dict[str, Any]:
    """The evaluation as JSON holds it; unworn: the labels of the markers scored."""
    within = np.array([result.within for result in results])
    seconds = np.concatenate([result.seconds for result in results])
    latency = np.percentile(seconds * 1e6, [50, 99]) if len(seconds) else (None, None)
    return {
        "mean": mean_scores(results).to_json(),
        "sequences": [
            {"file": result.file, "frames": result.frames, **result.scores.to_json()}
            for result in results
        ],
        "sigma": {
            f"within_{n + 1}": {
                "mean": mean_known(within[:, n]),
                "markers": {
                    label: mean_known(within[:, n, marker]) for marker, label in enumerate(unworn)
                },
            }
            for n in range(2)
        },
        "latency_us": {
            name: None if value is None else round(float(value), 1)
            for name, value in zip(("p50", "p99"), latency, strict=True)
        },
    }


def _evaluate_one(
    estimator: PoseEstimator, take: Take, measured: Floats, baseline: NearestNeighbour | None
) -> Result:
    """measured: (N, T, 3) metres, the tracked markers as they reach the estimator."""
    info = estimator.model.info
    truth = take.xyz[:, [MARKERS.index(label) for label in info.labels]]
    unworn = [info.labels.index(label) for label in info.unworn]
    layout = Layout(info.tracked, take.rate)
    estimate = np.empty_like(truth)
    sigma = np.empty(truth.shape[:2], np.float32)
    seconds = np.empty(len(truth))
    estimator.reset()
    for index, xyz in enumerate(measured):
        frame = MarkerFrame(index, index / take.rate, index / take.rate, layout, xyz)
        start = time.perf_counter()
        pose = estimator.step(frame)
        seconds[index] = time.perf_counter() - start
        estimate[index], sigma[index] = pose.xyz, pose.sigma
    nearest = None if baseline is None else _nearest(baseline, info, measured)
    error = (estimate[:, unworn].astype(float) - truth[:, unworn]) ** 2
    there = ~np.isnan(error)
    count = there.sum(axis=(0, 2))

    def share(values: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Mean of (N, U, 3) over frames and coordinates, where the truth is there."""
        total = np.where(there, values, 0.0).sum(axis=(0, 2))
        blank = np.full(len(count), np.nan)
        mean: npt.NDArray[np.float64] = np.divide(total, count, out=blank, where=count > 0)
        return mean

    variance = sigma[:, unworn, None].astype(float) ** 2
    return Result(
        file=take.name,
        frames=len(truth),
        scores=Scores(
            rms_mm=rms(estimate[:, unworn], truth[:, unworn]),
            rms_all_mm=rms(estimate, truth),
            jerk_mm=jerk(estimate[:, unworn], truth[:, unworn], take.rate),
            roughness=roughness(estimate[:, unworn], truth[:, unworn]),
            nn_rms_mm=None if nearest is None else rms(nearest, truth[:, unworn]),
            nn_jerk_mm=None if nearest is None else jerk(nearest, truth[:, unworn], take.rate),
        ),
        squared_error=share(error),
        within=np.array([share((error <= n**2 * variance).astype(float)) for n in (1, 2)]),
        seconds=seconds[_WARM:],
    )


def _nearest(baseline: NearestNeighbour, info: ModelInfo, measured: Floats) -> Floats:
    """The baseline's unworn markers (N, U, 3) in the world, by the body frame of the estimator."""
    features = [info.tracked.index(label) for label in info.features]
    body = body_frame(info)
    searched = np.empty((len(measured), len(features), 3), np.float32)
    rotations = np.empty((len(measured), 3, 3))
    origins = np.full((len(measured), 1, 3), np.nan)
    for index, frame in enumerate(measured):
        body.update(frame)
        searched[index] = body.to_body(frame[features])
        rotations[index] = body.rotation
        if body.known:
            origins[index] = body.origin
    world = baseline.find(searched) @ rotations.transpose(0, 2, 1) + origins
    found: Floats = world.astype(np.float32)
    return found


def _ratio(value: float | None, base: float | None) -> float | None:
    return value / base if value is not None and base else None


def _mean(values: Sequence[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None
