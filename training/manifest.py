"""A folder's manifest.csv, added to without losing what others wrote there."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

from drivers.errors import MarkerbridgeError
from drivers.files import whole_file
from training.dataset import MANIFEST

Rows = dict[str, dict[str, str]]  # by the column `file`


def read_rows(folder: Path) -> Rows:
    """The rows of the folder's manifest by their file, in its order; none where it has none.

    Raises MarkerbridgeError for a table that could not be written again as it is.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = list(csv.DictReader(file, restval=""))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise MarkerbridgeError(f"{path}: not a readable table ({error})") from error
    rows = {row.get("file", ""): row for row in table}
    if "" in rows or len(rows) < len(table) or any(None in row for row in table):
        raise MarkerbridgeError(
            f"{path}: needs a column 'file' with one name in every row, each once, and no more "
            "cells than columns: mend it, or move it away"
        )
    return rows


def write_rows(folder: Path, there: Rows, new: Iterable[dict[str, str]]) -> None:
    """Writes the manifest: the rows `there` and the `new` ones, sorted by file.

    All columns are kept. Where a file is in both, what is there stays and empty cells are filled.
    """
    rows = dict(there)
    for row in new:
        old = {column: cell for column, cell in rows.get(row["file"], {}).items() if cell}
        rows[row["file"]] = row | old
    columns = dict.fromkeys(column for row in (*there.values(), *rows.values()) for column in row)
    with (
        whole_file(folder / MANIFEST) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        table = csv.DictWriter(file, list(columns), restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(rows[name] for name in sorted(rows))
