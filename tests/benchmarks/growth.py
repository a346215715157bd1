"""How the time of a step grows with the model and the number of performers, and memory with time.

The models are mixtures made for it: forests grown on real poses, whose leaves are those nearest to
as many of them, and maps that are all but the same.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bridge.body_frame import PAPER_FRAME, REFERENCES
from bridge.estimator import PoseEstimator
from bridge.model import DEFAULT, Model, ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from tests.benchmarks.hour import play
from tests.benchmarks.machine import alone
from tests.benchmarks.plan import Plan
from tests.benchmarks.speed import frames, steps
from tests.benchmarks.table import Row
from training.dataset import stream, training_captures
from training.export import Mixture, to_onnx
from training.forest import ForestOptions, grow_forest, sparse_forest
from training.local_models import NormalEquations, affine, ridge
from training.poses import body_poses
from training.workers import workers

CAPTURES = 6  # real ones, that the models are made of
POSES = 20_000
NOISE = 0.01  # m, see `training.local_models.ridge`
RATE = 120.0


@dataclass(frozen=True, slots=True)
class Size:
    """Of a mixture: principal markers (three references beside them), leaves, trees, and frames of
    history.
    """

    principal: int = 6
    leaves: int = 80
    trees: int = 50
    history: int = 10


GROWN: dict[str, tuple[int, ...]] = {
    "principal": (3, 12, 24),
    "leaves": (20, 320),
    "trees": (10, 200),
    "history": (0, 120, 240),
}
PERFORMERS = (1, 4, 16, 32)


def rows(plan: Plan) -> Iterator[Row]:
    captures = [one for one in training_captures(plan.data) if one.real][:CAPTURES]
    takes = stream(plan.data, captures, lambda _: None)
    poses = np.concatenate([body_poses(take.xyz) for take in takes])
    poses = poses[:: max(1, len(poses) // plan.either(POSES, 4000))]
    base = _step(plan, poses, Size())
    yield Row(f"step, {Size()}", base, "µs")
    for name, values in GROWN.items():
        for value in values[-1:] if plan.quick else values:
            took = _step(plan, poses, replace(Size(), **{name: value}))
            usual = getattr(Size(), name)
            yield Row(f"step, {name} {value}", took, "µs", took / base, f"that of {usual}")
    first = None
    for count in PERFORMERS:
        took = _performers(plan, count)
        first = first or took
        share = took * 1e-6 * count * RATE
        yield Row(
            f"step of each of {count} performers, default model, in turn",
            took,
            "µs",
            took / first,
            "that of one",
            note=f"{100 * share:.0f} % of a core at 120 Hz",
        )
    minutes = plan.either(4.0, 0.75)
    outcome = alone(play, minutes)
    if outcome.wrong:
        raise RuntimeError(f"tests.benchmarks.hour: {outcome.wrong[0]}")
    yield Row(
        f"memory grown from second 30 to minute {minutes:g} of a bad line", outcome.grown, "MB"
    )


def _step(plan: Plan, poses: Floats, size: Size) -> float:
    """The median of a step, µs, of a model of this size."""
    with tempfile.TemporaryDirectory() as folder:
        model = made(Path(folder, "model.onnx"), poses, size)
        return float(np.median(steps(model, plan.clips(model.info.tracked), 1)))


def _performers(plan: Plan, count: int) -> float:
    """The median of a step, µs, of each of several performers, who are estimated in turn."""
    model = Model(DEFAULT)
    estimators = [PoseEstimator(model) for _ in range(count)]
    took = []
    for frame in frames(plan.clips(model.info.tracked)[0]):
        began = time.perf_counter_ns()
        for estimator in estimators:
            estimator.step(frame)
        took.append((time.perf_counter_ns() - began) / count)
    return float(np.median(took[len(took) // 10 :])) / 1000


def made(path: Path, poses: Floats, size: Size) -> Model:
    """Writes a mixture of this size from poses (N, 41, 3)."""
    random = np.random.default_rng(0)
    free = [label for label in MARKERS if label not in REFERENCES]
    principal = tuple(free[i] for i in np.linspace(0, len(free) - 1, size.principal).astype(int))
    info = ModelInfo(
        estimator="local",
        labels=MARKERS,
        principal=principal,
        references=REFERENCES,
        history=size.history,
        mean=[],
        covariance=[],
        sigma=[],
        sensitivity=[],
        body_frame=PAPER_FRAME.name,
    )
    x, z = (
        poses[:, [MARKERS.index(label) for label in labels]].reshape(len(poses), -1)
        for labels in (info.features, info.unworn)
    )
    whole = ridge(NormalEquations.of(affine(x), z), NOISE)
    centres = x[random.choice(len(x), size.leaves, replace=False)]
    distances = (centres**2).sum(axis=1) / 2 - x @ centres.T
    with threadpool_limits(1), workers(None):
        parts = grow_forest(x, distances.argmin(axis=1), ForestOptions(size.trees, leaf=10), 0)
        forest = sparse_forest(parts, hard=False)
    maps = whole + random.normal(0.0, 1e-3, (size.leaves, *whole.shape))
    graph = Mixture(
        forest, False, maps[..., :-1].astype(np.float32), maps[..., -1].astype(np.float32)
    )
    info = replace(
        info,
        mean=x.mean(axis=0).reshape(-1, 3).tolist(),
        covariance=np.cov(x.T).tolist(),
        sigma=[0.02] * len(info.unworn),
        sensitivity=whole[:, :-1].tolist(),
    )
    path.write_bytes(to_onnx(graph, info))
    return Model(path)
