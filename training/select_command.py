"""`markerbridge select-markers`: which markers to wear, how sure that choice is, and how it does
beside others.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from drivers.errors import MarkerbridgeError
from drivers.files import write_whole
from drivers.options import checked, seed
from training.corpus import read_corpus, work_of
from training.dataset import no_captures, training_captures
from training.folds import leave_out
from training.marker_selection import select_markers
from training.pipeline import CANDIDATES, FIT_WORK, candidate_covariance
from training.progress import progress
from training.recipe import RECIPES
from training.selection_study import START_WORK, SelectionStudy, repeat_selection
from training.set_comparison import SetScores, compare_sets
from training.telling import Notices, command_line
from training.train_command import check_principal
from training.workers import add_cluster_option, check_cluster, workers

RUNS = 1000  # as the paper's
RESTARTS = 10
RECORD = "runs.csv"  # in the report's folder
_SETS = 10  # most frequent sets that are printed


def main(argv: list[str]) -> int:
    """Runs the command. Raises MarkerbridgeError; UsageError for what cannot be meant."""
    options = _parser().parse_args(argv)
    manual = [] if options.compare is None else _parse_sets(options.compare)
    record = None
    if options.report is not None:
        # At once, and not after all the work: the folder, and the libraries that it takes.
        from training.report.page import make_folder

        make_folder(options.report)
        record = options.report / RECORD
    if options.json is not None and not options.json.parent.is_dir():
        raise MarkerbridgeError(f"cannot write {options.json}: no such folder")
    notices = Notices()
    captures = training_captures(options.data)
    if not captures:
        raise no_captures(options.data)
    folds = leave_out(captures) if manual else []
    if manual and not folds:
        raise MarkerbridgeError(f"{options.data}: --compare needs more than one capture")
    recipe = RECIPES[options.estimator]
    check_cluster(options.cluster)
    work = work_of(options.data, captures) + options.runs * options.restarts * START_WORK
    if manual:
        work += (1 + len(manual)) * len(folds) * FIT_WORK
    # One thread for linear algebra, as in `train`: the same data chooses the same markers.
    with progress(notices.console, work) as advance, threadpool_limits(1):
        with workers(None):
            corpus = read_corpus(options.data, captures, recipe, advance, notices.warn)
        covariance = candidate_covariance(corpus)
        chosen = select_markers(covariance, CANDIDATES, options.seed)
        with _going_on_later(record, notices):
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
            if manual:
                with workers(options.cluster, corpus):
                    compared = compare_sets(
                        corpus,
                        options.data,
                        folds,
                        [chosen.markers, *manual],
                        recipe,
                        options.seed,
                        advance,
                    )
    study = SelectionStudy(CANDIDATES, options.restarts, chosen, runs)
    _print(study, compared)
    if options.json is not None:
        _write_json(options.json, study, compared, options)
    if options.report is not None:
        from training.report.selection import selection_report

        page = selection_report(
            options.report,
            study,
            compared,
            corpus,
            command_line("select-markers", argv, options),
            notices.left_out,
        ).write()
        Console().print(f"report: {page}", markup=False, highlight=False, soft_wrap=True)
    return 0


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
        "where its manifest.csv has splits), many times over, and tells how often each marker is "
        "chosen.",
    )
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="a folder of C3D files")
    add(
        "--runs",
        type=checked(_count),
        default=RUNS,
        metavar="N",
        help=f"runs of the selection, each from its own seed (default: {RUNS})",
    )
    add(
        "--restarts",
        type=checked(_count),
        default=RESTARTS,
        metavar="N",
        help=f"starts of K-means in each run, the best of which counts (default: {RESTARTS})",
    )
    add(
        "--compare",
        metavar="A,B;C,D",
        help="sets of markers that the automatic one is scored against, on performers left out",
    )
    add(
        "--estimator",
        choices=tuple(RECIPES),
        default="local",
        help="what is trained to compare, as in `train` (default: local)",
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


def _count(text: str) -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise ValueError(f"'{text}' is no whole number from 1")
    return int(text)


def _parse_sets(text: str) -> list[tuple[str, ...]]:
    """The sets of `A,B;C,D`. Raises UsageError for those that cannot be principal markers."""
    return [check_principal(one, "--compare") for one in text.split(";")]


def _print(study: SelectionStudy, compared: Sequence[SetScores]) -> None:
    console = Console()
    shares = _table("marker", "runs %")
    for label, share in study.shares.items():
        shares.add_row(label, f"{100 * share:.1f}")
    console.print(shares)
    sets = _table(f"the {_SETS} most frequent sets", "runs %")
    for markers, share in list(study.sets.items())[:_SETS]:
        sets.add_row(", ".join(markers), f"{100 * share:.1f}")
    console.print(sets)
    if compared:
        scores = _table("on what is left out in turn", "RMS mm", "all 41", "jerk mm")
        for number, one in enumerate(compared):
            means = (one.mean.rms_mm, one.mean.rms_all_mm, one.mean.jerk_mm)
            scores.add_row(
                ", ".join(one.principal) + (" (automatic)" if number == 0 else ""),
                *("-" if value is None else f"{value:.2f}" for value in means),
            )
        console.print(scores)
    console.print(
        f"principal markers: {', '.join(study.chosen.markers)}", highlight=False, soft_wrap=True
    )


def _table(first: str, *others: str) -> Table:
    table = Table(box=SIMPLE, pad_edge=False)
    table.add_column(first, overflow="fold")
    for title in others:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def _write_json(
    path: Path, study: SelectionStudy, compared: Sequence[SetScores], options: argparse.Namespace
) -> None:
    found: dict[str, Any] = {
        **study.to_json(),
        "seed": options.seed,
        "estimator": options.estimator,
        "compared": [one.to_json() for one in compared] or None,  # the automatic set first
    }
    write_whole(path, (json.dumps(found, indent=2, allow_nan=False) + "\n").encode())
