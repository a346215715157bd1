"""Marker positions as a table: one row a frame, comma separated."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path


def write_csv(
    path: Path, columns: Sequence[str], rows: Iterable[tuple[int, float, Sequence[float | str]]]
) -> None:
    """Writes a row each: frame index, seconds, and a value for each of `columns`, empty where it
    is NaN. Raises OSError where it cannot be written.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(("index", "t", *columns))
        for index, t, values in rows:
            file.write(f"{index},{t:.6f},{','.join(map(_cell, values))}\n")


def _cell(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.7g}" if value == value else ""
