"""`markerbridge select-markers`: which markers to wear, chosen by variance as the paper does or by
the error of what is estimated from them; and how that choice does beside others.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from threadpoolctl import threadpool_limits

from bridge.body_frame import SIX_FRAME
from drivers.errors import MarkerbridgeError, UsageError
from drivers.files import write_whole
from drivers.marker_set import MARKERS
from drivers.options import checked, seed
from training.corpus import Corpus, read_corpus, work_of
from training.dataset import Capture, no_captures, training_captures
from training.folds import Fold, leave_out
from training.marker_search import START_WORK as SEARCH_WORK
from training.marker_search import (
    STARTS,
    ScoredSet,
    best_by_size,
    distinct,
    residuals,
    search,
)
from training.marker_selection import select_markers
from training.marker_wishes import COUNT, SHOULDERS, Markers, Wishes
from training.pipeline import (
    CANDIDATES,
    FIT_WORK,
    AnyRecipe,
    candidate_covariance,
    choose_principal,
)
from training.progress import Advance, progress
from training.recipe import RECIPES, NetworkRecipe
from training.search_study import SearchStudy
from training.selection_study import START_WORK, SelectionStudy, repeat_selection
from training.selection_table import print_search, print_selection
from training.set_comparison import SetScores, compare_sets
from training.telling import Notices, command_line
from training.train_command import check_principal
from training.workers import add_cluster_option, check_cluster, workers

if TYPE_CHECKING:
    from training.report.page import Report

VARIANCE, ERROR = "variance", "error"
RECORD = "runs.csv"  # in the report's folder
BEST = 5  # sets of least error that are told of
# The options of each way to choose, and what they are where they are not given.
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    VARIANCE: {"runs": 1000, "restarts": 10},  # runs: as the paper's
    ERROR: {
        "count": COUNT,
        "must": (),
        "never": (),
        "pairs": False,
        "clothes": False,
        "alone": False,
        "top": 3,
    },
}


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What both ways to choose need. folds: none where nothing is to be scored on them."""

    options: argparse.Namespace
    manual: Sequence[Markers]
    captures: Sequence[Capture]
    folds: Sequence[Fold]
    recipe: AnyRecipe
    command: str
    notices: Notices


