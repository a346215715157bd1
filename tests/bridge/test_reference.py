"""The compiled hot path against the same in plain numpy, and against itself not compiled."""

from __future__ import annotations

from contextlib import ExitStack
from unittest.mock import patch

import numpy as np
import pytest

from bridge import body_frame, estimator, imputer, smoothing
from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.c3d_file import read_c3d
from drivers.frame import Floats, Layout, MarkerFrame
from tests.bridge.reference.estimator import PoseEstimator as Reference
from tests.bridge.reference.smoothing import NoiseFilter as ReferenceFilter

RATE = 120.0
KERNELS = [
    (smoothing, ("_listen", "_follow", "_slopes")),
    (body_frame, ("_place", "_fit_yaw", "_learn")),
    (imputer, ("_walk", "_tell", "_take_over")),
    (estimator, ("_into_body", "_into_world", "_doubt")),
]


@pytest.fixture(scope="module", params=["default", "six_model", "mixture_model"])
def model(request) -> Model:
    return (
        Model("default") if request.param == "default" else request.getfixturevalue(request.param)
    )


def tracked(data_dir, model: Model, name: str, count: int = 400) -> Floats:
    return read_c3d(data_dir / name, model.info.tracked).xyz[:count]


def spoilt(xyz: Floats, kind: str) -> Floats:
    """Markers (N, T, 3) as trackers have them."""
    random = np.random.default_rng(5)
    found = xyz.copy()
    if kind == "noise":
        found += 0.002 * random.normal(size=xyz.shape)
    elif kind == "drop":
        found[random.random(xyz.shape[:2]) < 0.2] = np.nan
    elif kind == "gaps":
        for marker in range(xyz.shape[1]):
            for start in random.integers(0, len(xyz), 4):
                found[start : start + random.integers(5, 60), marker] = np.nan
        found[250:270] = np.nan
    return found.astype(np.float32)


@pytest.mark.parametrize("kind", ["clean", "noise", "drop", "gaps"])
@pytest.mark.parametrize("name", ["real/02_01.c3d", "real/85_12.c3d"])
def test_poses_are_those_of_the_numpy_reference(data_dir, model, name, kind) -> None:
    layout, one, other = Layout(model.info.tracked, RATE), PoseEstimator(model), Reference(model)
    for index, xyz in enumerate(spoilt(tracked(data_dir, model, name), kind)):
        # Some frames are lost on the way, and once the device starts anew.
        if index % 41 == 40:
            continue
        number = index if index < 330 else index - 300
        frame = MarkerFrame(number, index / RATE, index / RATE, layout, xyz)
        found, expected = one.step(frame), other.step(frame)
        np.testing.assert_allclose(found.xyz, expected.xyz, atol=1e-4)
        np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-3, atol=1e-5)
        np.testing.assert_array_equal(found.provenance, expected.provenance)


def test_the_filter_is_that_of_the_numpy_reference(data_dir) -> None:
    clean = tracked(data_dir, Model("default"), "real/02_01.c3d").astype(float)
    random = np.random.default_rng(3)
    xyz = clean + random.choice([0.0, 0.001, 0.01], size=(len(clean), 1, 1)) * random.normal(
        size=clean.shape
    )
    xyz[random.random(xyz.shape[:2]) < 0.1] = np.nan
    one, other = smoothing.NoiseFilter(xyz.shape[1]), ReferenceFilter(xyz.shape[1])
    for frame in xyz:
        interval = random.choice([1.0, 1.0, 1.0, 2.0]) / RATE
        found, expected = one.update(frame, interval), other.update(frame, interval)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        np.testing.assert_allclose(one.velocity, other.velocity, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(one.noise, other.noise, rtol=1e-6)


def test_indices_stay_inside_their_arrays(data_dir) -> None:
    """Compiled code does not check them; the same as plain Python does."""
    model = Model("default")
    xyz = spoilt(tracked(data_dir, model, "real/02_01.c3d", 60), "drop")
    compiled = run(model, xyz)
    with ExitStack() as stack:
        for module, names in KERNELS:
            kernels = {name: getattr(module, name).py_func for name in names}
            stack.enter_context(patch.multiple(module, **kernels))
        np.testing.assert_allclose(run(model, xyz), compiled, atol=1e-5)


def run(model: Model, xyz: Floats) -> np.ndarray:
    layout, one = Layout(model.info.tracked, RATE), PoseEstimator(model)
    return np.array(
        [one.step(MarkerFrame(i, i / RATE, i / RATE, layout, row)).xyz for i, row in enumerate(xyz)]
    )
