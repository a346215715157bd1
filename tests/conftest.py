"""What all tests share: the folder of real captures, and a small one."""

from __future__ import annotations

import csv
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bridge.body_frame import SIX_FRAME
from bridge.model import Model
from training.corpus import read_corpus
from training.dataset import training_captures
from training.export import to_onnx
from training.forest import ForestOptions
from training.network import NetworkOptions
from training.pipeline import fit_model
from training.recipe import MixtureRecipe, NetworkRecipe

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


PAPER_SIX = ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")


def _fitted(small_dir: Path, path: Path, recipe: MixtureRecipe | NetworkRecipe) -> Model:
    """A model of the paper's markers, trained here on four captures: quick, and no good.

    Its sigma is not measured on folds, but made up.
    """
    with threadpool_limits(1):
        captures = training_captures(small_dir)
        corpus = read_corpus(small_dir, captures, recipe, lambda *_: None, pytest.fail)
        fitted = fit_model(corpus, np.arange(len(corpus.frames)), PAPER_SIX, recipe, 0)
    sigma = np.linspace(0.01, 0.05, len(fitted.info.unworn)).tolist()
    path.write_bytes(to_onnx(fitted.graph, replace(fitted.info, sigma=sigma)))
    return Model(path)


_SMALL_NETWORK = NetworkOptions(hidden=(64, 64), steps=400, batch=256)
_SMALL_NETWORKS = NetworkRecipe(pose=_SMALL_NETWORK, velocity=_SMALL_NETWORK, recall=_SMALL_NETWORK)


@pytest.fixture(scope="session")
def network_model(small_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Model:
    """Small networks."""
    return _fitted(small_dir, tmp_path_factory.mktemp("network") / "network.onnx", _SMALL_NETWORKS)


@pytest.fixture(scope="session")
def six_model(small_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Model:
    """Small networks for those who wear no C7."""
    recipe = replace(_SMALL_NETWORKS, body_frame=SIX_FRAME.name)
    return _fitted(small_dir, tmp_path_factory.mktemp("six") / "six.onnx", recipe)


@pytest.fixture(scope="session")
def mixture_model(small_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Model:
    """A few local models, mixed by a small forest over the default history."""
    recipe = MixtureRecipe(plain=False, mirror=True, forest=ForestOptions(trees=10, leaf=10))
    return _fitted(small_dir, tmp_path_factory.mktemp("mixture") / "mixture.onnx", recipe)