def main(argv: list[str]) -> int:
    """Runs the command. Raises MarkerbridgeError; UsageError for what cannot be meant."""
    options = _parser().parse_args(argv)
    _set_options(options)
    by_error = options.by == ERROR
    wishes = _wishes(options) if by_error else Wishes()
    wishes.choice()  # an error at once, and not after all the work
    manual = [] if options.compare is None else _parse_sets(options.compare, wishes.alone)
    if options.report is not None:
        # At once too: the folder, and the libraries that it takes.
        from training.report.page import make_folder

        make_folder(options.report)
    if options.json is not None and not options.json.parent.is_dir():
        raise MarkerbridgeError(f"cannot write {options.json}: no such folder")
    captures = training_captures(options.data)
    if not captures:
        raise no_captures(options.data)
    folds = leave_out(captures) if manual or by_error else []
    if (manual or by_error) and not folds:
        why = "--by error" if by_error else "--compare"
        raise MarkerbridgeError(f"{options.data}: {why} needs more than one capture")
    check_cluster(options.cluster)
    recipe = RECIPES[options.estimator]
    if wishes.alone:
        recipe = replace(recipe, body_frame=SIX_FRAME.name)
    task = _Task(
        options,
        manual,
        captures,
        folds,
        recipe,
        command_line("select-markers", argv, options),
        Notices(),
    )
    told, report = _by_error(task, wishes) if by_error else _by_variance(task)
    if options.json is not None:
        found = {**told, "seed": options.seed, "estimator": options.estimator}
        write_whole(options.json, (json.dumps(found, indent=2, allow_nan=False) + "\n").encode())
    if options.report is not None:
        page = report().write()
        Console().print(f"report: {page}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _by_variance(task: _Task) -> tuple[dict[str, Any], Callable[[], Report]]:
    """The paper's choice, many times over: what is told in JSON, and the report to be made."""
    options = task.options
    record = None if options.report is None else options.report / RECORD
    work = work_of(options.data, task.captures) + options.runs * options.restarts * START_WORK
    if task.manual:
        work += (1 + len(task.manual)) * len(task.folds) * FIT_WORK
    # One thread for linear algebra, as in `train`: the same data chooses the same markers.
    with progress(task.notices.console, work) as advance, threadpool_limits(1):
        corpus = _read(task, advance)
        covariance = candidate_covariance(corpus)
        chosen = select_markers(covariance, CANDIDATES, options.seed)
        with _going_on_later(record, task.notices):
            with workers(options.cluster, covariance, processes=True):
                runs = repeat_selection(
                    covariance,
                    CANDIDATES,
                    options.runs,
                    options.restarts,
                    options.seed,
                    advance,
                    record,
                )
            compared = []
            if task.manual:
                compared = _compare(task, corpus, [chosen.markers, *task.manual], advance)
    study = SelectionStudy(CANDIDATES, options.restarts, chosen, runs)
    print_selection(study, compared)

    def report() -> Report:
        from training.report.selection import selection_report

        left_out = task.notices.left_out
        return selection_report(options.report, study, compared, corpus, task.command, left_out)

    # The automatic set first.
    told = {"by": VARIANCE, **study.to_json()}
    return told | {"compared": [one.to_json() for one in compared] or None}, report


def _by_error(task: _Task, wishes: Wishes) -> tuple[dict[str, Any], Callable[[], Report]]:
    """The choice that leaves the least error: what is told in JSON, and the report to be made."""
    options, choice = task.options, wishes.choice()
    top = options.top
    work = work_of(options.data, task.captures) + STARTS * SEARCH_WORK
    if top:
        work += (top + 1 + len(task.manual)) * len(task.folds) * FIT_WORK
    with progress(task.notices.console, work) as advance, threadpool_limits(1):
        corpus = _read(task, advance)
        start = residuals(corpus, task.folds, choice.references)
        ranked = search(start, choice, options.seed, advance)
        by_size = [*best_by_size(start, choice), ranked[0]]
        best = distinct(ranked, max(top, BEST))
        by_variance = choose_principal(corpus, options.seed, choice.beside_references(MARKERS))
        named = {"by variance": (*(SHOULDERS if wishes.alone else ()), *by_variance)}
        named |= {f"manual {number}": one for number, one in enumerate(task.manual, 1)}
        others = {
            name: ScoredSet(one, start.wearing(choice.beside_references(one)).error_mm())
            for name, one in named.items()
        }
        scores = {}
        if top:
            sets = list(dict.fromkeys(one.markers for one in (*best[:top], *others.values())))
            principal = [choice.beside_references(markers) for markers in sets]
            scores = dict(zip(sets, _compare(task, corpus, principal, advance), strict=True))
    study = SearchStudy(wishes, by_size, best, others, len(ranked), scores)
    print_search(study)

    def report() -> Report:
        from training.report.search import search_report

        left_out = task.notices.left_out
        return search_report(options.report, study, corpus, task.command, left_out)

    return {"by": ERROR, **study.to_json()}, report


def _read(task: _Task, advance: Advance) -> Corpus:
    with workers(None):
        return read_corpus(
            task.options.data, task.captures, task.recipe, advance, task.notices.warn
        )


def _compare(
    task: _Task, corpus: Corpus, sets: Sequence[Markers], advance: Advance
) -> list[SetScores]:
    options = task.options
    with workers(options.cluster, corpus, processes=isinstance(task.recipe, NetworkRecipe)):
        return compare_sets(
            corpus, options.data, task.folds, sets, task.recipe, options.seed, advance
        )


@contextmanager
def _going_on_later(record: Path | None, notices: Notices) -> Iterator[None]:
    """On Ctrl-C says that the runs done so far are not lost, where they are kept."""
    try:
        yield
    except KeyboardInterrupt:
        if record is not None:
            notices.say(f"the runs done are kept in {record}: the same command goes on there")
        raise


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge select-markers",
        description="Chooses principal markers from a folder of C3D files (the split train alone "
        "where its manifest.csv has splits): by variance, as the paper does, many times over, and "
        "tells how often each marker is chosen; or by the error of what is estimated from them, "
        "in performers left out.",
    )
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="a folder of C3D files")
    add(
        "--by",
        choices=tuple(_OPTIONS),
        default=VARIANCE,
        help=f"what the choice is made by (default: {VARIANCE})",
    )
    variance, error = _OPTIONS[VARIANCE], _OPTIONS[ERROR]
    add_one = parser.add_argument_group(f"with --by {VARIANCE}").add_argument
    add_one(
        "--runs",
        type=checked(_count),
        metavar="N",
        help=f"runs of the selection, each from its own seed (default: {variance['runs']})",
    )
    add_one(
        "--restarts",
        type=checked(_count),
        metavar="N",
        help="starts of K-means in each run, the best of which counts "
        f"(default: {variance['restarts']})",
    )
    add_one = parser.add_argument_group(f"with --by {ERROR}").add_argument
    add_one(
        "--count",
        type=checked(_count),
        metavar="K",
        help=f"how many markers are chosen, the references apart (default: {error['count']})",
    )
    add_one("--must", type=_labels, metavar="A,B", help="markers that are chosen in any case")
    add_one("--never", type=_labels, metavar="A,B", help="markers that are not chosen")
    add_one(
        "--pairs",
        action="store_true",
        default=None,
        help="a left marker only together with its right twin",
    )
    add_one(
        "--clothes",
        action="store_true",
        default=None,
        help="only markers that a cap, bands, a belt, gloves or shoes hold",
    )
    add_one(
        "--alone",
        action="store_true",
        default=None,
        help="no C7, as with `train --alone`: K markers in all, both shoulders among them",
    )
    add_one(
        "--top",
        type=checked(_whole),
        metavar="N",
        help="so many of the best sets are scored with the estimator on the folds, and the best of "
        f"these is chosen; 0: none (default: {error['top']})",
    )
    add(
        "--compare",
        metavar="A,B;C,D",
        help="sets of markers that the chosen one is scored against, on performers left out",
    )
    add(
        "--estimator",
        choices=tuple(RECIPES),
        default="local",
        help="what is trained to score sets, as in `train` (default: local); best takes minutes "
        "for each set and performer left out",
    )
    add("--seed", type=checked(seed), default=0, help="of all that is random (default: 0)")
    add_cluster_option(parser, "the runs and the folds")
    add("--json", type=Path, metavar="FILE", help="writes the figures there as well")
    add(
        "--report",
        type=Path,
        metavar="DIR",
        help="writes a page with tables and plots there; runs are kept there as they are done, "
        "and a study that was stopped goes on",
    )
    return parser


