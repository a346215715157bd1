"""The whole estimator, frame by frame on real captures: against scikit-learn's forest alone, and
the paper's 600 frames a second.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
import onnxruntime
from sklearn.ensemble import RandomForestClassifier
from threadpoolctl import threadpool_limits

from bridge.estimator import PoseEstimator
from bridge.model import DEFAULT, Model
from drivers.c3d_file import Clip
from drivers.frame import Floats, MarkerFrame
from simulators.corruption import Corruption, Faults, Gaps
from tests.benchmarks.plan import Plan
from tests.benchmarks.table import Goal, Row
from training.corpus import read_corpus
from training.dataset import training_captures
from training.fitting import cluster, forest_rows
from training.forest import grow_forest
from training.moments import columns_of
from training.recipe import RECIPES, MixtureRecipe
from training.workers import workers

PAPER = 600.0  # frames a second
P50, P99 = Goal(50.0, 120.0), Goal(120.0, 300.0)  # µs
AS_SCIKIT = Goal(80.0, 40.0, of_ratio=True, higher=True)
SAME = 1e-5  # by which leaf weights may differ

CONDITIONS = {
    "clean": Faults(),
    "one marker away": Faults(),
    "20 % gaps": Faults(gaps=Gaps(0.2, 10, 100)),
    "2 mm noise": Faults(noise=0.002),
}

Microseconds = npt.NDArray[np.float64]
Leaves = npt.NDArray[np.int64]


def rows(plan: Plan) -> Iterator[Row]:
    local = Model(plan.local_model())
    for name, model in (("default", Model(DEFAULT)), ("local", local)):
        clips = plan.clips(model.info.tracked)
        for condition in CONDITIONS:
            took = steps(model, shown(clips, condition), plan.either(10, 2))
            what = f"estimator, {name}, {condition}"
            wanted = condition == "clean"
            yield Row(f"{what}, p50", np.median(took), "µs", goal=P50 if wanted else None)
            yield Row(f"{what}, p99", np.percentile(took, 99), "µs", goal=P99 if wanted else None)
            if wanted:
                rate = 1e6 / took.mean()
                yield Row(f"{what}, frames", rate, "/s", rate / PAPER, "the paper's 600")
                whole = float(np.median(took))
    x, leaf = forest_examples(plan, local)
    took = predictions(scikit_forest(local, x, leaf), x[:: len(x) // plan.either(500, 100)])
    alone = float(np.median(took))
    yield Row("scikit-learn, predict_proba of one row, p50", alone, "µs")
    yield Row(
        "estimator, local, clean, p50",
        whole,
        "µs",
        alone / whole,
        "faster than predict_proba",
        AS_SCIKIT,
        "the same forest, the same leaf weights",
    )


def shown(clips: Sequence[Clip], condition: str) -> list[Clip]:
    """The clips as a tracker in this condition would see them."""
    found = []
    for number, clip in enumerate(clips):
        corrupt = Corruption(CONDITIONS[condition], clip.xyz.shape[1], number).apply
        xyz = np.array([corrupt(frame) for frame in clip.xyz])
        if condition == "one marker away":
            xyz[:, 0] = np.nan
        found.append(Clip(clip.path, clip.layout, xyz))
    return found


def steps(model: Model, clips: Sequence[Clip], repeats: int) -> Microseconds:
    """How long each step takes, warm: after the clips have been played once."""
    estimator = PoseEstimator(model)
    took = []
    for turn in range(1 + repeats):
        for clip in clips:
            estimator.reset()
            for frame in frames(clip):
                began = time.perf_counter_ns()
                estimator.step(frame)
                if turn:
                    took.append(time.perf_counter_ns() - began)
    return np.array(took) / 1000


def frames(clip: Clip) -> list[MarkerFrame]:
    """The frames of a clip, on time."""
    times = np.arange(len(clip.xyz)) / clip.layout.rate
    return [
        MarkerFrame(index, t, t, clip.layout, xyz, t)
        for index, (t, xyz) in enumerate(zip(times.tolist(), clip.xyz, strict=True))
    ]


def forest_examples(plan: Plan, model: Model) -> tuple[Floats, Leaves]:
    """What the forest of a local model is grown on: coordinates (N, D), and leaves (N,)."""
    recipe, info = RECIPES["local"], model.info
    assert isinstance(recipe, MixtureRecipe)
    with threadpool_limits(1), workers(None):
        captures = training_captures(plan.data)
        corpus = read_corpus(plan.data, captures, recipe, lambda *_: None, lambda _: None)
        segments = np.arange(len(corpus.frames))
        leaves = cluster(corpus, segments, recipe, info.training["seed"])
    found = forest_rows(corpus, leaves, columns_of(info.features)[: model.width])
    return found.x, found.leaf


def scikit_forest(model: Model, x: Floats, leaf: Leaves) -> RandomForestClassifier:
    """The forest of a local model as scikit-learn has it, grown as training grows it.

    Raises ValueError where its class weights are not those that the model file gives.
    """
    recipe, seed = RECIPES["local"], model.info.training["seed"]
    assert isinstance(recipe, MixtureRecipe)
    with workers(None):
        whole, *others = grow_forest(x, leaf, recipe.forest, seed)
    for part in others:
        whole.estimators_ += part.estimators_
    whole.set_params(n_estimators=len(whole.estimators_), n_jobs=1)
    some = x[:: len(x) // 200]
    run = partial(onnxruntime.InferenceSession(str(model.path)).run, ["p"])
    nothing = np.zeros((0, model.leaves), np.float32)
    weights = np.concatenate([run({"x": row[None], "history": nothing})[0] for row in some])
    if not np.allclose(weights, whole.predict_proba(some), atol=SAME):
        raise ValueError(f"{model.path}: not the forest that these captures give; train it anew")
    return whole


def predictions(forest: RandomForestClassifier, x: Floats) -> Microseconds:
    """How long predict_proba of one row takes, warm."""
    took = []
    for row in x:
        began = time.perf_counter_ns()
        forest.predict_proba(row[None])
        took.append(time.perf_counter_ns() - began)
    return np.array(took[len(took) // 10 :]) / 1000
