"""Adapts a model to one person, from a few seconds of all their markers.

The mixture's weights sum to 1, so one affine map added to the maps of all leaves is that map added
to the estimate: what the model is off by, as far as the tracked markers tell it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import onnx
from onnx import numpy_helper

from bridge.estimator import PoseEstimator, body_frame
from bridge.model import METADATA_KEY, Model
from drivers.frame import Floats, Layout, MarkerFrame
from drivers.marker_set import MARKERS
from training.dataset import DatasetError
from training.local_models import Array, NormalEquations, affine, ridge

NOISE = 0.1  # m: what holds the map back; chosen on people left out (docs/decisions/0012)
MIN_FRAMES = 30


def calibrated(model: Model, xyz: Floats, rate: float) -> bytes:
    """The model file for the person of a capture (N, 41, 3): metres, world, as in MARKERS.

    Frames that lack a marker are left out. Raises DatasetError where fewer than MIN_FRAMES have
    all.
    """
    x, residual = _residuals(model, xyz, rate)
    if len(x) < MIN_FRAMES:
        raise DatasetError(
            f"calibration needs {MIN_FRAMES} frames with all 41 markers, there are {len(x)}"
        )
    correction = ridge(NormalEquations.of(affine(x), residual), NOISE)
    file = onnx.load(str(model.path))
    for entry in file.graph.initializer:
        values = numpy_helper.to_array(entry)
        if entry.name == "maps":  # (D, K * U)
            leaves = values.reshape(x.shape[1], model.leaves, -1)
            shifted = (leaves + correction[:, None, :-1].T).reshape(values.shape)
        elif entry.name == "offsets":  # (K, U)
            shifted = values + correction[:, -1]
        else:
            continue
        entry.CopyFrom(numpy_helper.from_array(shifted.astype(np.float32), entry.name))
    record = model.info.training | {"calibrated_frames": len(x)}
    info = replace(model.info, training=record)
    for prop in file.metadata_props:
        if prop.key == METADATA_KEY:
            prop.value = info.to_json()
    content: bytes = file.SerializeToString(deterministic=True)
    return content


def _residuals(model: Model, xyz: Floats, rate: float) -> tuple[Floats, Array]:
    """What the graph takes (n, D) in the complete frames, and what it is off by (n, 3U), metres."""
    info = model.info
    tracked, features, unworn = (
        [MARKERS.index(label) for label in labels]
        for labels in (info.tracked, info.features, info.unworn)
    )
    rows = [info.labels.index(label) for label in info.unworn]
    layout = Layout(info.tracked, rate)
    estimator, body = PoseEstimator(model), body_frame(info)
    inputs, residuals = [], []
    for index, truth in enumerate(xyz):
        t = index / rate
        pose = estimator.step(MarkerFrame(index, t, t, layout, truth[tracked]))
        body.update(truth[tracked])
        if not np.isnan(truth).any():
            off = truth[unworn].astype(float) - pose.xyz[rows]
            inputs.append(body.to_body(truth[features]).ravel()[: model.width])
            residuals.append((off @ body.rotation).ravel())
    return np.array(inputs, np.float32).reshape(-1, model.width), np.array(residuals)
