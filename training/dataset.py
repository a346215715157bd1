"""Folders of C3D files, with or without a manifest, as sequences to train and evaluate on."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.c3d_file import read_c3d
from drivers.errors import MarkerbridgeError, UsageError
from drivers.frame import Floats, SourceError

MANIFEST = "manifest.csv"
TRAIN = "train"
TEST = "test"
UNKNOWN = "unknown"  # the manifest's word for a performer nobody can name


class DatasetError(MarkerbridgeError):
    """A folder holds nothing to work on; the message names it and says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """One capture of one performer.

    name: the file, relative to the folder. real: measured, not synthesised. split: `train`, `test`
    or whatever the manifest says, empty without one. rate: Hz. xyz: (N, 41, 3) metres in the world,
    in the order of `drivers.marker_set.MARKERS`, NaN where a sample is missing.
    """

    name: str
    subject: str
    motion: str
    split: str
    real: bool
    rate: float
    xyz: Floats


def load(folder: Path, split: str | None, warn: Callable[[str], None]) -> list[Take]:
    """The takes of a folder, sorted by name; with `split` only those that its manifest puts there.

    A file that cannot be used is left out, and `warn` is told its name and why. Raises UsageError
    where there is no manifest or it has no such split, DatasetError where no file is usable.
    """
    rows = _rows(folder)
    if split is not None:
        splits = manifest_splits(folder)
        if split not in splits:
            known = f"its splits are: {', '.join(splits)}" if splits else f"no {MANIFEST} says so"
            raise UsageError(f"{folder} has no split '{split}' ({known})")
        rows = [row for row in rows if row.get("split") == split]
    takes = []
    for row in rows:
        name = row["file"]
        try:
            clip = read_c3d(folder / name)
        except SourceError as error:
            warn(f"left out: {error}")
            continue
        if not len(clip.xyz):
            warn(f"left out: {folder / name}: no frames")
            continue
        takes.append(
            Take(
                name=name,
                subject=row.get("subject") or UNKNOWN,
                motion=row.get("motion") or "",
                split=row.get("split") or "",
                real=(row.get("kind") or "real") == "real",
                rate=clip.layout.rate,
                xyz=clip.xyz,
            )
        )
    if not takes:
        raise DatasetError(f"{folder} has no C3D file with all 41 markers")
    return takes


def load_training(folder: Path, warn: Callable[[str], None]) -> list[Take]:
    """The takes to train on: the split `train` where the manifest has splits, else all files."""
    splits = manifest_splits(folder)
    if splits and TRAIN not in splits:
        raise DatasetError(f"{folder}: its {MANIFEST} has splits, but none named '{TRAIN}'")
    return load(folder, TRAIN if splits else None, warn)


def manifest_splits(folder: Path) -> list[str]:
    """The splits that the folder's manifest knows; none without a manifest."""
    if not (folder / MANIFEST).is_file():
        return []
    return sorted({row.get("split") or "" for row in _rows(folder)} - {""})


def digest(folder: Path, takes: Iterable[Take]) -> str:
    """SHA-256 over the names and contents of the files used, in the order of their names."""
    total = hashlib.sha256()
    for name in sorted(take.name for take in takes):
        content = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        total.update(f"{name}\0{content}\n".encode())
    return total.hexdigest()


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
    return sorted(rows, key=lambda row: row["file"])