def _set_options(options: argparse.Namespace) -> None:
    """Fills in what was not given. Raises UsageError for what the other way to choose takes."""
    for way, own in _OPTIONS.items():
        for name, default in own.items():
            if getattr(options, name) is None:
                setattr(options, name, default)
            elif way != options.by:
                raise UsageError(f"--{name} goes with --by {way}")


def _wishes(options: argparse.Namespace) -> Wishes:
    return Wishes(
        count=options.count,
        must=options.must,
        never=options.never,
        pairs=options.pairs,
        clothes=options.clothes,
        alone=options.alone,
    )


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise ValueError(f"'{text}' is no whole number from 1")
    return int(text)


def _whole(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(f"'{text}' is no whole number from 0")
    return int(text)


def _labels(text: str) -> Markers:
    return tuple(label.strip() for label in text.split(","))


def _parse_sets(text: str, alone: bool) -> list[Markers]:
    """The sets of `A,B;C,D`. Raises UsageError for those that cannot be worn so."""
    if not alone:
        return [check_principal(one, "--compare") for one in text.split(";")]
    sets = [_labels(one) for one in text.split(";")]
    for labels in sets:
        unknown = [label for label in labels if label not in MARKERS]
        if unknown:
            raise UsageError(f"--compare: {', '.join(unknown)} not in the marker set")
        if not {*SHOULDERS} < {*labels} < {*MARKERS} or len({*labels}) < len(labels):
            raise UsageError(
                f"--compare: {','.join(labels)}: with --alone a set has {' and '.join(SHOULDERS)}, "
                "others beside them but not all, and none twice"
            )
    return sets
