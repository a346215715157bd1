"""Searches the markers to wear: those that leave least to be guessed, in people never seen.

Both the affine ridge map from what is worn to all else and its error on captures left out follow
from second moments. So a set of markers is scored without its frames, and thousands of sets are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from drivers.errors import MarkerbridgeError
from drivers.marker_set import MARKERS
from training.corpus import Corpus
from training.folds import Fold
from training.marker_wishes import SHOULDERS, Choice, Markers, Units, can_fill
from training.moments import ONE, columns_of, matrix, mirrored_moments
from training.progress import Advance

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]

NOISE = 0.01  # m, that holds the map back, as it does the local models
STARTS = 8  # of the search; all but the first at random
START_WORK = 8_000.0  # units of progress that one takes, as `pipeline.FIT_WORK`
MAX_SCORED = 100  # captures that sets are scored on
DIFFERENT = 2  # markers of a set that a better one, told of before it, has not
_EXCHANGED = (1, 2)  # units at once
_GAIN = 1e-6  # mm: less is rounding


@dataclass(frozen=True, slots=True)
class ScoredSet:
    """markers: those chosen, in the order of MARKERS. error_mm: over all 41, the worn ones being
    exact: the root of the mean squared distance in a capture left out, mean over the captures.
    """

    markers: Markers
    error_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What the worn markers leave unexplained of the others, in F folds and C captures left out.

    trained: (F, 123, 123) m², covariance of what a fold trains on, with the noise that the inputs
    are taken to have. fold: (C,) of each capture. left_out: (C, 123, 123) m², mean products of its
    residuals. The coordinates of what is worn are zero in both.
    """

    trained: Array
    fold: Columns
    left_out: Array

    def wearing(self, markers: Markers) -> Residuals:
        """The same with these worn as well; none of them may be worn already."""
        x = columns_of(markers)
        maps = self._maps(x)
        trained = self.trained - self.trained[:, x].swapaxes(1, 2) @ maps
        maps = maps[self.fold]
        # The products of z - Bx are those of z and two halves, each the other's transpose.
        half = self.left_out[:, x[:, None], x] @ maps / 2 - self.left_out[:, x]
        half = maps.swapaxes(1, 2) @ half
        return Residuals(trained, self.fold, self.left_out + half + half.swapaxes(1, 2))

    def error_mm(self) -> float:
        """See ScoredSet."""
        return float(_error(self._squares.sum(axis=1)))

    def errors_mm(self, units: Units) -> Array:
        """(U,): the error when each of these units, all of one size, is worn as well."""
        x = np.array([columns_of(unit) for unit in units])  # (U, P)
        maps = self._maps(x)[self.fold]  # (C, U, P, 123)
        products = self.left_out[:, x[:, :, None], x[:, None, :]]
        change = maps * (products @ maps - 2 * self.left_out[:, x])
        return _error(self._squares.sum(axis=1)[:, None] + change.sum(axis=(2, 3)))

    @property
    def _squares(self) -> Array:
        """(C, 123): mean squared residuals."""
        squares: Array = np.einsum("cii->ci", self.left_out)
        return squares

    def _maps(self, x: Columns) -> Array:
        """B^T (F, ..., P, 123): residuals in columns x (..., P) to all, to these exactly."""
        block = self.trained[:, x[..., :, None], x[..., None, :]]
        maps = np.asarray(np.linalg.solve(block, self.trained[:, x]), float)
        np.put_along_axis(maps, x[None, ..., None, :], np.eye(x.shape[-1]), axis=-1)
        return maps


def _error(squares: Array) -> Array:
    """mm, from the mean squared distances (C, ...) of all markers together."""
    mean: Array = 1000 * np.sqrt(squares / len(MARKERS)).mean(axis=0)
    return mean


