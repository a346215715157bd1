"""Sets of principal markers against each other, on performers left out (paper section 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import MarkerbridgeError
from training.corpus import Corpus
from training.evaluation import Scores, mean_scores
from training.folds import Fold
from training.pipeline import FIT_WORK, AnyRecipe, score_folds
from training.progress import Advance


@dataclass(frozen=True, slots=True)
class SetScores:
    """How well a set of principal markers does. mean: over all captures of the folds; left_out:
    over those of each fold, by its name.
    """

    principal: tuple[str, ...]
    mean: Scores
    left_out: Mapping[str, Scores]

    def to_json(self) -> dict[str, Any]:
        """The scores as a reader of JSON wants them."""
        return {
            "principal": self.principal,
            "mean": _told(self.mean),
            "left_out": {name: _told(scores) for name, scores in self.left_out.items()},
        }


def compare_sets(
    corpus: Corpus,
    folder: Path,
    folds: Sequence[Fold],
    sets: Sequence[tuple[str, ...]],
    recipe: AnyRecipe,
    seed: int,
    advance: Advance,
) -> list[SetScores]:
    """Scores each set on the same folds, by the workers in force.

    folder: where the captures are. FIT_WORK units of progress per set and fold. Raises
    MarkerbridgeError where no fold has anything to train on and to score.
    """
    scored = []
    for number, principal in enumerate(sets, 1):
        held, left_out = [], {}
        results = score_folds(corpus, folder, folds, principal, recipe, seed)
        for fold, found in zip(folds, results, strict=True):
            if found and found[0]:
                held += found[0]
                left_out[fold.name] = mean_scores(found[0])
            advance(f"set {number} of {len(sets)} without {fold.name}", FIT_WORK)
        if not held:
            raise MarkerbridgeError(
                f"{folder}: nothing to compare on: without each performer there is nothing left "
                "to train on"
            )
        scored.append(SetScores(principal, mean_scores(held), left_out))
    return scored


def _told(scores: Scores) -> dict[str, float | None]:
    """Without the baseline, which has no part in this."""
    return {
        "rms_mm": scores.rms_mm,
        "rms_all_mm": scores.rms_all_mm,
        "jerk_mm": scores.jerk_mm,
        "roughness": scores.roughness,
    }
