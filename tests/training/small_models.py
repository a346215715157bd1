"""Small models of either kind, trained for a moment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge.body_frame import PAPER_FRAME
from bridge.model import Model, ModelInfo
from drivers.marker_set import MARKERS
from training.corpus import read_corpus
from training.dataset import training_captures
from training.examples import ExampleOptions
from training.export import to_onnx
from training.forest import ForestOptions
from training.network import NetworkOptions
from training.network_fitting import WHOLE, train_regressor
from training.pipeline import fit_model
from training.poses import body_poses
from training.recipe import RECIPES, NetworkRecipe
from training.regressor import Networks
from training.workers import workers

FOREST = ForestOptions(trees=3, leaf=10)
SIX = ("LWRB", "RWRB", "RBWT", "LANK", "RSHN", "RANK")


def small_mixture(path: Path, folder: Path, stranger: str) -> Model:
    """Writes a mixture of local models, from the training captures of a folder but for those of
    one performer.
    """
    recipe = replace(RECIPES["local"], forest=FOREST)
    captures = [one for one in training_captures(folder) if one.subject != stranger]
    with workers(None):
        corpus = read_corpus(folder, captures, recipe, lambda *_: None, pytest.fail)
        fitted = fit_model(corpus, np.arange(len(corpus.frames)), SIX, recipe, 0)
    path.write_bytes(to_onnx(fitted.graph, fitted.info))
    return Model(path)


def small_networks(path: Path, captures: list[np.ndarray]) -> Model:
    """Writes the model of two small members, from captures (N, 41, 3) in the world."""
    poses = [body_poses(xyz)[::4] for xyz in captures]
    capture = np.repeat(np.arange(len(poses)), [len(rows) for rows in poses])
    stacked = np.concatenate(poses)
    recipe = NetworkRecipe(
        network=NetworkOptions(hidden=(24, 24), steps=60, batch=128),
        examples=ExampleOptions(),
        members=2,
    )
    tracked = (*SIX, *PAPER_FRAME.references)
    features = PAPER_FRAME.features(tracked)
    whole, part = (
        train_regressor(
            stacked, capture, np.ones(len(stacked), bool), tracked, PAPER_FRAME, recipe, 0, share
        )
        for share in (1.0, WHOLE)
    )
    rows = stacked[:, [MARKERS.index(label) for label in features]].reshape(len(stacked), -1)
    info = ModelInfo(
        estimator="best",
        labels=MARKERS,
        principal=SIX,
        references=PAPER_FRAME.references,
        history=0,
        mean=rows.mean(axis=0).reshape(-1, 3).tolist(),
        covariance=np.cov(rows.T).tolist(),
        sigma=[0.03] * (len(MARKERS) - len(tracked)),
        sensitivity=[],
    )
    path.write_bytes(to_onnx(Networks(whole, part), info))
    return Model(path)
