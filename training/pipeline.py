"""From takes to a model file: segments, leaves, maps, forest, folds (paper sections 3 and 4)."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bridge.body_frame import REFERENCES
from bridge.model import Model, ModelInfo
from drivers.errors import MarkerbridgeError
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training import local_models
from training.clustering import divide, segment_features
from training.dataset import UNKNOWN, Take
from training.evaluation import Result, Scores, evaluate, mean_scores
from training.export import Graph, to_onnx
from training.forest import ForestOptions, sparse_forest, train_forest
from training.local_models import Moments
from training.marker_selection import select_markers
from training.poses import body_poses
from training.progress import Advance
from training.segmentation import Segmentation

MAX_FOLDS = 8
Folds = dict[str, tuple[set[str], list[Take]]]
FIT_WORK = 50_000.0  # what one fit costs, in the frames that could be prepared meanwhile


@dataclass(frozen=True, slots=True)
class Recipe:
    """Everything that may be chosen in training but the data, the markers and the seed.

    covariance_weight: w of the segment features. tolerance: of the clustering, see `divide`.
    forest_step: seconds between the frames that the forest is trained on, neighbours being all but
    equal. share, noise (m): how local maps are held back, see `local_models.shrunk`.
    """

    estimator: str
    forest: ForestOptions
    segmentation: Segmentation = field(default_factory=Segmentation)
    covariance_weight: float = 0.5
    tolerance: float = 0.6
    forest_step: float = 1 / 30
    share: float = 0.01
    noise: float = 0.01
    history: int = 10

    @property
    def plain(self) -> bool:
        """The method as the paper has it: no constant, no shrinkage, votes, principal markers."""
        return self.estimator == "paper"


RECIPES = {
    "local": Recipe("local", ForestOptions(trees=50, leaf=10)),
    "paper": Recipe("paper", ForestOptions(trees=50, leaf=1)),
}


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A take, its whole poses in the body frame (N, 41, 3), and where its behaviour changes."""

    take: Take
    poses: Floats
    segments: list[slice]


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """What one fit gives: the graph, and the figures that the model file holds beside it."""

    graph: Graph
    info: ModelInfo


def prepare(takes: Sequence[Take], recipe: Recipe, advance: Advance) -> list[Prepared]:
    """Poses and segments of each take. One unit of progress per frame."""
    prepared = []
    for take in takes:
        poses = body_poses(take.xyz)
        if len(poses) > 1:
            segments = recipe.segmentation.cut(poses.reshape(len(poses), -1), take.rate)
            prepared.append(Prepared(take, poses, segments))
        advance(f"segments of {take.name}", len(take.xyz))
    if not prepared:
        raise MarkerbridgeError("no capture has whole poses: every frame lacks a marker")
    return prepared


def choose_principal(prepared: Sequence[Prepared], seed: int) -> tuple[str, ...]:
    """The principal markers by the data (paper 3.1.1); the references are worn anyway."""
    candidates = [label for label in MARKERS if label not in REFERENCES]
    columns = [MARKERS.index(label) for label in candidates]
    poses = np.concatenate([entry.poses[:, columns] for entry in prepared])
    return select_markers(poses, candidates, seed).markers


