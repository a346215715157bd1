"""Folders of C3D files, with or without a manifest, as sequences to train and evaluate on."""

from __future__ import annotations

import csv
import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from drivers.c3d_file import read_c3d
from drivers.errors import MarkerbridgeError, UsageError
from drivers.frame import Floats, SourceError
from training.naming import subject_of

MANIFEST = "manifest.csv"
TRAIN = "train"
TEST = "test"
UNKNOWN = "unknown"  # the manifest's word for a performer nobody can name

Warn = Callable[[str], None]  # told of each file that is left out, and why


class DatasetError(MarkerbridgeError):
    """A folder holds nothing to work on; the message names it and says why."""


@dataclass(frozen=True, slots=True)
class Capture:
    """What is known of one capture of one performer before its file is read.

    name: the file, relative to the folder. subject: who performed. motion: a free description.
    split: `train`, `test` or whatever the manifest says, empty without one. real: measured, not
    synthesised.
    """

    name: str
    subject: str
    motion: str
    split: str
    real: bool


@dataclass(frozen=True, slots=True, eq=False)
class Take(Capture):
    """A capture with its samples. rate: Hz. xyz: (N, 41, 3) metres in the world, in the order of
    `drivers.marker_set.MARKERS`, NaN where a sample is missing.
    """

    rate: float
    xyz: Floats


def captures(folder: Path, split: str | None = None) -> list[Capture]:
    """The captures of a folder, sorted by name; with `split` only those that its manifest puts
    there.

    Who performed is what the manifest says, else what the file's name tells. Raises UsageError
    where there is no manifest or it has no such split.
    """
    rows = _rows(folder)
    if split is not None:
        splits = manifest_splits(folder)
        if split not in splits:
            known = f"its splits are: {', '.join(splits)}" if splits else f"no {MANIFEST} says so"
            raise UsageError(f"{folder} has no split '{split}' ({known})")
        rows = [row for row in rows if row.get("split") == split]
    return [
        Capture(
            name=row["file"],
            subject=row.get("subject") or subject_of(row["file"]) or UNKNOWN,
            motion=row.get("motion") or "",
            split=row.get("split") or "",
            real=(row.get("kind") or "real") == "real",
        )
        for row in rows
    ]


def training_captures(folder: Path) -> list[Capture]:
    """The captures to train on: the split `train` where the manifest has splits, else all."""
    splits = manifest_splits(folder)
    if splits and TRAIN not in splits:
        raise DatasetError(f"{folder}: its {MANIFEST} has splits, but none named '{TRAIN}'")
    return captures(folder, TRAIN if splits else None)


def read_take(folder: Path, capture: Capture) -> Take:
    """Reads one capture. Raises SourceError, naming the file, where it cannot be used."""
    clip = read_c3d(folder / capture.name)
    if not len(clip.xyz):
        raise SourceError(f"{folder / capture.name}: no frames")
    return Take(**asdict(capture), rate=clip.layout.rate, xyz=clip.xyz)


def stream(folder: Path, chosen: Iterable[Capture], warn: Warn) -> Iterator[Take]:
    """The captures one by one; those that cannot be used are left out, and `warn` is told."""
    for capture in chosen:
        try:
            take = read_take(folder, capture)
        except SourceError as error:
            warn(f"left out: {why_not(folder, capture, error)}")
        else:
            yield take


def why_not(folder: Path, capture: Capture, error: SourceError) -> str:
    """`FILE: WHY`, the file as the folder has it."""
    return f"{capture.name}: {str(error).removeprefix(f'{folder / capture.name}: ')}"


def load(folder: Path, split: str | None, warn: Warn) -> list[Take]:
    """All usable captures of a folder or of one of its splits.

    Raises as `captures` does, and DatasetError where no file is usable.
    """
    return _some(folder, stream(folder, captures(folder, split), warn))


def load_training(folder: Path, warn: Warn) -> list[Take]:
    """All usable captures to train on. Raises DatasetError where there are none."""
    return _some(folder, stream(folder, training_captures(folder), warn))


def manifest_splits(folder: Path) -> list[str]:
    """The splits that the folder's manifest knows; none without a manifest."""
    if not (folder / MANIFEST).is_file():
        return []
    return sorted({row.get("split") or "" for row in _rows(folder)} - {""})


def digest(folder: Path, used: Iterable[Capture]) -> str:
    """SHA-256 over the names and contents of the files used, in the order of their names."""
    total = hashlib.sha256()
    for name in sorted(capture.name for capture in used):
        content = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        total.update(f"{name}\0{content}\n".encode())
    return total.hexdigest()


def no_captures(folder: Path) -> DatasetError:
    """What is raised where a folder has nothing to work on."""
    return DatasetError(f"{folder} has no C3D file with all 41 markers")


def _some(folder: Path, found: Iterable[Take]) -> list[Take]:
    takes = list(found)
    if not takes:
        raise no_captures(folder)
    return takes


def _rows(folder: Path) -> Sequence[dict[str, str]]:
    """The manifest's rows, or one row with the name alone per C3D file; sorted by name."""
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder")
    path = folder / MANIFEST
    if not path.is_file():
        found = sorted(file for file in folder.rglob("*") if file.suffix.lower() == ".c3d")
        return [{"file": file.relative_to(folder).as_posix()} for file in found]
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path}: not a readable table ({error})") from error
    if not rows or any(not row.get("file") for row in rows):
        raise DatasetError(f"{path}: needs a column 'file' with a name in every row")
    twice = [name for name, count in Counter(row["file"] for row in rows).items() if count > 1]
    if twice:
        raise DatasetError(f"{path}: names {twice[0]} in more than one row")
    return sorted(rows, key=lambda row: row["file"])
