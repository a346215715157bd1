"""Runs the estimator over captures, frame by frame as the bridge does, and scores it."""

from __future__ import annotations

import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.estimator import PoseEstimator, body_frame
from bridge.model import Model, ModelInfo
from bridge.pose import Provenance
from drivers.frame import Floats, Layout, MarkerFrame
from drivers.marker_set import MARKERS
from simulators.corruption import Corruption, Faults
from training.dataset import UNKNOWN, Take
from training.metrics import (
    frame_rms,
    mean_known,
    rms,
    roughness,
    row_mean,
    transitions,
    velocity_error,
)
from training.motions import category
from training.nearest_neighbour import NearestNeighbour
from training.sigma import counted

# mm per 1/120 s: bounds of the bins that velocity errors are counted in; the last is open above.
GAMMA_EDGES = np.arange(0.0, 101.0)

Array = npt.NDArray[np.float64]

_WARM = 10  # calls at the start of a sequence that its latency leaves out
_RATE = 120.0  # Hz: what the model's history is counted in


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
class Trace:
    """One method, frame by frame (N,), over the unworn markers; NaN where nothing is to be scored.

    rms: mm. jerk: the mean velocity error since the frame before, mm per 1/120 s.
    """

    rms: Array
    jerk: Array


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One sequence's scores. subject, motion, rate (Hz): the capture's. squared_error: (U,) m²,
    per unworn marker, mean over coordinates and frames, NaN where the truth lacks it; within:
    (2, U), share of its coordinate errors within one and two sigma; surprise: (M, B), coordinate
    errors over sigma of all markers while they are not measured, counted (`training.sigma`);
    seconds: (N,), each warm call from frame to pose.

    trace, nn_trace: of the estimate and of the baseline. transition: (N,), frames at a change of
    leaf, or so shortly after it that the mixture still weighs in the frame before. gamma: (2, B),
    the velocity errors of all unworn markers counted by GAMMA_EDGES, [1] of those frames, [0] of
    the others.
    """

    file: str
    subject: str
    motion: str
    rate: float
    frames: int
    scores: Scores
    squared_error: Array
    within: Array
    surprise: npt.NDArray[np.int64]
    seconds: Array
    trace: Trace
    nn_trace: Trace | None
    transition: npt.NDArray[np.bool_]
    gamma: npt.NDArray[np.int64]


def evaluate(
    model: Model,
    takes: Iterable[Take],
    faults: Faults | None = None,
    seed: int = 0,
    baseline: NearestNeighbour | None = None,
) -> list[Result]:
    """Scores a model on each take."""
    return score(PoseEstimator(model), takes, faults, seed, baseline)


def score(
    estimator: PoseEstimator,
    takes: Iterable[Take],
    faults: Faults | None = None,
    seed: int = 0,
    baseline: NearestNeighbour | None = None,
) -> list[Result]:
    """Scores an estimator on each take."""
    info = estimator.model.info
    return [
        score_take(
            estimator, take, measured_markers(take, info, faults or Faults(), seed), baseline
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
    names = [entry.name for entry in fields(Scores)]
    return Scores(**{name: _mean([row[name] for row in rows]) for name in names})


def grouped(results: Sequence[Result], group: Callable[[Result], str]) -> dict[str, list[Result]]:
    """The results by the group that each is in, groups with most sequences first."""
    found = defaultdict(list)
    for result in results:
        found[group(result)].append(result)
    return dict(sorted(found.items(), key=lambda entry: (-len(entry[1]), entry[0])))


def motion_category(result: Result) -> str:
    """What kind of motion a sequence shows."""
    return category(result.motion)


def familiarity(result: Result, info: ModelInfo) -> str:
    """Whether the model was trained on other captures of this performer: seen, new or unknown."""
    known = info.training.get("performers")
    if known is None or result.subject == UNKNOWN:
        return "unknown"
    return "seen" if result.subject in known else "new"


def report(results: Sequence[Result], info: ModelInfo) -> dict[str, Any]:
    """The evaluation of a model as JSON holds it."""
    within = np.array([result.within for result in results])
    seconds = np.concatenate([result.seconds for result in results])
    latency = np.percentile(seconds * 1e6, [50, 99]) if len(seconds) else (None, None)

    def groups(group: Callable[[Result], str]) -> dict[str, Any]:
        return {
            name: {
                "sequences": len(part),
                "frames": sum(result.frames for result in part),
                **mean_scores(part).to_json(),
            }
            for name, part in grouped(results, group).items()
        }

    return {
        "mean": mean_scores(results).to_json(),
        "categories": groups(motion_category),
        "performers": groups(lambda result: familiarity(result, info)),
        "sequences": [
            {
                "file": result.file,
                "subject": result.subject,
                "motion": result.motion,
                "category": motion_category(result),
                "performer": familiarity(result, info),
                "frames": result.frames,
                **result.scores.to_json(),
            }
            for result in results
        ],
        "sigma": {
            f"within_{n + 1}": {
                "mean": mean_known(within[:, n]),
                "markers": {
                    label: mean_known(within[:, n, marker])
                    for marker, label in enumerate(info.unworn)
                },
            }
            for n in range(2)
        },
        "latency_us": {
            name: None if value is None else round(float(value), 1)
            for name, value in zip(("p50", "p99"), latency, strict=True)
        },
    }


def score_take(
    estimator: PoseEstimator,
    take: Take,
    measured: Floats,
    baseline: NearestNeighbour | None = None,
) -> Result:
    """Scores an estimator on one take. measured: (N, T, 3) metres, the tracked markers as they
    reach it.
    """
    info = estimator.model.info
    labels = [MARKERS.index(label) for label in info.labels]
    unworn = [info.labels.index(label) for label in info.unworn]
    estimate, sigma, leaves, guessed, seconds = run(estimator, measured, take.rate)
    truth = take.xyz[:, labels]
    true, estimated = truth[:, unworn], estimate[:, unworn]
    gamma = velocity_error(estimated, true, take.rate)
    trace = Trace(frame_rms(estimated, true), row_mean(gamma))
    nn_trace = nn_jerk = None
    if baseline is not None:
        nearest = _nearest(baseline, info, measured)
        nn_gamma = velocity_error(nearest, true, take.rate)
        nn_trace = Trace(frame_rms(nearest, true), row_mean(nn_gamma))
        nn_jerk = mean_known(nn_gamma)
    error: Array = (estimated.astype(float) - true.astype(float)) ** 2
    variance = sigma[:, unworn, None].astype(float) ** 2
    within = [np.where(np.isnan(error), np.nan, error <= n**2 * variance) for n in (1, 2)]
    transition = transitions(leaves, round(estimator.history * take.rate / _RATE))
    return Result(
        file=take.name,
        subject=take.subject,
        motion=take.motion,
        rate=take.rate,
        frames=len(true),
        scores=Scores(
            rms_mm=mean_known(trace.rms),
            rms_all_mm=rms(estimate, truth),
            jerk_mm=mean_known(gamma),
            roughness=roughness(estimated, true),
            nn_rms_mm=None if nn_trace is None else mean_known(nn_trace.rms),
            nn_jerk_mm=nn_jerk,
        ),
        squared_error=_marker_mean(error),
        within=np.array([_marker_mean(share) for share in within]),
        surprise=counted(np.where(guessed[..., None], estimate - truth, np.nan), sigma),
        seconds=seconds[_WARM:],
        trace=trace,
        nn_trace=nn_trace,
        transition=transition,
        gamma=np.array([_counted(gamma[transition == at_change]) for at_change in (False, True)]),
    )


def run(
    estimator: PoseEstimator, measured: Floats, rate: float
) -> tuple[Floats, Floats, npt.NDArray[np.intp], npt.NDArray[np.bool_], Array]:
    """One sequence from its start: the poses (N, M, 3), their sigma (N, M), the leaf with most
    votes (N,), which markers are not measured nor lost (N, M), and the seconds taken (N,).
    """
    info = estimator.model.info
    layout = Layout(info.tracked, rate)
    poses = np.empty((len(measured), len(info.labels), 3), np.float32)
    sigma = np.empty(poses.shape[:2], np.float32)
    leaves = np.empty(len(measured), np.intp)
    guessed = np.empty(sigma.shape, bool)
    seconds = np.empty(len(measured))
    estimator.reset()
    for index, xyz in enumerate(measured):
        frame = MarkerFrame(index, index / rate, index / rate, layout, xyz)
        start = time.perf_counter()
        pose = estimator.step(frame)
        seconds[index] = time.perf_counter() - start
        poses[index], sigma[index] = pose.xyz, pose.sigma
        leaves[index] = estimator.regression.leaf()
        guessed[index] = (pose.provenance == Provenance.ESTIMATED) | (
            pose.provenance == Provenance.IMPUTED
        )
    return poses, sigma, leaves, guessed, seconds


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


def _marker_mean(values: Array) -> Array:
    """Per marker (U,) the mean of (N, U, 3) over frames and coordinates, NaN left out."""
    return row_mean(values.transpose(1, 0, 2).reshape(values.shape[1], -1))


def _counted(gamma: Array) -> npt.NDArray[np.int64]:
    """How many velocity errors are in each bin of GAMMA_EDGES."""
    capped = np.minimum(gamma[~np.isnan(gamma)], GAMMA_EDGES[-1])
    return np.histogram(capped, GAMMA_EDGES)[0].astype(np.int64)


def _ratio(value: float | None, base: float | None) -> float | None:
    return value / base if value is not None and base else None


def _mean(values: Sequence[float | None]) -> float | None:
    there = [value for value in values if value is not None]
    return sum(there) / len(there) if there else None
