"""From a corpus to a model that says how good it is: fits, folds (paper 3 and 4)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from bridge.body_frame import REFERENCES
from bridge.model import Model
from drivers.marker_set import MARKERS
from training.corpus import Corpus
from training.dataset import UNKNOWN, Capture, Warn, read_take, stream
from training.evaluation import Result, Scores, evaluate, mean_scores
from training.export import to_onnx
from training.fitting import Fitted, fit, forest_rows
from training.folds import Fold
from training.forest_error import forest_error
from training.marker_selection import select_markers
from training.moments import columns_of, matrix, mean_and_covariance
from training.progress import Advance
from training.recipe import Recipe
from training.workers import single_threaded

FIT_WORK = 50_000.0  # units of progress that one fit takes, one being a frame cut into segments
MAX_JUDGED = 100  # captures that a model without folds is judged on
_LIBRARIES = ("markerbridge", "numpy", "onnx", "scikit-learn")

Array = npt.NDArray[np.float64]
CANDIDATES = tuple(label for label in MARKERS if label not in REFERENCES)


def candidate_covariance(corpus: Corpus) -> Array:
    """Covariance of the markers that may be principal, over all frames of the corpus, m²."""
    whole = matrix(corpus.moments.sum(axis=0))
    return mean_and_covariance(whole, columns_of(CANDIDATES))[1]


def choose_principal(corpus: Corpus, seed: int) -> tuple[str, ...]:
    """The principal markers by the data (paper 3.1.1); the references are worn anyway."""
    return select_markers(candidate_covariance(corpus), CANDIDATES, seed).markers


def train(
    corpus: Corpus,
    folder: Path,
    tests: Sequence[Capture],
    folds: Sequence[Fold],
    principal: tuple[str, ...],
    recipe: Recipe,
    seed: int,
    advance: Advance,
    warn: Warn,
) -> Fitted:
    """The model of the corpus, with what it reaches on folds and, only told, on `tests`.

    folder: where the captures to be scored are. FIT_WORK units of progress per fold, and as many
    for the model itself.
    """
    held: list[Result] = []
    left_out = {}
    scored = score_folds(corpus, folder, folds, principal, recipe, seed)
    for fold, results in zip(folds, scored, strict=True):
        reached = "nothing left to train on" if results is None else "nothing to score"
        if results:
            held += results
            left_out[fold.name] = _told(mean_scores(results))
            rms = left_out[fold.name]["rms_mm"]
            reached = reached if rms is None else f"RMS {rms:.1f} mm"
        advance(f"without {fold.name}: {reached}", FIT_WORK)
    fitted = fit(corpus, np.arange(len(corpus.frames)), principal, recipe, seed)
    model = loaded(fitted)
    accuracy: dict[str, Any] = {"folds": None, "test": None}
    if held:
        accuracy["folds"] = {
            "mean": _told(mean_scores(held)),
            "people": all(fold.people for fold in folds),
            "left_out": left_out,
        }
    if tests:
        told = evaluate(model, stream(folder, tests, warn))
        accuracy["test"] = _told(mean_scores(told)) if told else None
    # Without folds all there is to judge by is what was trained on.
    judged = held or evaluate(model, stream(folder, _some(corpus.captures), warn))
    inputs = columns_of(model.info.features)[: model.width]
    wrong = forest_error(forest_rows(corpus, fitted.leaves, inputs), recipe.forest, seed)
    advance("the model itself", FIT_WORK)
    # As captured: mirror images are not counted.
    made_with = {
        "sequences": len(corpus.captures),
        "frames": int(corpus.frames.sum()),
        "segments": len(corpus.frames),
        "performers": sorted({capture.subject for capture in corpus.captures} - {UNKNOWN}),
        "forest_error": None if wrong is None else asdict(wrong),
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


def score_folds(
    corpus: Corpus,
    folder: Path,
    folds: Sequence[Fold],
    principal: tuple[str, ...],
    recipe: Recipe,
    seed: int,
) -> Iterator[list[Result] | None]:
    """For each fold in turn, by the workers in force: the scores of the performers left out, from a
    model trained without them; None where nothing is left to train on.
    """
    folder = folder.resolve()  # a worker elsewhere has another current folder
    results: Iterator[list[Result] | None] = Parallel(return_as="generator")(
        delayed(_score_fold)(corpus, folder, fold, principal, recipe, seed) for fold in folds
    )
    return results


@single_threaded
def _score_fold(
    corpus: Corpus,
    folder: Path,
    fold: Fold,
    principal: tuple[str, ...],
    recipe: Recipe,
    seed: int,
) -> list[Result] | None:
    segments = corpus.without(fold.dropped)
    if not len(segments):
        return None
    model = loaded(fit(corpus, segments, principal, recipe, seed))
    used = {capture.name for capture in corpus.captures}
    return evaluate(model, (read_take(folder, one) for one in fold.scored if one.name in used))


def loaded(fitted: Fitted) -> Model:
    """The model as the runtime has it."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch, "model.onnx")
        path.write_bytes(to_onnx(fitted.graph, fitted.info))
        return Model(path)


def _some(captures: Sequence[Capture]) -> Sequence[Capture]:
    """At most MAX_JUDGED of the captures, evenly."""
    return captures[:: -(-len(captures) // MAX_JUDGED)]


def _told(scores: Scores) -> dict[str, float | None]:
    """The scores as the model file tells them: without the baseline, to 0.01."""
    told = asdict(scores)
    return {
        name: None if told[name] is None else round(told[name], 2)
        for name in ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
    }
