"""The sets of markers that estimate best, beside the one chosen by variance and any others: in
closed form, and with the estimator that will use them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from training.marker_search import ScoredSet
from training.marker_wishes import Markers, Wishes
from training.set_comparison import SetScores


@dataclass(frozen=True, slots=True)
class SearchStudy:
    """by_size: the best set found of each size up to the one asked for. best: the best ones of that
    size that differ enough, the best first. others: what they are told beside, by name. searched:
    how many sets of that size were scored in closed form. scores: of those of these sets that the
    estimator was tried with on the folds.
    """

    wishes: Wishes
    by_size: Sequence[ScoredSet]
    best: Sequence[ScoredSet]
    others: Mapping[str, ScoredSet]
    searched: int
    scores: Mapping[Markers, SetScores]

    @property
    def sets(self) -> dict[str, ScoredSet]:
        """All that are told of, by name."""
        return {f"best {number}": one for number, one in enumerate(self.best, 1)} | {**self.others}

    @property
    def chosen(self) -> ScoredSet:
        """Of the best the one with which the estimator is best; in closed form where none was
        tried.
        """

        def error(one: ScoredSet) -> tuple[bool, float]:
            tried = self.scores.get(one.markers)
            rms = None if tried is None else tried.mean.rms_all_mm
            return (True, one.error_mm) if rms is None else (False, rms)

        return min(self.best, key=error)

    @property
    def principal(self) -> Markers:
        """The markers chosen, without those that give the body frame."""
        worn = self.wishes.references
        return tuple(label for label in self.chosen.markers if label not in worn)

    def to_json(self) -> dict[str, Any]:
        """The figures as a reader of JSON wants them."""
        return {
            "by": "error",
            "wishes": asdict(self.wishes),
            "references": self.wishes.references,
            "chosen": self.chosen.markers,
            "searched": self.searched,
            "by_size": [asdict(one) for one in self.by_size],
            "sets": [
                {
                    "name": name,
                    **asdict(one),
                    "scores": self.scores[one.markers].to_json()
                    if one.markers in self.scores
                    else None,
                }
                for name, one in self.sets.items()
            ],
        }
