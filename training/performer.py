"""Fits the embedded performer to walking captures: `python -m training.performer DATA --out FILE`.

In the manner of Troje (2002), "Decomposing biological motion": the mean cycle of many straight
walks, in the body frame, is a mean pose and a few principal components, and each component's score
is a short Fourier series over the cycle. So are the yaw and the origin, measured against a point
that moves on the path at constant speed. Gait cycles that turn, hurry or dawdle are left out.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bridge.body_frame import REFERENCES, BodyFrame
from drivers.c3d_file import read_c3d
from drivers.marker_set import MARKERS
from simulators.performer import fourier_basis

Array = npt.NDArray[np.float64]

PHASES = 120  # samples of a resampled cycle
COMPONENTS = 8
HARMONICS = 5
DURATION = (0.95, 1.25)  # s: what counts as walking at one's ease
STRIDE = (1.1, 1.7)  # m
MAX_TURN = math.radians(6)  # of the shoulders, from the cycle's start to its end
MAX_ASIDE = math.radians(8)  # of the shoulders against the path, mean over the cycle
SOLE = 0.015  # m: height of the lowest foot marker over the floor

_REFERENCE_ROWS = [MARKERS.index(label) for label in REFERENCES]
_LEFT_ANKLE, _RIGHT_ANKLE = MARKERS.index("LANK"), MARKERS.index("RANK")
_FEET = [MARKERS.index(side + name) for side in "LR" for name in ("HEE", "TOE", "MT5")]


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    """One gait cycle, from the left ankle passing the right one to the next time it does.

    xyz: (PHASES, 41, 3) metres, x right, y along the path, z up, seen from a point that moves on
    the path at constant speed and has the origin marker overhead at the start. duration: seconds.
    stride: metres.
    """

    xyz: Array
    duration: float
    stride: float


def body_coordinates(xyz: Array) -> tuple[Array, Array, Array]:
    """(N, 41, 3) metres in the body frame, and that frame's yaw (N,) and origin (N, 3)."""
    frame = BodyFrame(REFERENCES)
    body, yaw, origin = np.empty_like(xyz), np.empty(len(xyz)), np.empty((len(xyz), 3))
    for row, pose in enumerate(xyz):
        frame.update(pose[_REFERENCE_ROWS].astype(np.float32))
        body[row], yaw[row], origin[row] = frame.to_body(pose), frame.yaw, frame.origin
    return body, np.unwrap(yaw), origin


def gait_cycles(xyz: Array, rate: float) -> Iterator[Cycle]:
    """The even, straight gait cycles of a capture (N, 41, 3) in metres."""
    body, yaw, origin = body_coordinates(xyz)
    apart = body[:, _LEFT_ANKLE, 1] - body[:, _RIGHT_ANKLE, 1]
    passing = np.flatnonzero((apart[:-1] < 0) & (apart[1:] >= 0))
    moments = passing - apart[passing] / (apart[passing + 1] - apart[passing])
    for start, end in pairwise(moments):
        times = np.linspace(start, end, PHASES + 1)
        turn = np.interp(times, np.arange(len(yaw)), yaw)
        first, last = _sample(origin, times[[0, -1]])
        across, along = last[:2] - first[:2]
        stride, duration = math.hypot(across, along), (end - start) / rate
        heading = math.atan2(along, across) - math.pi / 2  # 0: the path runs along y
        aside = math.remainder(turn.mean() - heading, math.tau)
        poses = _sample(xyz, times[:-1])
        if (
            DURATION[0] <= duration <= DURATION[1]
            and STRIDE[0] <= stride <= STRIDE[1]
            and abs(turn[-1] - turn[0]) <= MAX_TURN
            and abs(aside) <= MAX_ASIDE
            and np.isfinite(poses).all()
        ):
            cos, sin = math.cos(heading), math.sin(heading)
            turned = (poses - [*first[:2], 0]) @ [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]
            turned[:, :, 1] -= np.linspace(0, stride, PHASES, endpoint=False)[:, None]
            turned[:, :, 2] += SOLE - turned[:, _FEET, 2].min()
            yield Cycle(turned, duration, stride)


def _sample(values: Array, rows: Array) -> Array:
    """`values` (N, ...) at fractional rows, between neighbours linearly."""
    before = np.minimum(rows.astype(int), len(values) - 2)
    share = (rows - before).reshape(-1, *(1,) * (values.ndim - 1))
    between: Array = values[before] * (1 - share) + values[before + 1] * share
    return between


