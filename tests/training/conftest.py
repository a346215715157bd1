"""What the tests of training share: a small folder of real captures, and a model trained on it."""

from __future__ import annotations

import csv
import shutil

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bridge.model import ModelInfo
from drivers.marker_set import MARKERS
from training.dataset import load_training

PAPER_SIX = "LFHD,RELB,LUPA,RSHN,LTOE,RTOE"
SMALL = {
    "real/02_01.c3d": "train",
    "real/07_01.c3d": "train",
    "real/16_07.c3d": "train",
    "virtual/walking_t1.c3d": "train",
    "real/07_12.c3d": "test",
}


@pytest.fixture(scope="session", autouse=True)
def _single_thread():
    """As the commands do: the matrices are small, and threads wait for each other."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def small_dir(data_dir, tmp_path_factory):
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


@pytest.fixture(scope="session")
def train_takes(data_dir):
    """All takes of the training split."""
    return load_training(data_dir, pytest.fail)


@pytest.fixture(scope="session")
def minimal_info():
    """A description that is valid in itself; for graphs whose size the test chooses."""
    principal, references = ("LFHD",), ("C7", "LSHO", "RSHO")
    unworn = len(MARKERS) - 4
    return ModelInfo(
        estimator="local",
        labels=MARKERS,
        principal=principal,
        references=references,
        history=10,
        mean=np.zeros((3, 3)).tolist(),
        covariance=np.eye(9).tolist(),
        sigma=[0.01] * unworn,
        sensitivity=np.zeros((3 * unworn, 9)).tolist(),
    )
