"""What all tests share: the folder of real captures, and a small one."""

from __future__ import annotations

import csv
import os
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.setdefault("MARKERBRIDGE_DATA", str(ROOT.parent / "shared" / "data")))

SMALL = {
    "real/02_01.c3d": "train",
    "real/07_01.c3d": "train",
    "real/16_07.c3d": "train",
    "virtual/walking_t1.c3d": "train",
    "real/07_12.c3d": "test",
}


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with manifest.csv; a test without it says so and is skipped, in CI it fails."""
    if not (DATA / "manifest.csv").is_file():
        message = f"no captures at {DATA}: set MARKERBRIDGE_DATA to a folder with manifest.csv"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return DATA


@pytest.fixture(scope="session")
def small_dir(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the data folder is, but with five files."""
    folder = tmp_path_factory.mktemp("small")
    with (data_dir / "manifest.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["file"] in SMALL]
    assert {row["file"]: row["split"] for row in rows} == SMALL
    with (folder / "manifest.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, fieldnames=list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    for name in SMALL:
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(data_dir / name, folder / name)
    return folder
