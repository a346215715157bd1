"""Which marker is which, by where they are: for streams whose labels say nothing."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from bridge.doctor.body_fit import BodyFit
from bridge.doctor.readings import MARGIN, Reading
from bridge.doctor.worlds import FITS, WORLDS
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Columns = tuple[int, ...]

FRAMES = 12  # that the search looks at
STARTS = 24  # of the best guesses, so many are followed up
PLAUSIBLE = 200.0  # squared distance: people who dance on their hands reach 130
MOST = 64  # markers of a stream among which the search is worth its time


def by_place(
    fit: BodyFit, xyz: Floats, fixed: dict[str, int] | None = None
) -> tuple[Reading, Columns] | None:
    """The world, and for each of fit's labels its column in xyz, (n, M, 3) without NaN, of a body
    of the right size; None where nothing fits, or two ways do.

    fixed: columns of labels that are known.
    """
    if xyz.shape[1] > MOST:
        return None
    few = xyz[np.linspace(0, len(xyz) - 1, min(FRAMES, len(xyz))).astype(int)]
    fixed_rows = {fit.labels.index(label): column for label, column in (fixed or {}).items()}
    references = _references(fit, few.astype(float), fixed_rows)
    if not len(references):
        return None
    starts = []
    for world in WORLDS:
        there = world.to_ours(few).astype(float)
        costs = _costs(fit, there, references, fixed_rows)
        bound = costs.min(axis=1).sum(axis=1)
        for n in np.argsort(bound)[:STARTS]:
            starts.append((float(bound[n]), world, there, references[n], costs[n]))
    starts.sort(key=lambda start: start[0])
    found: dict[tuple[Reading, Columns], float] = {}
    for _, world, there, chosen, costs in starts[:STARTS]:
        columns = _first_guess(fit, chosen, costs, fixed_rows)
        columns, misfit, second = _improved(fit, there, columns, fixed_rows)
        found[Reading(world), columns] = min(misfit, found.get((Reading(world), columns), np.inf))
        found.setdefault((Reading(world), second[0]), second[1])
    return _clearest(found)


def _references(fit: BodyFit, xyz: Array, fixed: dict[int, int]) -> npt.NDArray[np.intp]:
    """(C, R): columns that may be the body frame's markers, being as far from each other."""
    away = np.linalg.norm(xyz[:, :, None] - xyz[:, None], axis=3)
    away = np.median(away, axis=0)
    choices = [
        [fixed[row]] if row in fixed else sorted(set(range(xyz.shape[1])) - set(fixed.values()))
        for row in fit.references
    ]
    grid = np.stack(np.meshgrid(*choices, indexing="ij"), axis=-1).reshape(-1, len(choices))
    fits = np.ones(len(grid), bool)
    for one, other in itertools.combinations(range(len(choices)), 2):
        expected = fit.distance(fit.references[one], fit.references[other])
        ratio = away[grid[:, one], grid[:, other]] / expected
        fits &= (ratio > 1 / FITS) & (ratio < FITS)
    return grid[fits]


def _costs(
    fit: BodyFit, xyz: Array, references: npt.NDArray[np.intp], fixed: dict[int, int]
) -> Array:
    """(C, M, T): what it costs each column to be each label, for each choice of references."""
    found = []
    for chosen in references:
        in_body = fit.in_body(xyz[:, chosen], xyz)
        costs = np.median(fit.misfit_each(in_body), axis=0)
        for row, column in [*zip(fit.references, chosen, strict=True), *fixed.items()]:
            costs[column], costs[:, row], kept = np.inf, np.inf, costs[column, row]
            costs[column, row] = kept
        found.append(costs)
    return np.array(found)


def _first_guess(
    fit: BodyFit, chosen: npt.NDArray[np.intp], costs: Array, fixed: dict[int, int]
) -> Columns:
    """The cheapest column for each label, the surest first."""
    columns = dict(zip(fit.references, (int(column) for column in chosen), strict=True)) | fixed
    costs = costs.copy()
    costs[list(columns.values())] = np.inf
    while len(columns) < len(fit.labels):
        costs[:, list(columns)] = np.inf
        column, row = np.unravel_index(int(np.argmin(costs)), costs.shape)
        columns[int(row)] = int(column)
        costs[column] = np.inf
    return tuple(columns[row] for row in range(len(fit.labels)))


def _improved(
    fit: BodyFit, xyz: Array, columns: Columns, fixed: dict[int, int]
) -> tuple[Columns, float, tuple[Columns, float]]:
    """Columns exchanged one by one as long as it fits better; and the next best."""
    while True:
        near = [columns, *_neighbours(columns, xyz.shape[1], fixed)]
        misfits = np.median(fit.misfit(xyz[:, np.array(near)].swapaxes(0, 1)), axis=1)
        best, second = np.argsort(misfits, kind="stable")[:2]
        if near[best] == columns:
            return columns, float(misfits[best]), (near[second], float(misfits[second]))
        columns = near[best]


def _neighbours(columns: Columns, count: int, fixed: dict[int, int]) -> list[Columns]:
    """All that differ by one column, or by two exchanged."""
    near = []
    free = [row for row in range(len(columns)) if row not in fixed]
    for row in free:
        for column in set(range(count)) - set(fixed.values()):
            if column == columns[row]:
                continue
            other = list(columns)
            if column in columns:
                other[columns.index(column)] = columns[row]
            other[row] = column
            near.append(tuple(other))
    return list(dict.fromkeys(near))


def _clearest(found: dict[tuple[Reading, Columns], float]) -> tuple[Reading, Columns] | None:
    """The best, where no other comes near that changes as little."""
    least = min(found.values())
    if least > PLAUSIBLE:
        return None
    near = [way for way, misfit in found.items() if misfit < least + MARGIN]
    simplest = min(reading.changes for reading, _ in near)
    near = [way for way in near if way[0].changes == simplest]
    return near[0] if len({columns for _, columns in near}) == 1 else None
