"""Adapts a model to one person, from some seconds of all their markers (docs/decisions/0012).

What the model is off by in the frames that have all markers is fitted by ridge regression, and
joins the last linear map of the graph: the file keeps its form, and a frame costs what it did.

Networks: the units of the last hidden layer and a constant tell what they are off by. Mixtures:
the weights of the leaves sum to 1, so that an affine map of the features, added to the maps of all
leaves, is added to the estimate.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper

from bridge.estimator import body_frame
from bridge.model import METADATA_KEY, Model
from bridge.regression import features_of, regression_of
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.dataset import DatasetError
from training.local_models import Array, NormalEquations, affine, ridge
from training.network import Network
from training.networks import POSE

# Chosen on people left out (docs/decisions/0012).
SHARE = 0.003  # of the power of the hidden units and of the constant: what holds them back
NOISE = 0.1  # m: what holds the map of a mixture back
MAX_FRAMES = 600  # that networks are adapted to: of more, some are taken evenly
MIN_SECONDS = 0.25  # of frames with all markers
_FITTED = 2 / 3  # of the frames: how much sigma shrinks is told by the others
_SURE = 2.0  # s of recording that tell half of how much sigma shrinks
_LEAST = 0.5  # that sigma is multiplied by

Constants = dict[str, npt.NDArray[Any]]
Mask = npt.NDArray[np.bool_]


def adapted(model: Model, xyz: Floats, rate: float) -> Model:
    """The model for the person of a capture, as the runtime has it. See `calibrated`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "calibrated.onnx")
        path.write_bytes(calibrated(model, xyz, rate))
        return Model(path)


def calibrated(model: Model, xyz: Floats, rate: float) -> bytes:
    """The model file for the person of a capture (N, 41, 3): metres, world, as in MARKERS.

    Frames that lack a marker are left out. Raises DatasetError where those that have all are
    fewer than MIN_SECONDS of `rate`, Hz.
    """
    complete = np.asarray(~np.isnan(xyz).any(axis=(1, 2)))
    if complete.sum() < MIN_SECONDS * rate:
        raise DatasetError(
            f"calibration needs {MIN_SECONDS:g} s with all 41 markers, "
            f"there are {complete.sum() / rate:.2f} s"
        )
    file = onnx.load(str(model.path))
    constants = {entry.name: numpy_helper.to_array(entry) for entry in file.graph.initializer}
    if model.leaves:
        changed = _mixture(model, constants, xyz, complete, rate)
    else:
        changed = _networks(model, constants, xyz, complete, rate)
    for entry in file.graph.initializer:
        if entry.name in changed:
            values = changed[entry.name].astype(np.float32)
            entry.CopyFrom(numpy_helper.from_array(values, entry.name))
    record = model.info.training | {
        "calibrated_frames": int(complete.sum()),
        "calibrated_seconds": round(float(complete.sum() / rate), 2),
    }
    info = replace(model.info, training=record)
    for prop in file.metadata_props:
        if prop.key == METADATA_KEY:
            prop.value = info.to_json()
    content: bytes = file.SerializeToString(deterministic=True)
    return content


def _mixture(
    model: Model, constants: Constants, xyz: Floats, complete: Mask, rate: float
) -> Constants:
    """The maps and offsets of all leaves, changed."""
    x, off = _mixture_errors(model, xyz, complete, rate)
    correction = ridge(NormalEquations.of(affine(x), off), NOISE)
    maps, offsets = constants["maps"], constants["offsets"]  # (D, K * U), (K, U)
    leaves = maps.reshape(x.shape[1], model.leaves, -1) + correction[:, None, :-1].T
    return {"maps": leaves.reshape(maps.shape), "offsets": offsets + correction[:, -1]}


