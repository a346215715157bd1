"""What all tests share: the folder of real captures."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.setdefault("MARKERBRIDGE_DATA", str(ROOT.parent / "shared" / "data")))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder with manifest.csv; a test without it says so and is skipped, in CI it fails."""
    if not (DATA / "manifest.csv").is_file():
        message = f"no captures at {DATA}: set MARKERBRIDGE_DATA to a folder with manifest.csv"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return DATA
