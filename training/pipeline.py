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

from bridge.body_frame import CONSTRUCTIONS, REFERENCES
from bridge.model import Model
from drivers.marker_set import MARKERS
from simulators.corruption import Faults, Gaps
from training.corpus import Corpus
from training.dataset import UNKNOWN, Capture, Warn, read_take, stream
from training.evaluation import Result, Scores, evaluate, mean_scores
from training.export import to_onnx
from training.fitting import Fitted, fit_mixture, forest_rows
from training.folds import Fold, leave_out
from training.forest_error import forest_error
from training.marker_search import residuals, search
from training.marker_selection import select_markers
from training.marker_wishes import Wishes
from training.moments import columns_of, matrix, mean_and_covariance
from training.network_fitting import fit_network
from training.networks import Networks
from training.progress import Advance
from training.recipe import MixtureRecipe, NetworkRecipe
from training.sigma import sigma_factors
from training.workers import single_threaded

AnyRecipe = MixtureRecipe | NetworkRecipe

FIT_WORK = 50_000.0  # units of progress that one fit takes, one being a frame cut into segments
BEGUN = 0.6  # of each real capture, whose end people who are known are scored on
MAX_JUDGED = 100  # captures that a model without folds is judged on
_LIBRARIES = ("markerbridge", "numpy", "onnx", "scikit-learn")

# What folds are scored with: nothing, and a fifth of the samples missing.
FAULTS = (Faults(), Faults(gaps=Gaps(0.2, 10, 100)))

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
CANDIDATES = tuple(label for label in MARKERS if label not in REFERENCES)


def candidate_covariance(corpus: Corpus, candidates: tuple[str, ...] = CANDIDATES) -> Array:
    """Covariance of the markers that may be principal, over all frames of the corpus, m²."""
    whole = matrix(corpus.moments.sum(axis=0))
    return mean_and_covariance(whole, columns_of(candidates))[1]


def choose(corpus: Corpus, folds: Sequence[Fold], recipe: AnyRecipe, seed: int) -> tuple[str, ...]:
    """The principal markers that a recipe wants: by variance for local models, as the paper does;
    by their error in people left out for a network, and for any model without C7.
    """
    references = CONSTRUCTIONS[recipe.body_frame].references
    if isinstance(recipe, MixtureRecipe) and references == REFERENCES:
        return choose_principal(corpus, seed)
    choice = Wishes(alone=references != REFERENCES).choice()
    start = residuals(corpus, folds or leave_out(corpus.captures), references)
    ranked = search(start, choice, seed, lambda *_: None)
    return choice.beside_references(ranked[0].markers)


def choose_principal(
    corpus: Corpus, seed: int, candidates: tuple[str, ...] = CANDIDATES
) -> tuple[str, ...]:
    """The principal markers by the data (paper 3.1.1); the references are worn anyway."""
    return select_markers(candidate_covariance(corpus, candidates), candidates, seed).markers


def train(
    corpus: Corpus,
    folder: Path,
    tests: Sequence[Capture],
    folds: Sequence[Fold],
    principal: tuple[str, ...],
    recipe: AnyRecipe,
    seed: int,
    advance: Advance,
    warn: Warn,
) -> Fitted:
    """The model of the corpus, with what it reaches on folds and, only told, on `tests`.

    folder: where the captures to be scored are. FIT_WORK units of progress for each of the `fits`.
    """
    held: list[Result] = []
    lacking: list[Result] = []
    left_out = {}
    # What a network says of its error while markers are missing is set right as well.
    faults = FAULTS if isinstance(recipe, NetworkRecipe) else FAULTS[:1]
    scored = score_folds(corpus, folder, folds, principal, recipe, seed, faults)
    for fold, results in zip(folds, scored, strict=True):
        reached = "nothing left to train on" if results is None else _reached(results[0])
        if results and results[0]:
            held += results[0]
            lacking += results[-1]
            left_out[fold.name] = _told(mean_scores(results[0]))
        advance(f"without {fold.name}: {reached}", FIT_WORK)
    known: list[list[Result]] = [[], []]
    if folds and isinstance(recipe, NetworkRecipe):
        known = _score_ends(corpus, folder, principal, recipe, seed, warn)
        advance(f"the ends of captures: {_reached(known[0])}", FIT_WORK)
    fitted = fit_model(corpus, np.arange(len(corpus.frames)), principal, recipe, seed)
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
    if not held:
        # Without folds all there is to judge by is what was trained on.
        judged = _some(corpus.captures)
        held, *others = [evaluate(model, stream(folder, judged, warn), one) for one in faults]
        lacking = others[-1] if others else []
    wrong = None
    if fitted.leaves and isinstance(recipe, MixtureRecipe):
        inputs = columns_of(model.info.features)[: model.width]
        wrong = forest_error(forest_rows(corpus, fitted.leaves, inputs), recipe.forest, seed)
    graph = fitted.graph
    if isinstance(graph, Networks):
        again, again_lacking = known
        tracked = [MARKERS.index(label) for label in fitted.info.tracked]
        graph = graph.with_sigma(
            sigma_factors([one.surprise for one in held + again]),
            sigma_factors([one.surprise[tracked] for one in lacking + again_lacking]),
        )
    deviation = np.sqrt(np.nanmean([one.squared_error for one in held], axis=0))
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
        graph=graph,
        info=replace(
            fitted.info,
            sigma=deviation.tolist(),
            accuracy=accuracy,
            training=fitted.info.training | made_with,
        ),
    )