def _mixture_errors(model: Model, xyz: Floats, complete: Mask, rate: float) -> tuple[Floats, Array]:
    """What the graph takes (n, D) in the complete frames, and what it is off by (n, 3U), metres."""
    info = model.info
    tracked = [MARKERS.index(label) for label in info.tracked]
    unworn = [MARKERS.index(label) for label in info.unworn]
    rows = [info.labels.index(label) for label in info.unworn]
    features = features_of(info)
    body, regression = body_frame(info), regression_of(model, info.history)
    regression.reset(rate)
    inputs, errors = [], []
    for truth, whole in zip(xyz, complete, strict=True):
        body.update(truth[tracked])
        seen = body.to_body(truth)
        if np.isnan(seen[tracked]).any():
            continue
        pose, *_ = regression.estimate(seen[tracked], np.zeros_like(seen[tracked]))
        if whole:
            inputs.append(seen[tracked][features].ravel()[: model.width])
            errors.append((seen[unworn].astype(float) - pose[rows]).ravel())
    return np.array(inputs, np.float32), np.array(errors)


def _networks(
    model: Model, constants: Constants, xyz: Floats, complete: Mask, rate: float
) -> Constants:
    """The last layer of the pose's network, changed."""
    units, off = _network_errors(model, constants, xyz, complete)
    change = _correction(units, off)
    weights, bias = constants["pose_last_weights"].copy(), constants["pose_last_bias"].copy()
    weights[: units.shape[1] - 1, :POSE] += change[:-1]
    bias[:POSE] += change[-1]
    bias[POSE:] += np.log(_sigma_factor(model, units, off, complete.sum() / rate))
    return {"pose_last_weights": weights, "pose_last_bias": bias}


def _network_errors(
    model: Model, constants: Constants, xyz: Floats, complete: Mask
) -> tuple[Array, Array]:
    """The last hidden units and a one (n, H + 1) in complete frames, at most MAX_FRAMES, and what
    the network is off by (n, 123), metres.
    """
    info = model.info
    tracked = [MARKERS.index(label) for label in info.tracked]
    order = [MARKERS.index(label) for label in info.labels]
    chosen = np.flatnonzero(complete)
    some = np.linspace(0, len(chosen) - 1, min(len(chosen), MAX_FRAMES)).round().astype(int)
    taken = set(chosen[some].tolist())
    body = body_frame(info)
    shown, errors = [], []
    for index, truth in enumerate(xyz):
        body.update(truth[tracked])
        if index in taken:
            seen = body.to_body(truth)
            pose, *_ = model.estimate(seen[tracked], np.zeros_like(seen[tracked]))
            shown.append(seen[tracked].ravel())
            errors.append((seen[order].astype(float) - pose).ravel())
    layers: list[Floats] = []
    while (at := f"pose_{len(layers) // 2}") + "_weights" in constants:
        layers += [constants[f"{at}_weights"], constants[f"{at}_bias"]]
    last = [constants["pose_last_weights"], constants["pose_last_bias"]]
    u = (np.array(shown) - constants["mean"]) * constants["unit"]
    hidden = Network([*layers, *last]).hidden(u)
    units = np.hstack([hidden, np.ones((len(u), 1))]).astype(float)
    return units, np.array(errors)


def _correction(units: Array, off: Array) -> Array:
    """(H + 1, O): the ridge map from units (n, H + 1), the last being a one, to off (n, O).

    Solved between the frames, which are fewer than the units may be.
    """
    power = np.append(np.full(units.shape[1] - 1, (units[:, :-1] ** 2).sum(axis=1).mean()), 1.0)
    penalty = SHARE * len(units) * power
    scaled = units / penalty
    found: Array = scaled.T @ np.linalg.solve(scaled @ units.T + np.eye(len(units)), off)
    return found


def _sigma_factor(model: Model, units: Array, off: Array, seconds: float) -> float:
    """What sigma is to be multiplied by: as much as the error shrinks in the last frames, if fitted
    to the first alone; the less, the shorter the recording.
    """
    end = round(_FITTED * len(units))
    rows = np.array([model.info.labels.index(label) for label in model.info.unworn])
    columns = (3 * rows[:, None] + np.arange(3)).ravel()
    before = off[end:, columns]
    after = before - units[end:] @ _correction(units[:end], off[:end, columns])
    shrinks = float(np.sqrt((after**2).mean() / max((before**2).mean(), 1e-12)))
    return float(np.clip(shrinks, _LEAST, 1.0) ** (seconds / (seconds + _SURE)))
