"""`markerbridge calibrate`: a model for one person, from some seconds of all their markers."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from bridge.model import Model
from drivers.c3d_file import read_c3d
from drivers.errors import MarkerbridgeError, UsageError
from drivers.files import write_json, write_whole
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from drivers.options import checked, positive
from training.calibration import adapted, calibrated
from training.dataset import UNKNOWN, DatasetError, Take
from training.evaluation import evaluate
from training.telling import Notices

MIN_SECONDS = 1.0  # of frames with all markers
LONGEST = 30.0  # s of a recording that are taken
_FITTED = 2 / 3  # of the complete frames: what it gains is told by those after them
_SCORES = (
    ("rms_mm", "RMS mm", ".1f"),
    ("rms_all_mm", "all 41", ".1f"),
    ("jerk_mm", "jerk mm", ".2f"),
    ("roughness", "rough", ".2f"),
)


def main(argv: list[str]) -> int:
    """Runs the command. Raises MarkerbridgeError; UsageError for what cannot be meant."""
    options = _parser().parse_args(argv)
    if options.seconds < MIN_SECONDS:
        raise UsageError(f"--seconds {options.seconds:g}: calibration needs {MIN_SECONDS:g} s")
    if options.out.suffix != ".onnx":
        raise UsageError(f"--out {options.out}: the name of a model file ends in .onnx")
    for path in (options.out, options.json):
        if path is not None and not path.parent.is_dir():
            raise MarkerbridgeError(f"cannot write {path}: no such folder")
    notices = Notices()
    model = Model(options.model)
    clip = read_c3d(options.recording)
    rate = clip.layout.rate
    xyz = clip.xyz[: round(options.seconds * rate)]
    complete = _complete(options.recording, xyz, rate)
    cut = int(complete[round(_FITTED * len(complete))])
    rest = Take(
        name=options.recording.name,
        subject=UNKNOWN,
        motion="",
        split="",
        real=True,
        rate=rate,
        xyz=xyz[cut:],
    )
    with threadpool_limits(1):  # the matrices are small: threads would wait for each other
        scored = {
            "generic": asdict(evaluate(model, [rest])[0].scores),
            "calibrated": asdict(evaluate(adapted(model, xyz[:cut], rate), [rest])[0].scores),
        }
        content = calibrated(model, xyz, rate)
    found = {
        "recording": options.recording.name,
        "calibrated_frames": len(complete),
        "calibrated_seconds": round(len(complete) / rate, 2),
        "held_out": {
            "frames": len(rest.xyz),
            **{
                which: {name: scores[name] for name, _, _ in _SCORES}
                for which, scores in scored.items()
            },
        },
    }
    write_whole(options.out, content)
    if options.json is not None:
        write_json(options.json, found)
    _print(found)
    before, after = (scores["rms_mm"] for scores in scored.values())
    if before is not None and after is not None and after > before:
        notices.warn(
            "it gained nothing on what was held out: record motion that is more like what is to "
            "come, and longer"
        )
    notices.say(f"{options.out}: adapted to {found['calibrated_seconds']:g} s")
    return 0


def _complete(path: Path, xyz: Floats, rate: float) -> npt.NDArray[np.intp]:
    """The frames with all markers. Raises DatasetError where they are too few, naming the markers
    that lack most often.
    """
    missing = np.isnan(xyz[..., 0])
    complete = np.flatnonzero(~missing.any(axis=1))
    if len(complete) >= MIN_SECONDS * rate:
        return complete
    worst = np.argsort(-missing.sum(axis=0), kind="stable")[:3]
    often = [MARKERS[row] for row in worst if missing[:, row].any()]
    why = f"; missing most often: {', '.join(often)}" if often else ""
    raise DatasetError(
        f"{path}: calibration needs {MIN_SECONDS:g} s with all 41 markers, "
        f"there are {len(complete) / rate:.2f} s{why}"
    )


def _print(found: dict[str, Any]) -> None:
    held = found["held_out"]
    table = Table(
        box=SIMPLE,
        pad_edge=False,
        title=f"the last {held['frames']} frames, held out",
        title_justify="left",
    )
    table.add_column("")
    for _, title, _ in _SCORES:
        table.add_column(title, justify="right", no_wrap=True)
    for which in ("generic", "calibrated"):
        cells = [(held[which][name], form) for name, _, form in _SCORES]
        told = ["-" if value is None else format(value, form) for value, form in cells]
        table.add_row(which, *told)
    Console().print(table)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge calibrate",
        description="Adapts a model to the person of a recording with all 41 markers. What that "
        "gains is measured on the last third of it, by a model adapted to the rest; the model "
        "written is adapted to all of it.",
    )
    add = parser.add_argument
    add("model", metavar="MODEL", help="a model file, or default")
    add("recording", metavar="RECORDING", type=Path, help="a C3D file with all 41 markers")
    add("--out", required=True, type=Path, metavar="MINE.onnx", help="the model file to write")
    add(
        "--seconds",
        type=checked(positive),
        default=LONGEST,
        metavar="S",
        help=f"how much of the recording is taken at most (default: {LONGEST:g})",
    )
    add("--json", type=Path, metavar="FILE", help="writes the figures there as well")
    return parser
