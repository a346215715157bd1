"""Adapts a model to one person, from some seconds of all their markers (docs/decisions/0012).

What the model is off by in the frames that have all markers is fitted by ridge regression, and
joins the last linear map of the graph: the file keeps its form, and a frame costs what it did.

Networks: the units of the last hidden layer and a constant tell what they are off by. Mixtures:
the weights of the leaves sum to 1, so that an affine map of the features, added to the maps of all
leaves, is added to the estimate.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper

from bridge.body_frame import CONSTRUCTIONS
from bridge.estimator import body_frame
from bridge.humanoid.body import measured
from bridge.model import METADATA_KEY, Model
from bridge.regression import features_of, regression_of
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.dataset import DatasetError
from training.local_models import Array, NormalEquations, affine, ridge
from training.network import Network
from training.networks import POSE
from training.poses import moving_poses

# Chosen on people left out (docs/decisions/0012).
SHARE = 0.01  # of the power of the hidden units and of the constant: what holds them back
NOISE = 0.1  # m: what holds the map of a mixture back
MAX_FRAMES = 600  # that networks and proportions are told by: of more, some are taken evenly
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
        changed = _networks(model, constants, _seen(model, xyz, rate), complete.sum() / rate)
    for entry in file.graph.initializer:
        if entry.name in changed:
            values = changed[entry.name].astype(np.float32)
            entry.CopyFrom(numpy_helper.from_array(values, entry.name))
    record = model.info.training | {
        "calibrated_frames": int(complete.sum()),
        "calibrated_seconds": round(float(complete.sum() / rate), 2),
    }
    whole = _some(xyz[complete][:, [MARKERS.index(label) for label in model.info.labels]])
    build = measured(model.info.labels, whole).values.round(4).tolist()
    info = replace(model.info, training=record, proportions=build)
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


def _networks(model: Model, constants: Constants, seen: _Seen, seconds: float) -> Constants:
    """The last layers of the networks for the pose and for its velocities, changed. seconds: of
    all complete frames.
    """
    units, off = _pose_errors(model, constants, seen)
    changed = _changed(constants, "pose", _correction(units, off))
    changed["pose_last_bias"][POSE:] += np.log(_sigma_factor(model, units, off, seconds))
    moving = _correction(*_velocity_errors(model, constants, seen))
    return changed | _changed(constants, "velocity", moving)


def _changed(constants: Constants, name: str, change: Array) -> Constants:
    """A network's last layer with a change (H + 1, 123) of what the hidden units and the constant
    add to its first outputs.
    """
    weights, bias = (constants[f"{name}_last_{part}"].copy() for part in ("weights", "bias"))
    weights[: len(change) - 1, :POSE] += change[:-1]
    bias[:POSE] += change[-1]
    return {f"{name}_last_weights": weights, f"{name}_last_bias": bias}


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Complete frames, in the body frame: the tracked markers (n, T, 3), metres, and their
    velocities, m/s; all markers (n, 123), in the model's order, and theirs.
    """

    tracked: Floats
    moving: Floats
    poses: Floats
    velocities: Floats


def _seen(model: Model, xyz: Floats, rate: float) -> _Seen:
    """Of the complete frames at most MAX_FRAMES, evenly."""
    info = model.info
    construction = CONSTRUCTIONS[info.body_frame]
    every = moving_poses(xyz, rate, construction)
    poses, velocities = _some(every.poses), _some(every.velocities)
    origin = [MARKERS.index(label) for label in construction.origin]
    velocities = velocities - velocities[:, origin].mean(axis=1, keepdims=True)
    tracked = [MARKERS.index(label) for label in info.tracked]
    order = [MARKERS.index(label) for label in info.labels]
    return _Seen(
        poses[:, tracked],
        velocities[:, tracked],
        poses[:, order].reshape(len(poses), -1),
        velocities[:, order].reshape(len(poses), -1),
    )


def _some(frames: Floats) -> Floats:
    """At most MAX_FRAMES, evenly."""
    at = np.linspace(0, len(frames) - 1, min(len(frames), MAX_FRAMES))
    found: Floats = frames[at.round().astype(int)]
    return found


def _pose_errors(model: Model, constants: Constants, seen: _Seen) -> tuple[Array, Array]:
    """The last hidden units and a one (n, H + 1), and what the pose is off by (n, 123), metres."""
    still = np.zeros_like(seen.moving[0])
    told = np.array([model.estimate(tracked, still)[0] for tracked in seen.tracked])
    units = _units(constants, "pose", _scaled(constants, seen))
    return units, seen.poses.astype(float) - told.reshape(len(told), -1)


def _velocity_errors(model: Model, constants: Constants, seen: _Seen) -> tuple[Array, Array]:
    """The same of the velocities, in the body's speed; faster frames count more, as in training."""
    frames = zip(seen.tracked, seen.moving, strict=True)
    told = np.array([model.estimate(tracked, moving)[2] for tracked, moving in frames])
    moving = seen.moving.reshape(len(told), -1)
    speed = np.sqrt((moving**2).mean(axis=1, keepdims=True) + constants["slow"])
    inputs = np.hstack([_scaled(constants, seen), moving / speed])
    off = (seen.velocities.astype(float) - told.reshape(len(told), -1)) / speed
    weight = np.sqrt(speed / speed.mean())
    return _units(constants, "velocity", inputs) * weight, off * weight


def _scaled(constants: Constants, seen: _Seen) -> Floats:
    u: Floats = seen.tracked.reshape(len(seen.tracked), -1) - constants["mean"]
    return u * constants["unit"]


def _units(constants: Constants, name: str, inputs: Floats) -> Array:
    """The last hidden units of a network, and a one (n, H + 1)."""
    layers: list[Floats] = []
    while (at := f"{name}_{len(layers) // 2}") + "_weights" in constants:
        layers += [constants[f"{at}_weights"], constants[f"{at}_bias"]]
    last = [constants[f"{name}_last_weights"], constants[f"{name}_last_bias"]]
    hidden = Network([*layers, *last]).hidden(inputs)
    return np.hstack([hidden, np.ones((len(inputs), 1))]).astype(float)


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
