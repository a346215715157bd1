"""What becomes of a marker that is hidden for a while, and then returns: `evaluate --hide`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.estimator import PoseEstimator
from bridge.model import Model, ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from simulators.corruption import Faults
from training.dataset import Take
from training.evaluation import measured_markers, run
from training.metrics import frame_rms, row_mean, velocity_error
from training.progress import Advance

ALL = "all"  # in place of a marker: each in turn
AGES = (0.1, 0.5, 1.0, 2.0)  # s of a hiding at which errors are told, and at its end
EVERY = 0.5  # s between the starts of two hidings
BEFORE = 0.5  # s that the estimator sees the marker before it is hidden
AFTER = 0.3  # s that are watched after it returns
_PERCENTILE = 99.0  # of the largest velocity errors, told beside the maximum

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Hiding:
    """A tracked marker, or ALL, hidden for `seconds`."""

    marker: str
    seconds: float

    @property
    def ages(self) -> tuple[float, ...]:
        """Seconds since it is hidden at which errors are told."""
        return (*(age for age in AGES if age < self.seconds), self.seconds)


@dataclass(frozen=True, slots=True)
class AtAge:
    """A marker hidden for so long, mean over the hidings. error_mm: its own; unworn_rms_mm: over
    the unworn markers. within_1, within_2: share of its coordinate errors within so many sigma.
    """

    age_s: float
    error_mm: float | None
    unworn_rms_mm: float | None
    within_1: float | None
    within_2: float | None


@dataclass(frozen=True, slots=True)
class Largest:
    """The largest difference in velocity of any marker of the body in the AFTER seconds from a
    return on, mm per 1/120 s: its mean, 99th percentile and maximum over the hidings.
    """

    mean_mm: float | None
    p99_mm: float | None
    max_mm: float | None


@dataclass(frozen=True, slots=True)
class HiddenMarker:
    """What was found of one marker. within_1, within_2: over all frames in which it is hidden.
    returning: velocities against the truth. blending: against those of the estimator to which
    nothing was hidden.
    """

    marker: str
    ages: tuple[AtAge, ...]
    within_1: float | None
    within_2: float | None
    returning: Largest
    blending: Largest


@dataclass(frozen=True, slots=True)
class Hidden:
    """What was found of all. windows: hidings of each marker. mean: over the markers; its returns
    are those of all. unhidden: the same frames as in `returning`, where nothing was hidden.
    too_short: files without room for one hiding.
    """

    seconds: float
    windows: int
    markers: tuple[HiddenMarker, ...]
    mean: HiddenMarker
    unhidden: Largest
    too_short: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def parse_hiding(text: str) -> Hiding:
    """`RTOE@1s`: that marker, for a second; `all@1s`: each in turn. Raises ValueError."""
    match = re.fullmatch(r"(\w+)@(\d+(?:\.\d+)?)s", text.strip())
    if not match or not float(match[2]) > 0:
        raise ValueError(f"'{text}' hides nothing: write for example RTOE@1s or all@1s")
    return Hiding(match[1], float(match[2]))


def evaluate_hidden(
    model: Model,
    takes: Sequence[Take],
    hiding: Hiding,
    faults: Faults,
    seed: int,
    advance: Advance,
) -> Hidden:
    """Hides the marker from every half second of each take in turn; each time anew.

    Takes that do not go on for AFTER seconds after the return from one hiding are named. advance
    is told of each take.
    """
    info = model.info
    estimator = PoseEstimator(model)
    markers = info.tracked if hiding.marker == ALL else (hiding.marker,)
    errors: dict[str, list[Array]] = {marker: [] for marker in markers}
    largest: dict[str, list[tuple[float, float]]] = {marker: [] for marker in markers}
    unhidden: list[float] = []
    too_short = []
    for take in takes:
        measured = measured_markers(take, info, faults, seed)
        truth = take.xyz[:, [MARKERS.index(label) for label in info.labels]]
        ages = [round(age * take.rate) for age in hiding.ages]
        before, after = round(BEFORE * take.rate), round(AFTER * take.rate)
        back = before + ages[-1] + 1
        starts = range(0, len(truth) - back - after + 1, max(1, round(EVERY * take.rate)))
        if not starts:
            too_short.append(take.name)
        for start in starts:
            window = slice(start, start + back + after)
            true = truth[window]
            whole, *_ = run(estimator, measured[window], take.rate)
            unhidden.append(_largest(whole[back - 1 :], true[back - 1 :], take.rate))
            for marker in markers:
                seen = measured[window].copy()
                seen[before:back, info.tracked.index(marker)] = np.nan
                poses, sigma, *_ = run(estimator, seen, take.rate)
                hidden = poses[before:back], sigma[before:back], true[before:back]
                errors[marker].append(_errors(info, marker, ages, *hidden))
                returned = poses[back - 1 :]
                largest[marker].append(
                    (
                        _largest(returned, true[back - 1 :], take.rate),
                        _largest(returned, whole[back - 1 :], take.rate),
                    )
                )
        advance(f"hidden in {take.name}", 1)
    means = {
        marker: row_mean(np.array(rows).reshape(-1, 4 * len(hiding.ages) + 2).T)
        for marker, rows in errors.items()
    }
    of_all = row_mean(np.array(list(means.values())).T)
    return Hidden(
        seconds=hiding.seconds,
        windows=len(unhidden),
        markers=tuple(_told(marker, hiding, means[marker], largest[marker]) for marker in markers),
        mean=_told("mean", hiding, of_all, [pair for one in largest.values() for pair in one]),
        unhidden=_spread(unhidden),
        too_short=tuple(too_short),
    )


def _errors(
    info: ModelInfo, marker: str, ages: Sequence[int], poses: Floats, sigma: Floats, truth: Floats
) -> Array:
    """Of the frames (N, M, 3) in which a marker is hidden: the four figures of `AtAge` at each age
    in turn, then the two of `HiddenMarker`, (4A + 2,); NaN where the truth is missing.
    """
    row = info.labels.index(marker)
    unworn = [info.labels.index(label) for label in info.unworn]
    error = poses[:, row].astype(float) - truth[:, row]
    distance = 1000 * np.linalg.norm(error, axis=1)
    within = np.array([(np.abs(error) <= n * sigma[:, row, None]).mean(axis=1) for n in (1, 2)])
    within[:, np.isnan(distance)] = np.nan
    rms = frame_rms(poses[ages][:, unworn], truth[ages][:, unworn])
    at_ages = np.column_stack([distance[ages], rms, within[:, ages].T])
    return np.concatenate([at_ages.ravel(), row_mean(within)])


def _largest(poses: Floats, others: Floats, rate: float) -> float:
    """The largest difference in velocity of any marker; NaN where none is known."""
    differences = velocity_error(poses, others, rate)
    known = differences[~np.isnan(differences)]
    return float(known.max()) if len(known) else np.nan


def _told(
    marker: str, hiding: Hiding, mean: Array, largest: Sequence[tuple[float, float]]
) -> HiddenMarker:
    figures = [_known(value) for value in mean]
    ages = tuple(AtAge(age, *figures[4 * row : 4 * row + 4]) for row, age in enumerate(hiding.ages))
    returning, blending = (_spread([pair[part] for pair in largest]) for part in (0, 1))
    return HiddenMarker(marker, ages, figures[-2], figures[-1], returning, blending)


def _spread(largest: Sequence[float]) -> Largest:
    values = np.array(largest, float)
    known = values[~np.isnan(values)]
    if not len(known):
        return Largest(None, None, None)
    high = float(np.percentile(known, _PERCENTILE))
    return Largest(float(known.mean()), high, float(known.max()))


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
