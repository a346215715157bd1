"""`markerbridge convert`: a recorded session as C3D, TRC or CSV."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from bridge import terminal
from bridge.pose import Provenance
from bridge.recording import Recording, Sample, frames_of, poses_of, samples_of
from drivers.c3d_file import MAX_FRAMES, read_c3d, write_c3d
from drivers.coordinates import FRAMES, UNITS, Frame, parse_frame, parse_unit
from drivers.csv_file import write_csv
from drivers.errors import MarkerbridgeError, UsageError
from drivers.files import numbered, whole_file
from drivers.frame import Floats, SourceError
from drivers.options import checked
from drivers.session_log import SessionLog
from drivers.trc_file import UNITS as TRC_UNITS
from drivers.trc_file import trc_header, write_trc

WORLDS = {
    ".c3d": FRAMES["c3d"],
    ".csv": FRAMES["c3d"],
    ".trc": replace(FRAMES["opengl"], unit=UNITS["mm"]),  # OpenSim: y up
}
_WORDS = [kind.name.lower() for kind in Provenance]


def main(argv: list[str]) -> int:
    """Runs the command; 0 when the file is written."""
    options = _parser().parse_args(argv)
    console = Console(stderr=True)
    terminal.log_to(console)
    suffix = options.out.suffix.lower()
    if suffix not in WORLDS:
        raise UsageError(f"'{options.out}': the ending is one of {', '.join(WORLDS)}")
    if options.full and suffix != ".csv":
        raise UsageError("--full is for .csv: other files have no place for it")
    world = _world(options, suffix)
    samples = _samples(options)
    try:
        recording = Recording(samples)
    except ValueError as error:
        raise SourceError(f"{options.recording}: {error}") from error

    def rows() -> Iterable[Sample]:
        return track(
            recording, "converting", recording.rows, console=console, transient=True,
            disable=not console.is_terminal,
        )  # fmt: skip

    with ExitStack() as whole:
        count = math.ceil(recording.rows / MAX_FRAMES) if suffix == ".c3d" else 1
        paths = [numbered(options.out, number + 1) for number in range(count)]
        for path in paths:
            if path.exists() and path.samefile(options.recording):
                raise UsageError(f"{path} is the recording itself: choose another name")
        try:
            parts = [whole.enter_context(whole_file(path)) for path in paths]
            if suffix == ".c3d":
                _write_c3d(parts, recording, iter(rows()))
            elif suffix == ".trc":
                places = (world.from_ours(row.xyz) for row in rows())
                header = trc_header(
                    paths[0].name, recording.layout, _unit_name(world), recording.rows
                )
                write_trc(parts[0], recording.layout, header, places)
            else:
                _write_csv(parts[0], recording, rows(), world, full=options.full)
            whole.close()
        except OSError as error:
            reason = error.strerror or error
            raise MarkerbridgeError(f"cannot write {options.out}: {reason}") from error
    console.print(
        f"{recording.rows} frames of {len(recording.layout.labels)} markers at "
        f"{recording.layout.rate:g} Hz in {', '.join(map(str, paths))}",
        highlight=False,
        soft_wrap=True,
    )
    return 0


def _samples(options: argparse.Namespace) -> Callable[[], Iterator[Sample]]:
    """What the recording holds of what was asked for."""
    path = options.recording
    if path.suffix.lower() == ".c3d":
        if options.what == "poses":
            raise UsageError(f"--what poses: {path} has frames only")
        clip = read_c3d(path, labels=None)
        if not len(clip.xyz):
            raise SourceError(f"{path} has no frames")
        return lambda: samples_of(clip)
    log = SessionLog(path)
    what = options.what or ("poses" if log.holds["poses"] else "frames")
    if not log.holds[what]:
        raise SourceError(f"{path} has no {what}")
    if options.full and what == "frames":
        raise UsageError("--full: of frames there is nothing more to tell")
    return lambda: poses_of(log) if what == "poses" else frames_of(log)


def _world(options: argparse.Namespace, suffix: str) -> Frame:
    """The axes and the unit of the file to write."""
    if suffix == ".c3d" and (options.frame or options.unit):
        raise UsageError(
            "a C3D file is in millimetres, z up: --frame and --unit are for .trc, .csv"
        )
    world: Frame = options.frame or WORLDS[suffix]
    if options.unit:
        world = replace(world, unit=options.unit)
    if suffix == ".trc" and _unit_name(world) not in TRC_UNITS:
        raise UsageError(f"a TRC file knows --unit {', '.join(TRC_UNITS)}")
    return world


def _unit_name(world: Frame) -> str:
    return next(name for name, metres in UNITS.items() if metres == world.unit)


def _write_c3d(parts: list[Path], recording: Recording, rows: Iterator[Sample]) -> None:
    """As many files as it takes; the next goes on where the one before ends."""
    for part in parts:
        frames = [row.xyz for row in itertools.islice(rows, MAX_FRAMES)]
        write_c3d(part, recording.layout, np.stack(frames))


def _write_csv(
    path: Path, recording: Recording, rows: Iterable[Sample], world: Frame, *, full: bool
) -> None:
    labels, rate = recording.layout.labels, recording.layout.rate
    names = ("x", "y", "z", "provenance", "sigma") if full else ("x", "y", "z")
    columns = [f"{label}.{name}" for label in labels for name in names]

    def cells() -> Iterator[tuple[int, float, Sequence[float | str]]]:
        for number, row in enumerate(rows):
            xyz = world.from_ours(row.xyz)
            values: Sequence[float | str] = xyz.ravel().tolist()
            if full:
                values = _with_quality(xyz, row, world.unit)
            yield row.index, number / rate, values

    write_csv(path, columns, cells())


def _with_quality(xyz: Floats, row: Sample, unit: float) -> list[float | str]:
    """x, y, z, where from, and sigma in the file's unit, of each marker."""
    values: list[float | str] = []
    for marker, place in enumerate(xyz.tolist()):
        values += place
        if row.provenance is None or row.sigma is None:
            values += ["", ""]
            continue
        sigma = float(row.sigma[marker])
        values.append(_WORDS[row.provenance[marker]])
        values.append(sigma / unit if math.isfinite(sigma) else "")
    return values


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge convert",
        description="Writes a recorded session (`run --to log:FILE`), or a capture, as C3D, TRC "
        "or CSV, by the ending of OUT. Missing markers, and frames that never came, are missing.",
    )
    add = parser.add_argument
    add("recording", metavar="IN", type=Path, help="a log, or a C3D file")
    add("out", metavar="OUT", type=Path, help="FILE.c3d, FILE.trc or FILE.csv")
    add(
        "--what",
        choices=("poses", "frames"),
        help="the whole body, or what the tracker sent (default: poses, where there are any)",
    )
    add(
        "--frame",
        type=checked(parse_frame),
        metavar="NAME",
        help=f"axes and unit of OUT: {', '.join(FRAMES)} (default: millimetres, z up; .trc y up)",
    )
    add("--unit", type=checked(parse_unit), metavar="UNIT", help=f"{', '.join(UNITS)}")
    add("--full", action="store_true", help="provenance and sigma of each marker as well (.csv)")
    return parser
