"""From takes to a model that says how good it is: segments, fits, folds (paper 3 and 4)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bridge.body_frame import REFERENCES
from bridge.model import Model
from drivers.errors import MarkerbridgeError
from drivers.marker_set import MARKERS
from training.dataset import Take
from training.evaluation import Result, Scores, evaluate, mean_scores
from training.export import to_onnx
from training.fitting import Fitted, Segment, fit
from training.folds import Fold
from training.marker_selection import select_markers
from training.mirroring import mirrored
from training.poses import body_poses
from training.progress import Advance
from training.recipe import Recipe

FIT_WORK = 50_000.0  # units of progress that one fit takes, one being a frame cut into segments
MIN_FRAMES = 10  # a covariance of fewer says nothing
_LIBRARIES = ("markerbridge", "numpy", "onnx", "scikit-learn")


def cut(
    takes: Sequence[Take], recipe: Recipe, advance: Advance, warn: Callable[[str], None]
) -> list[Segment]:
    """The segments of all takes. One unit of progress per frame."""
    segments = []
    for take in takes:
        poses = body_poses(take.xyz)
        if len(poses) < MIN_FRAMES:
            warn(f"left out: {take.name}: fewer than {MIN_FRAMES} frames have all 41 markers")
        else:
            parts = recipe.segmentation.cut(poses.reshape(len(poses), -1), take.rate)
            segments += [Segment(take, poses[part]) for part in parts]
        advance(f"segments of {take.name}", len(take.xyz))
    if not segments:
        raise MarkerbridgeError("no capture has enough frames with all 41 markers")
    return segments


def choose_principal(segments: Sequence[Segment], seed: int) -> tuple[str, ...]:
    """The principal markers by the data (paper 3.1.1); the references are worn anyway."""
    candidates = [label for label in MARKERS if label not in REFERENCES]
    rows = np.concatenate([segment.rows(candidates) for segment in segments])
    return select_markers(rows.reshape(len(rows), -1, 3), candidates, seed).markers


def train(
    segments: Sequence[Segment],
    tests: Sequence[Take],
    folds: Sequence[Fold],
    principal: tuple[str, ...],
    recipe: Recipe,
    seed: int,
    advance: Advance,
) -> Fitted:
    """The model of all segments, with what it reaches on folds and, only told, on `tests`.

    FIT_WORK units of progress per fold, and as many for the model itself.
    """

    def fitted_on(part: Sequence[Segment]) -> Fitted:
        twins = [Segment(one.take, mirrored(one.poses)) for one in part] if recipe.mirror else []
        return fit([*part, *twins], principal, recipe, seed)

    held: list[Result] = []
    left_out = {}
    for fold in folds:
        rest = [segment for segment in segments if segment.take.name not in fold.dropped]
        if not rest:
            advance(f"without {fold.name}: nothing left to train on", FIT_WORK)
            continue
        results = evaluate(_loaded(fitted_on(rest)), fold.scored)
        held += results
        left_out[fold.name] = _told(mean_scores(results))
        rms = left_out[fold.name]["rms_mm"]
        reached = "nothing to score" if rms is None else f"RMS {rms:.1f} mm"
        advance(f"without {fold.name}: {reached}", FIT_WORK)
    fitted = fitted_on(segments)
    model = _loaded(fitted)
    accuracy: dict[str, Any] = {"folds": None, "test": None}
    if held:
        accuracy["folds"] = {"mean": _told(mean_scores(held)), "left_out": left_out}
    if tests:
        accuracy["test"] = _told(mean_scores(evaluate(model, tests)))
    # Without folds all there is to judge by is what was trained on.
    judged = held or evaluate(model, _takes(segments))
    advance("the model itself", FIT_WORK)
    # As captured: mirror images are not counted.
    made_with = {
        "sequences": len(_takes(segments)),
        "frames": sum(len(segment.poses) for segment in segments),
        "segments": len(segments),
        "seed": seed,
        "recipe": asdict(recipe),
        "versions": {name: version(name) for name in _LIBRARIES},
    }
    return replace(
        fitted,
        info=replace(
            fitted.info,
            sigma=np.sqrt(np.nanmean([result.squared_error for result in judged], axis=0)).tolist(),
            accuracy=accuracy,
            training=fitted.info.training | made_with,
        ),
    )


def _loaded(fitted: Fitted) -> Model:
    """The model as the runtime has it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.onnx")
        path.write_bytes(to_onnx(fitted.graph, fitted.info))
        return Model(path)


def _takes(segments: Sequence[Segment]) -> list[Take]:
    return list({segment.take.name: segment.take for segment in segments}.values())


def _told(scores: Scores) -> dict[str, float | None]:
    """The scores as the model file tells them: without the baseline, to 0.01."""
    told = asdict(scores)
    return {
        name: None if told[name] is None else round(told[name], 2)
        for name in ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
    }
