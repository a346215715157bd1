"""What is left of a marker that has been hidden for a while: `evaluate --hide M@1s`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.frame import Layout, MarkerFrame
from simulators.corruption import Faults
from training.dataset import Take
from training.evaluation import measured_markers
from training.metrics import frame_rms, mean_known

EVERY = 0.5  # s between the starts of two hidings
BEFORE = 0.5  # s that the estimator sees the marker before it is hidden


@dataclass(frozen=True, slots=True)
class Hiding:
    """A tracked marker, hidden for `seconds`."""

    marker: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Hidden:
    """Errors at the end of all hidings, mm, mean over them; None without any. too_short: files."""

    marker: str
    age_s: float
    windows: int
    error_mm: float | None
    unworn_rms_mm: float | None
    too_short: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def parse_hiding(text: str) -> Hiding:
    """`RTOE@1s`: that marker, for a second. Raises ValueError."""
    match = re.fullmatch(r"(\w+)@(\d+(?:\.\d+)?)s", text.strip())
    if not match or not float(match[2]) > 0:
        raise ValueError(f"'{text}' hides nothing: write for example RTOE@1s")
    return Hiding(match[1], float(match[2]))


def evaluate_hidden(
    model: Model, takes: Sequence[Take], hiding: Hiding, faults: Faults, seed: int
) -> Hidden:
    """Hides the marker from every half second of each take in turn; each time anew.

    The error is the hidden marker's at that age, beside it the RMS over the unworn markers in the
    same frames. Takes without room for one hiding are named.
    """
    info = model.info
    estimator = PoseEstimator(model)
    unworn = [info.labels.index(label) for label in info.unworn]
    hidden_row, pose_row = info.tracked.index(hiding.marker), info.labels.index(hiding.marker)
    errors, rms, too_short = [], [], []
    for take in takes:
        measured = measured_markers(take, info, faults, seed)
        layout = Layout(info.tracked, take.rate)
        before, long = round(BEFORE * take.rate), round(hiding.seconds * take.rate)
        starts = range(before, len(measured) - long, max(1, round(EVERY * take.rate)))
        if not starts:
            too_short.append(take.name)
        for start in starts:
            estimator.reset()
            for index in range(start - before, start + long + 1):
                xyz = measured[index]
                if index >= start:
                    xyz = xyz.copy()
                    xyz[hidden_row] = np.nan
                t = index / take.rate
                pose = estimator.step(MarkerFrame(index, t, t, layout, xyz))
            truth = take.xyz[start + long]
            errors.append(1000 * float(np.linalg.norm(pose.xyz[pose_row] - truth[pose_row])))
            rms.append(float(frame_rms(pose.xyz[None, unworn], truth[None, unworn])[0]))
    return Hidden(
        hiding.marker,
        hiding.seconds,
        len(errors),
        mean_known(np.array(errors)),
        mean_known(np.array(rms)),
        tuple(too_short),
    )
