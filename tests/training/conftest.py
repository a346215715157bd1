"""What the tests of training share."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bridge.model import ModelInfo
from drivers.marker_set import MARKERS
from training.dataset import load_training

PAPER_SIX = "LFHD,RELB,LUPA,RSHN,LTOE,RTOE"


@pytest.fixture(scope="session", autouse=True)
def _single_thread():
    """As the commands do: the matrices are small, and threads wait for each other."""
    with threadpool_limits(1):
        yield


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