def residuals(corpus: Corpus, folds: Sequence[Fold], references: Markers) -> Residuals:
    """What the references alone leave unexplained of the captures that each fold scores, to a map
    learned from all that the fold does not drop and from its mirror images.

    references: those of the corpus, or SHOULDERS, which have the origin midway between them. Of
    many captures MAX_SCORED count, evenly. Raises MarkerbridgeError where no fold has anything to
    train on and to score.
    """
    row = {capture.name: number for number, capture in enumerate(corpus.captures)}
    pairs = [
        (number, row[capture.name])
        for number, fold in enumerate(folds)
        if len(corpus.without(fold.dropped))
        for capture in fold.scored
        if capture.name in row
    ]
    if not pairs:
        raise MarkerbridgeError(
            "nothing to score sets of markers on: without each performer there is nothing left to "
            "train on"
        )
    pairs = pairs[:: -(-len(pairs) // MAX_SCORED)]
    used = sorted({fold for fold, _ in pairs})
    frame = _shoulder_frame() if references == SHOULDERS else np.eye(ONE + 1)
    centred, trained = {}, []
    for number in used:
        segments = np.zeros(len(corpus.moments))
        segments[corpus.without(folds[number].dropped)] = 1.0
        moments = segments @ corpus.moments  # a product, as most of the corpus would be copied else
        whole = _mean_products(moments + mirrored_moments(moments))
        # From the poses as the corpus has them to their distances from the mean in the frame.
        centred[number] = frame[:ONE] - np.outer(frame[:ONE] @ whole[:, ONE], np.eye(ONE + 1)[ONE])
        covariance = centred[number] @ whole @ centred[number].T
        trained.append(covariance + NOISE**2 * np.eye(ONE))
    left_out = [
        centred[number]
        @ _mean_products(corpus.moments[corpus.capture == capture].sum(axis=0))
        @ centred[number].T
        for number, capture in pairs
    ]
    fold = np.array([used.index(number) for number, _ in pairs])
    return Residuals(np.array(trained), fold, np.array(left_out)).wearing(references)


def _mean_products(moments: Array) -> Array:
    """(124, 124): the moments (PACKED,) per frame."""
    whole = matrix(moments)
    mean: Array = whole / whole[ONE, ONE]
    return mean


def _shoulder_frame() -> Array:
    """(124, 124): takes poses, with their one, from C7 as the origin to midway between the
    shoulders. The yaw of both body frames is that of the shoulders: they differ by a translation.
    """
    frame = np.eye(ONE + 1)
    for label in SHOULDERS:
        frame[np.arange(ONE), np.tile(columns_of((label,)), len(MARKERS))] -= 0.5
    return frame


def search(
    start: Residuals, choice: Choice, seed: int, advance: Advance, starts: int = STARTS
) -> list[ScoredSet]:
    """All sets of the size asked for that were scored on the way, the best first.

    From each start one unit or two are exchanged for others, whichever helps most, until none
    does. The first start takes the best unit, then the best one beside it and so on; the others
    are random. START_WORK units of progress each.
    """
    generator = np.random.default_rng(seed)
    descent = _Descent(start, choice)
    for number in range(starts):
        error = descent.run(_at_random(choice, generator) if number else ())
        advance(f"search {number + 1} of {starts}: {error:.1f} mm", START_WORK)
    return descent.found()


def best_by_size(start: Residuals, choice: Choice) -> list[ScoredSet]:
    """The best set found of each size below that asked for, as the wishes allow, the smallest
    first.
    """
    found = []
    for left in range(0 if choice.must else 1, choice.left):
        if can_fill(left, choice.units):
            descent = _Descent(start, replace(choice, left=left))
            descent.run(())
            found.append(descent.found()[0])
    return found


def distinct(ranked: Sequence[ScoredSet], count: int) -> list[ScoredSet]:
    """The best sets, each with at least DIFFERENT markers that any one before it has not."""
    kept: list[ScoredSet] = []
    for one in ranked:
        if len(kept) == count:
            break
        if all(len({*one.markers} - {*other.markers}) >= DIFFERENT for other in kept):
            kept.append(one)
    return kept


class _Descent:
    """Exchanges units as long as that helps, and keeps the error of every set on the way."""

    def __init__(self, start: Residuals, choice: Choice) -> None:
        self._start = start.wearing(choice.beside_references(choice.must))
        self._choice = choice
        self._errors: dict[frozenset[str], float] = {}

    def run(self, chosen: Units) -> float:
        """From these units, filled up, to where no exchange helps: the error there, mm."""
        best = self._filled(chosen)
        while True:
            error, chosen = best
            rests = [
                tuple(unit for unit in chosen if unit not in given)
                for number in _EXCHANGED
                for given in combinations(chosen, number)
            ]
            best = min(map(self._filled, rests), default=best)
            if error - best[0] < _GAIN:
                return error

    def found(self) -> list[ScoredSet]:
        """All sets scored so far, the best first."""
        sets = [
            ScoredSet(tuple(sorted(labels | {*self._choice.must}, key=MARKERS.index)), error)
            for labels, error in self._errors.items()
        ]
        return sorted(sets, key=lambda one: (one.error_mm, one.markers))

    def _filled(self, chosen: Units) -> tuple[float, Units]:
        """These units with the best found to make up the number, and the error with them, mm."""
        return self._fill(self._start.wearing(_labels(chosen)), chosen)

    def _fill(self, state: Residuals, chosen: Units) -> tuple[float, Units]:
        left = self._choice.left - len(_labels(chosen))
        if not left:
            self._errors[frozenset(_labels(chosen))] = state.error_mm()
            return state.error_mm(), chosen
        free = [unit for unit in self._choice.units if unit not in chosen]
        found = []
        # A pair tells more than one marker and takes the place of two: each size is gone on with.
        for size in sorted({len(unit) for unit in free}):
            units = tuple(unit for unit in free if len(unit) == size)
            rest = [unit for unit in free if unit != units[0]]
            if not can_fill(left - size, rest):
                continue
            errors = state.errors_mm(units).tolist()
            best = units[errors.index(min(errors))]
            if size == left:
                for unit, error in zip(units, errors, strict=True):
                    self._errors[frozenset(_labels((*chosen, unit)))] = error
                found.append((min(errors), (*chosen, best)))
            else:
                found.append(self._fill(state.wearing(best), (*chosen, best)))
        return min(found)


def _labels(units: Units) -> Markers:
    return tuple(label for unit in units for label in unit)


def _at_random(choice: Choice, generator: np.random.Generator) -> Units:
    """Units that make up the number."""
    order = [choice.units[row] for row in generator.permutation(len(choice.units))]
    chosen: Units = ()
    for place, unit in enumerate(order, 1):
        left = choice.left - len(_labels((*chosen, unit)))
        if can_fill(left, order[place:]):
            chosen = (*chosen, unit)
    return chosen