def fits(folds: Sequence[Fold], recipe: AnyRecipe) -> int:
    """How many models are trained: one for each fold, one for people who are known, where a
    network's sigma is to be right for them too, and the model itself.
    """
    return len(folds) + bool(folds and isinstance(recipe, NetworkRecipe)) + 1


def _score_ends(
    corpus: Corpus,
    folder: Path,
    principal: tuple[str, ...],
    recipe: NetworkRecipe,
    seed: int,
    warn: Warn,
) -> list[list[Result]]:
    """For each of FAULTS the scores on the end of every real capture, from a model that has seen
    how each begins: of people who are known, in motions that are not.
    """
    everything = np.arange(len(corpus.frames))
    model = loaded(fit_model(corpus.begun(BEGUN), everything, principal, recipe, seed))
    real = [capture for capture in corpus.captures if capture.real]
    ends = [
        replace(take, xyz=take.xyz[round(BEGUN * len(take.xyz)) :])
        for take in stream(folder, real, warn)
    ]
    return [evaluate(model, ends, one) for one in FAULTS]


def score_folds(
    corpus: Corpus,
    folder: Path,
    folds: Sequence[Fold],
    principal: tuple[str, ...],
    recipe: AnyRecipe,
    seed: int,
    faults: Sequence[Faults] = FAULTS[:1],
) -> Iterator[list[list[Result]] | None]:
    """For each fold in turn, by the workers in force: for each of the faults the scores of the
    performers left out, from a model trained without them; None where nothing is left to train on.
    """
    folder = folder.resolve()  # a worker elsewhere has another current folder
    results: Iterator[list[list[Result]] | None] = Parallel(return_as="generator")(
        delayed(_score_fold)(corpus, folder, fold, principal, recipe, seed, faults)
        for fold in folds
    )
    return results


@single_threaded
def _score_fold(
    corpus: Corpus,
    folder: Path,
    fold: Fold,
    principal: tuple[str, ...],
    recipe: AnyRecipe,
    seed: int,
    faults: Sequence[Faults],
) -> list[list[Result]] | None:
    segments = corpus.without(fold.dropped)
    if not len(segments):
        return None
    model = loaded(fit_model(corpus, segments, principal, recipe, seed))
    used = {capture.name for capture in corpus.captures}
    takes = [read_take(folder, one) for one in fold.scored if one.name in used]
    return [evaluate(model, takes, one) for one in faults]


def fit_model(
    corpus: Corpus, segments: Indices, principal: tuple[str, ...], recipe: AnyRecipe, seed: int
) -> Fitted:
    """The model that these segments of the corpus give, by either kind of recipe."""
    if isinstance(recipe, NetworkRecipe):
        return fit_network(corpus, segments, principal, recipe, seed)
    return fit_mixture(corpus, segments, principal, recipe, seed)


def loaded(fitted: Fitted) -> Model:
    """The model as the runtime has it."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch, "model.onnx")
        path.write_bytes(to_onnx(fitted.graph, fitted.info))
        return Model(path)


def _some(captures: Sequence[Capture]) -> Sequence[Capture]:
    """At most MAX_JUDGED of the captures, evenly."""
    return captures[:: -(-len(captures) // MAX_JUDGED)]


def _reached(results: Sequence[Result]) -> str:
    rms = mean_scores(results).rms_mm if results else None
    return "nothing to score" if rms is None else f"RMS {rms:.1f} mm"


def _told(scores: Scores) -> dict[str, float | None]:
    """The scores as the model file tells them: without the baseline, to 0.01."""
    told = asdict(scores)
    return {
        name: None if told[name] is None else round(told[name], 2)
        for name in ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
    }