def walking_captures(data: Path) -> dict[str, list[Path]]:
    """The walks of the training split that `manifest.csv` in the folder names, by kind."""
    captures: dict[str, list[Path]] = {}
    with (data / "manifest.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            if row["split"] == "train" and row["motion"].startswith("walk"):
                captures.setdefault(row["kind"], []).append(data / row["file"])
    return captures


def mean_cycle(captures: dict[str, list[Path]]) -> tuple[Cycle, list[Cycle]]:
    """The mean over kinds of the mean over captures of their cycles, and all cycles used.

    Real captures are few, but their feet stand firmer than those of virtual ones: the kinds weigh
    the same.
    """
    means, used = [], []
    for paths in captures.values():
        of_kind = []
        for path in paths:
            clip = read_c3d(path)
            cycles = list(gait_cycles(clip.xyz.astype(float), clip.layout.rate))
            if cycles:
                used += cycles
                of_kind.append(_mean(cycles))
        if of_kind:
            means.append(_mean(of_kind))
    if not means:
        raise ValueError("no capture has an even, straight gait cycle")
    return _mean(means), used


def _mean(cycles: list[Cycle]) -> Cycle:
    return Cycle(
        np.mean([cycle.xyz for cycle in cycles], axis=0),
        float(np.mean([cycle.duration for cycle in cycles])),
        float(np.mean([cycle.stride for cycle in cycles])),
    )


def fit(cycle: Cycle) -> tuple[dict[str, Any], float]:
    """The walker's parameters (simulators/data/walk.json) and the share of variance they explain.

    Lengths are millimetres there, angles degrees; a component's score has a root mean square of 1.
    """
    body, yaw, origin = body_coordinates(cycle.xyz)
    origin[:, :2] -= origin[:, :2].mean(axis=0)  # the path runs below the mean origin
    basis = fourier_basis(np.arange(PHASES) / PHASES, HARMONICS)
    flat = body.reshape(PHASES, -1)
    mean = flat.mean(axis=0)
    left, strength, right = np.linalg.svd(flat - mean, full_matrices=False)
    scores = left[:, :COMPONENTS] * math.sqrt(PHASES)
    components = right[:COMPONENTS] * strength[:COMPONENTS, None] / math.sqrt(PHASES)
    series = _series(basis, scores)[:, 1:]  # their mean is 0
    modelled = mean + (basis[:, 1:] @ series.T) @ components
    explained = 1 - ((flat - modelled) ** 2).sum() / ((flat - mean) ** 2).sum()
    table = np.concatenate([mean[None], components]).reshape(-1, len(MARKERS), 3)
    parameters = {
        "about": "A walk: see training/performer.py. Lengths in mm, angles in degrees, "
        "series as cosine and sine of each harmonic; x right, y ahead, z up.",
        "cycle_s": round(cycle.duration, 4),
        "stride": round(1000 * cycle.stride, 1),
        "yaw": _rounded(_series(basis, np.degrees(yaw)[:, None])[0], 2),
        "origin": _rounded(1000 * _series(basis, origin), 1),
        "scores": _rounded(series, 3),
        "markers": {
            label: _rounded(1000 * table[:, row].ravel(), 1) for row, label in enumerate(MARKERS)
        },
    }
    return parameters, float(explained)


def _rounded(values: Array, digits: int) -> Any:
    return (values.round(digits) + 0.0).tolist()  # and no negative zeros


def _series(basis: Array, values: Array) -> Array:
    """Least-squares Fourier coefficients (K, 1 + 2H) of the columns of `values` (PHASES, K)."""
    coefficients: Array = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0].T, float)
    return coefficients


def to_text(parameters: dict[str, Any]) -> str:
    """JSON with one line per entry and per marker."""
    lines = [f" {json.dumps(key)}: {_compact(parameters[key])}" for key in parameters]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _compact(value: Any) -> str:
    if isinstance(value, dict):
        rows = [f'  "{key}": {_compact(entry)}' for key, entry in value.items()]
        return "{\n" + ",\n".join(rows) + "\n }"
    return json.dumps(value, separators=(",", ":")).replace(".0,", ",").replace(".0]", "]")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m training.performer", description=__doc__)
    parser.add_argument("data", type=Path, metavar="DATA", help="captures with a manifest.csv")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    options = parser.parse_args()
    cycle, used = mean_cycle(walking_captures(options.data))
    parameters, explained = fit(cycle)
    options.out.write_text(to_text(parameters))
    print(f"{len(used)} gait cycles, {100 * explained:.2f} % of the mean cycle's variance")


if __name__ == "__main__":
    main()