def fit(
    prepared: Sequence[Prepared], principal: tuple[str, ...], recipe: Recipe, seed: int
) -> Fitted:
    """One model, its info still without accuracy and record."""
    blank = ModelInfo(
        estimator=recipe.estimator,
        labels=MARKERS,
        principal=principal,
        references=REFERENCES,
        history=recipe.history,
        mean=[],
        covariance=[],
        sigma=[],
        sensitivity=[],
    )
    features = [MARKERS.index(label) for label in blank.features]
    unworn = [MARKERS.index(label) for label in blank.unworn]
    segments = [
        (entry.poses[part], max(1, round(recipe.forest_step * entry.take.rate)))
        for entry in prepared
        for part in entry.segments
    ]
    leaf = divide(
        segment_features(
            [poses.reshape(len(poses), -1) for poses, _ in segments], recipe.covariance_weight
        ),
        recipe.tolerance,
        seed,
    )
    x = [poses[:, features].reshape(len(poses), -1) for poses, _ in segments]
    z = [poses[:, unworn].reshape(len(poses), -1) for poses, _ in segments]

    everything = _pooled([Moments.of(local_models.affine(a), b) for a, b in zip(x, z, strict=True)])
    overall = local_models.ridge(everything, recipe.noise)
    width = 3 * len(principal) if recipe.plain else 3 * len(features)
    maps = []
    for number in range(leaf.max() + 1):
        members = np.flatnonzero(leaf == number)
        if recipe.plain:
            own = _pooled([Moments.of(x[i][:, :width], z[i]) for i in members])
            maps.append(np.pad(local_models.least_squares(own), ((0, 0), (0, 1))))
        else:
            own = _pooled([Moments.of(local_models.affine(x[i]), z[i]) for i in members])
            maps.append(local_models.shrunk(own, everything, recipe.share, recipe.noise))
    rows = [a[::step, :width] for a, (_, step) in zip(x, segments, strict=True)]
    forest = train_forest(
        np.concatenate(rows),
        np.concatenate([np.full(len(a), k) for a, k in zip(rows, leaf, strict=True)]),
        recipe.forest,
        seed,
    )
    frames = np.concatenate(x).astype(float)
    stacked = np.array(maps, np.float32)
    return Fitted(
        Graph(
            sparse_forest(forest, hard=recipe.plain),
            recipe.plain,
            stacked[:, :, :-1],
            stacked[:, :, -1],
        ),
        replace(
            blank,
            mean=frames.mean(axis=0).reshape(-1, 3).tolist(),
            covariance=np.cov(frames, rowvar=False).tolist(),
            sigma=[0.0] * len(unworn),
            sensitivity=overall[:, :-1].tolist(),
            training={
                "sequences": len(prepared),
                "frames": sum(len(entry.poses) for entry in prepared),
                "segments": len(segments),
                "leaves": len(maps),
                "forest_nodes": sum(tree.tree_.node_count for tree in forest.estimators_),
            },
        ),
    )


def folds(takes: Sequence[Take]) -> Folds:
    """What to leave out in turn: by name, the takes dropped and the real ones to score.

    A fold leaves performers out, with all that is known to be theirs; only where fewer than two
    are known does it leave files out. No more than MAX_FOLDS.
    """
    real = [take for take in takes if take.real]
    performers = sorted({take.subject for take in real} - {UNKNOWN})
    groups: Folds = {}
    if len(performers) > 1:
        for part in range(min(MAX_FOLDS, len(performers))):
            held = performers[part::MAX_FOLDS]
            dropped = {take.name for take in takes if take.subject in held}
            groups[", ".join(held)] = dropped, [take for take in real if take.subject in held]
    elif len(real) > 1:
        for part in range(min(MAX_FOLDS, len(real))):
            left = real[part::MAX_FOLDS]
            groups[", ".join(take.name for take in left)] = {take.name for take in left}, left
    return groups


def train(
    prepared: Sequence[Prepared],
    tests: Sequence[Take],
    principal: tuple[str, ...],
    recipe: Recipe,
    seed: int,
    groups: Folds,
    advance: Advance,
) -> Fitted:
    """The model of all takes, with what it reaches on folds and, only told, on `tests`.

    FIT_WORK units of progress per fold, and as many for the model itself.
    """
    held: list[Result] = []
    parts = {}
    for name, (dropped, scored) in groups.items():
        rest = [entry for entry in prepared if entry.take.name not in dropped]
        results = evaluate(_loaded(fit(rest, principal, recipe, seed)), scored)
        parts[name] = _told(mean_scores(results))
        held += results
        advance(f"without {name}: RMS {parts[name]['rms_mm']:.1f} mm", FIT_WORK)
    fitted = fit(prepared, principal, recipe, seed)
    model = _loaded(fitted)
    accuracy: dict[str, Any] = {"folds": None, "test": None}
    if held:
        accuracy["folds"] = {"mean": _told(mean_scores(held)), "left_out": parts}
    if tests:
        accuracy["test"] = _told(mean_scores(evaluate(model, tests)))
    # Without folds all there is to judge by is what was trained on.
    judged = held or evaluate(model, [entry.take for entry in prepared])
    advance("the model itself", FIT_WORK)
    info = replace(
        fitted.info,
        sigma=np.sqrt(np.nanmean([result.squared_error for result in judged], axis=0)).tolist(),
        accuracy=accuracy,
        training=fitted.info.training
        | {
            "seed": seed,
            "recipe": asdict(recipe),
            "versions": {
                name: version(name) for name in ("markerbridge", "numpy", "onnx", "scikit-learn")
            },
        },
    )
    return Fitted(fitted.graph, info)


def _loaded(fitted: Fitted) -> Model:
    """The model as the runtime has it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.onnx")
        path.write_bytes(to_onnx(fitted.graph, fitted.info))
        return Model(path)


def _pooled(parts: Sequence[Moments]) -> Moments:
    total = parts[0]
    for part in parts[1:]:
        total += part
    return total


def _told(scores: Scores) -> dict[str, float | None]:
    names = ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
    return {name: value for name, value in asdict(scores).items() if name in names}
