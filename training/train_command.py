"""`markerbridge train`: captures in, one model file out."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from bridge.body_frame import PAPER_FRAME, REFERENCES, SIX_FRAME
from bridge.model import MAX_HISTORY, ModelInfo
from drivers.errors import MarkerbridgeError, UsageError
from drivers.files import write_whole
from drivers.marker_set import MARKERS
from drivers.options import checked, seed
from training.corpus import Corpus, read_corpus, work_of
from training.dataset import TEST, digest, manifest_splits, no_captures, training_captures
from training.dataset import captures as captures_of
from training.export import to_onnx
from training.fitting import Fitted
from training.folds import leave_out
from training.pipeline import FIT_WORK, choose, fits, train
from training.progress import progress
from training.recipe import RECIPES, MixtureRecipe, NetworkRecipe
from training.telling import Notices, command_line
from training.workers import add_cluster_option, check_cluster, workers


def main(argv: list[str]) -> int:
    """Runs the command. Raises MarkerbridgeError; UsageError for what cannot be meant."""
    options = _parser().parse_args(argv)
    start = time.monotonic()
    frame = SIX_FRAME if options.alone else PAPER_FRAME
    wish = None
    if options.principal is not None:
        wish = check_principal(options.principal, references=frame.references)
    if options.out.suffix != ".onnx":
        raise UsageError(f"--out {options.out}: the name of a model file ends in .onnx")
    if not options.out.parent.is_dir():
        raise MarkerbridgeError(f"cannot write {options.out}: no such folder")
    notices = Notices()
    if options.report is not None:
        from training.report.page import make_folder

        make_folder(options.report)  # an error at once, and not after all the work
    recipe = RECIPES[options.estimator]
    if options.history is not None:
        if not isinstance(recipe, MixtureRecipe):
            raise UsageError(
                f"--history: `{options.estimator}` has none; it is for local and paper"
            )
        recipe = replace(recipe, history=options.history)
    if options.alone:
        recipe = replace(recipe, body_frame=SIX_FRAME.name)
    captures = training_captures(options.data)
    if not captures:
        raise no_captures(options.data)
    tests = captures_of(options.data, TEST) if TEST in manifest_splits(options.data) else []
    folds = leave_out(captures) if options.folds else []
    if not folds:
        notices.warn(
            "no folds: the accuracy in the model file is that on its own training captures"
        )
    check_cluster(options.cluster)
    work = work_of(options.data, captures) + fits(folds, recipe) * FIT_WORK
    # One thread for linear algebra: the matrices are small, and the sums do not depend on the
    # machine's cores.
    with progress(notices.console, work) as advance, threadpool_limits(1):
        with workers(None):
            corpus = read_corpus(options.data, captures, recipe, advance, notices.warn)
        principal = wish or choose(corpus, folds, recipe, options.seed)
        networks = isinstance(recipe, NetworkRecipe)
        with workers(options.cluster, corpus, processes=networks):
            fitted = train(
                corpus,
                options.data,
                tests,
                folds,
                principal,
                recipe,
                options.seed,
                advance,
                notices.warn,
            )
    used = fitted.info.training | {"data": digest(options.data, corpus.captures)}
    info = replace(fitted.info, training=used)
    content = to_onnx(fitted.graph, info)
    told = command_line("train", argv, options)
    record = _record(told, info, len(content), time.monotonic() - start)
    write_whole(options.out, content)
    write_whole(options.out.with_suffix(".json"), record.encode())
    if options.report is not None:
        page = _report(options, told, corpus, fitted, info, notices.left_out)
        notices.say(f"report: {page}")
    _summarise(notices, options.out, info, len(content))
    return 0


def check_principal(
    text: str, option: str = "--principal", references: tuple[str, ...] = REFERENCES
) -> tuple[str, ...]:
    """The labels of `A,B,...`. Raises UsageError for those that cannot be principal markers,
    naming the option. references: those that are worn in any case.
    """
    labels = tuple(label.strip() for label in text.split(","))
    unknown = [label for label in labels if label not in MARKERS]
    if unknown:
        raise UsageError(f"{option}: {', '.join(unknown)} not in the marker set")
    worn = [label for label in labels if label in references]
    if worn:
        raise UsageError(
            f"{option}: {', '.join(worn)} are references, worn in any case: leave them out"
        )
    if len({*labels, *references}) == len(MARKERS):
        raise UsageError(f"{option}: no marker is left to be estimated")
    if len(set(labels)) != len(labels):
        raise UsageError(f"{option}: a marker is named twice")
    return labels


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge train",
        description="Trains a model on a folder of C3D files: on the split train alone where its "
        "manifest.csv has splits.",
    )
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="a folder of C3D files")
    add(
        "--out",
        required=True,
        type=Path,
        metavar="MODEL.onnx",
        help="the model file; its training record goes beside it, as .json",
    )
    add(
        "--principal",
        metavar="A,B,...",
        help="the principal markers; without it they are chosen from the data",
    )
    add(
        "--estimator",
        choices=tuple(RECIPES),
        default="local",
        help="paper: the plain method; local (default): affine ridge maps, soft votes; best: "
        "networks",
    )
    add(
        "--alone",
        action="store_true",
        help="no C7: the body frame is the shoulders', and they and the principal markers are all "
        "that is worn",
    )
    add("--history", type=_history, metavar="H", help="frames of 1/120 s that the mixture spans")
    add("--seed", type=checked(seed), default=0, help="of all that is random (default: 0)")
    add(
        "--report",
        type=Path,
        metavar="DIR",
        help="writes a page there on the data, their segments and clusters, beside the paper's",
    )
    add_cluster_option(parser, "the folds and the forest")
    add(
        "--no-folds",
        dest="folds",
        action="store_false",
        help="do not measure the accuracy on people left out: faster",
    )
    return parser


def _history(text: str) -> int:
    if not (text.isdecimal() and int(text) <= MAX_HISTORY):
        raise argparse.ArgumentTypeError(f"'{text}' is no number of frames up to {MAX_HISTORY}")
    return int(text)


def _record(told: str, info: ModelInfo, size: int, seconds: float) -> str:
    """What was done and what came of it, for a reader; names no path of this machine."""
    entry: dict[str, Any] = {
        "command": told,
        "markers": {"principal": info.principal, "references": info.references},
        "accuracy": info.accuracy,
        "sigma_mm": {
            label: round(1000 * sigma, 1)
            for label, sigma in zip(info.unworn, info.sigma, strict=True)
        },
        "training": info.training,
        "file": {"bytes": size},
        "seconds": round(seconds),
    }
    return json.dumps(entry, indent=2, allow_nan=False) + "\n"


def _report(
    options: argparse.Namespace,
    told: str,
    corpus: Corpus,
    fitted: Fitted,
    info: ModelInfo,
    without: Sequence[tuple[str, str]],
) -> Path:
    from training.report.page import Report  # matplotlib takes a second to load
    from training.report.training import add_training

    report = Report(
        options.report, f"Training of {options.out.name} on {options.data.resolve().name}"
    )
    add_training(report, told, corpus, fitted.leaves, info, without)
    return report.write()


def _summarise(notices: Notices, path: Path, info: ModelInfo, size: int) -> None:
    folds, test = info.accuracy["folds"], info.accuracy["test"]
    left_out = "people left out" if folds and folds["people"] else "files left out"
    reached = [
        f"{what} {scores['rms_mm']:.1f} mm RMS"
        for what, scores in ((left_out, folds and folds["mean"]), ("test split", test))
        if scores and scores["rms_mm"] is not None
    ]
    leaves = info.training.get("leaves")
    told = "" if leaves is None else f", {leaves} local models"
    lines = (
        f"{path}: {size / 1e6:.1f} MB{told}",
        f"principal markers: {', '.join(info.principal)}",
        *reached,
    )
    for line in lines:
        notices.say(line)
