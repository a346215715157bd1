"""A model of small networks, trained for a moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bridge.body_frame import PAPER_FRAME
from bridge.model import Model, ModelInfo
from drivers.marker_set import MARKERS
from training.examples import ExampleOptions
from training.export import to_onnx
from training.network import NetworkOptions
from training.network_fitting import WHOLE, train_regressor
from training.poses import body_poses
from training.recipe import NetworkRecipe
from training.regressor import Networks

SIX = ("LWRB", "RWRB", "RBWT", "LANK", "RSHN", "RANK")


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
