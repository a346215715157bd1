"""`markerbridge evaluate`: how good a model is on captures, next to the nearest neighbour."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.errors import MarkerbridgeError, UsageError
from drivers.files import write_json
from drivers.options import checked, parse_seconds
from simulators.fault_options import add_fault_options, faults_of
from training.dataset import (
    Capture,
    DatasetError,
    Take,
    captures,
    no_captures,
    stream,
    training_captures,
)
from training.evaluation import Result, evaluate, report, score
from training.evaluation_table import print_evaluation
from training.hiding import ALL, evaluate_hidden, parse_hiding
from training.missing_study import STEPS, missing_study
from training.nearest_neighbour import NearestNeighbour
from training.poses import body_poses
from training.progress import progress
from training.telling import LEFT_OUT, Notices, command_line

HISTORIES = (0, 10, 20, 30, 60)  # frames of 1/120 s that a report tries
MIN_LENGTH = 1.0  # s of a capture that calibration can be scored on
_NAMED = 10  # captures that an error lists


def main(argv: list[str]) -> int:
    """Runs the command. Raises MarkerbridgeError."""
    options = _parser().parse_args(argv)
    notices = Notices()
    model = Model(options.model)
    if options.hide and options.hide.marker not in (ALL, *model.info.tracked):
        known = ", ".join(model.info.tracked)
        raise UsageError(
            f"--hide: {options.hide.marker} is not tracked ({known} are; {ALL}: each in turn)"
        )
    if options.json is not None and not options.json.parent.is_dir():
        raise MarkerbridgeError(f"cannot write {options.json}: no such folder")
    if options.report is not None:
        # At once, and not after all the work: the folder, and the libraries that it takes.
        from training.report.page import make_folder

        make_folder(options.report)
    elif options.show:
        raise UsageError("--show chooses what a report draws: it needs --report DIR")
    if options.missing_study and options.train is None:
        raise UsageError("--missing-study compares with training poses: it needs --train DATA")
    chosen = captures(options.data, options.split)
    _check_shown(options.show, chosen)
    baseline = poses = None
    recalled = 0
    if options.train is not None:
        trained_on = training_captures(options.train)
        recalled = _in_both(options.data, chosen, options.train, trained_on)
        if recalled:
            notices.warn(
                f"{recalled} of the {len(chosen)} captures to be scored are among those of "
                "--train: what was trained on is recalled, not estimated. Give some the split test "
                "in manifest.csv, and write --split test"
            )
        taken = stream(options.train, trained_on, notices.warn)
        parts = [body_poses(take.xyz) for take in taken]
        if not any(map(len, parts)):
            raise DatasetError(f"{options.train}: no frame has all 41 markers")
        poses = np.concatenate(parts)
        del parts
        baseline = NearestNeighbour(poses, model.info)
    faults = faults_of(options)
    results, by_history = _scored(model, chosen, baseline, options, notices)
    found = report(results, model.info)
    takes = []
    if options.hide or options.missing_study:
        takes = list(stream(options.data, chosen, lambda _: None))  # what cannot be read was told
    if options.hide:
        with progress(notices.console, len(takes)) as advance:
            hidden = evaluate_hidden(model, takes, options.hide, faults, options.seed, advance)
        found["hidden"] = hidden.to_json()
    missing = []
    if options.missing_study and poses is not None:
        with progress(notices.console, STEPS) as advance:
            missing = missing_study(model, takes, poses, options.seed, advance)
        found["missing_study"] = [one.to_json() for one in missing]
    print_evaluation(found)
    if options.json is not None:
        write_json(options.json, found)
    if options.report is not None:
        from training.report.evaluation import Run, default_shown, evaluation_report
        from training.report.missing import add_missing

        run = Run(
            model=_name(options.model),
            info=model.info,
            leaves=model.leaves,
            data=_name(options.data),
            train=None if options.train is None else _name(options.train),
            recalled=recalled,
            command=command_line("evaluate", argv, options),
            results=results,
            by_history=by_history,
            shown=options.show or default_shown(results),
            left_out=notices.left_out,
        )
        written = evaluation_report(options.report, run, found)
        if missing:
            add_missing(written, missing)
        page = written.write()
        Console().print(f"report: {page}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _scored(
    model: Model,
    chosen: Sequence[Capture],
    baseline: NearestNeighbour | None,
    options: argparse.Namespace,
    notices: Notices,
) -> tuple[list[Result], dict[int, list[Result]]]:
    """The results of all captures; and for a report, those with other lengths of a mixture's
    history.
    """
    results: list[Result] = []
    # A network has no mixture to be stretched.
    by_history: dict[int, list[Result]] = {length: [] for length in HISTORIES if model.leaves}
    faults = faults_of(options)
    with progress(notices.console, len(chosen)) as advance:
        for take in stream(options.data, chosen, notices.warn):
            scored, adapted = take, model
            try:
                if options.calibrate:
                    scored, adapted = _calibrated_on_its_start(model, take, options.calibrate)
                results += evaluate(adapted, [scored], faults, options.seed, baseline)
                if options.report is not None:
                    for length, found in by_history.items():
                        if length == adapted.info.history:
                            found.append(results[-1])
                            continue
                        estimator = PoseEstimator(adapted, history=length)
                        found += score(estimator, [scored], faults, options.seed)
            except DatasetError as error:
                notices.warn(f"{LEFT_OUT}{take.name}: {error}")
            advance(take.name, 1)
    if not results and options.calibrate:
        raise DatasetError(f"{options.data}: no capture can be calibrated on")
    if not results:
        raise no_captures(options.data)
    return results, by_history


def _check_shown(names: Sequence[str], chosen: Sequence[Capture]) -> None:
    known = [capture.name for capture in chosen]
    for name in names:
        if name not in known:
            some = ", ".join(known[:_NAMED]) + (", …" if len(known) > _NAMED else "")
            raise UsageError(f"--show: no {name} among the captures ({some})")


def _in_both(data: Path, scored: Sequence[Capture], train: Path, used: Sequence[Capture]) -> int:
    """How many of the captures scored are among those used for training."""
    files = {(train / capture.name).resolve() for capture in used}
    return sum((data / capture.name).resolve() in files for capture in scored)


def _calibrated_on_its_start(model: Model, take: Take, longest: float) -> tuple[Take, Model]:
    """The rest of the take, and the model adapted to its first half, at most `longest` seconds.

    Raises DatasetError for a take that is too short, or has too few whole frames there.
    """
    from training.calibration import adapted  # the only part that wants the extra `train`

    if len(take.xyz) < MIN_LENGTH * take.rate:
        raise DatasetError(f"under {MIN_LENGTH:g} s, too short to calibrate on")
    end = min(len(take.xyz) // 2, round(longest * take.rate))
    return replace(take, xyz=take.xyz[end:]), adapted(model, take.xyz[:end], take.rate)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge evaluate",
        description="Runs a model over captures, frame by frame as `markerbridge run` does, and "
        "reports its errors over the markers that nobody wears.",
    )
    add = parser.add_argument
    add("model", metavar="MODEL", type=Path, help="a model file, or default")
    add("data", metavar="DATA", type=Path, help="a folder of C3D files")
    add("--split", metavar="NAME", help="only the files that manifest.csv puts there, e.g. test")
    add(
        "--train",
        metavar="DATA",
        type=Path,
        help="the folder whose training poses the nearest-neighbour baseline searches",
    )
    add_fault_options(parser)
    add(
        "--calibrate",
        type=checked(parse_seconds),
        metavar="10s",
        help="adapt on the first half of each capture, at most so long, and score the rest",
    )
    add(
        "--hide",
        type=checked(parse_hiding),
        metavar="M@1s",
        help="the error of tracked marker M while it is hidden for so long, and how smoothly it "
        "returns; all@1s: of each in turn",
    )
    add(
        "--missing-study",
        action="store_true",
        help="errors against how much is missing, for each way of filling it in (minutes)",
    )
    add("--report", type=Path, metavar="DIR", help="writes a page with tables and plots there")
    add(
        "--show",
        type=lambda text: text.split(","),
        default=[],
        metavar="FILE,FILE",
        help="the captures that the report draws frame by frame",
    )
    add("--json", type=Path, metavar="FILE", help="writes the figures there as well")
    return parser


def _name(path: Path) -> str:
    """The last part of a path: what a report may tell of where things are."""
    return path.resolve().name
