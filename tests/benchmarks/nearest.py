"""The paper's rival: the nearest of all training poses, by the coordinates of the tracked markers.

The data have fewer poses than are searched here: they are repeated, each time 5 mm (standard
deviation per coordinate) beside where they were, so that none is a copy. Searched with frames of a
walk and a run that are not among them. It is the search alone: a frame that lacks markers, and the
body frame, are work besides, which the estimator's time contains.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from bridge.model import DEFAULT, Model
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from tests.benchmarks.machine import alone, memory
from tests.benchmarks.plan import Plan
from tests.benchmarks.speed import Microseconds, steps
from tests.benchmarks.table import Row
from training.dataset import stream, training_captures
from training.poses import body_poses

SIZES = (100_000, 400_000, 1_600_000)
JITTER = 0.005  # m

Search = Callable[[Floats], int]


def rows(plan: Plan) -> Iterator[Row]:
    model = Model(DEFAULT)
    chosen = [MARKERS.index(label) for label in model.info.features]
    captures = training_captures(plan.data)
    takes = stream(plan.data, captures[: plan.either(len(captures), 10)], lambda _: None)
    known = np.concatenate([body_poses(take.xyz)[:, chosen] for take in takes])
    asked = np.concatenate([body_poses(clip.xyz)[:, chosen] for clip in plan.clips(MARKERS)])
    known, asked = known.reshape(len(known), -1), asked.reshape(len(asked), -1)
    whole = float(np.median(steps(model, plan.clips(model.info.tracked), 1)))
    for size in SIZES[: plan.either(3, 1)]:
        for name in SEARCHES:
            took, taken = alone(search, name, known, size, asked[:: plan.either(2, 10)])
            note = f"{taken:.0f} MB"
            what = f"{name}, {size / 1e6:.1f} million poses"
            middle = float(np.median(took))
            against = "the whole estimator"
            yield Row(f"{what}, p50", middle, "µs", middle / whole, against, note=note)
            yield Row(f"{what}, p99", np.percentile(took, 99), "µs")


def search(name: str, known: Floats, size: int, asked: Floats) -> tuple[Microseconds, float]:
    """How long each search of so many poses takes, and the memory of poses and search, MB."""
    random = np.random.default_rng(0)
    before = memory()
    poses = np.resize(random.permutation(known), (size, known.shape[1]))
    for start in range(len(known), size, len(known)):
        part = poses[start : start + len(known)]
        part += random.normal(0.0, JITTER, part.shape).astype(np.float32)
    find = SEARCHES[name](poses)
    del poses
    taken = memory() - before
    took = []
    with threadpool_limits(1):  # one core, as the estimator has
        for row in asked:
            began = time.perf_counter_ns()
            find(row)
            took.append(time.perf_counter_ns() - began)
    return np.array(took) / 1000, taken


def _brute_force(poses: Floats) -> Search:
    """One pass: of |p - q|² the part that differs between poses, a product and an addition."""
    squares = (poses**2).sum(axis=1) / 2
    return lambda row: int((squares - poses @ row).argmin())


def _kd_tree(poses: Floats) -> Search:
    tree = cKDTree(poses)
    return lambda row: int(tree.query(row)[1])


SEARCHES: dict[str, Callable[[Floats], Search]] = {
    "nearest pose, brute force": _brute_force,
    "nearest pose, KD-tree": _kd_tree,
}
