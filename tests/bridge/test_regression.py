"""What a model says of one frame: networks and mixtures."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.imputation import ConditionalGaussian
from bridge.model import Model
from bridge.regression import MixtureRegression, NetworkRegression, features_of, regression_of
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.dataset import load_training
from training.poses import body_poses
from training.reference import ReferenceNetworks


@pytest.fixture(scope="module")
def poses(small_dir) -> Floats:
    """Every tenth pose of four captures, in the body frame, (N, 41, 3)."""
    return np.concatenate([body_poses(t.xyz) for t in load_training(small_dir, pytest.fail)])[::10]


def tracked(model: Model, pose: Floats) -> Floats:
    return pose[[MARKERS.index(label) for label in model.info.tracked]]


def test_a_model_gets_the_regression_of_its_kind(network_model, mixture_model) -> None:
    assert isinstance(regression_of(network_model, 0), NetworkRegression)
    mixture = regression_of(mixture_model, 10)
    assert isinstance(mixture, MixtureRegression)
    assert regression_of(network_model, 0).leaf() == 0


def test_features_are_all_tracked_but_a_lone_origin(network_model) -> None:
    info = network_model.info
    assert [info.tracked[row] for row in features_of(info)] == list(info.features)
    assert "C7" not in info.features


@pytest.mark.parametrize("missing", [[1], [6], [0, 4, 7]])
def test_a_network_guesses_as_the_reference_does_whatever_missing_rows_hold(
    network_model, poses, missing
) -> None:
    model = network_model
    reference = ReferenceNetworks(model.path)
    regression = NetworkRegression(model)
    present = np.ones(len(model.info.tracked), bool)
    present[missing] = False
    rows = [model.info.labels.index(label) for label in model.info.tracked]
    for pose in poses[:20]:
        markers = tracked(model, pose)
        zeroed = np.where(present[:, None], markers, np.float32(0))
        x = zeroed[features_of(model.info)].reshape(1, -1)
        z, sigma = reference.regress(x, present[None].astype(np.float32))
        for filler in (np.nan, 7.0):
            held = np.where(present[:, None], markers, np.float32(filler))
            guessed, deviation = regression.guess(held, present, 0.0)
            np.testing.assert_allclose(guessed, z.reshape(-1, 3)[rows], atol=1e-4)
            np.testing.assert_allclose(deviation, sigma[0], rtol=1e-3)


def test_a_network_estimates_with_all_markers_there(network_model, poses) -> None:
    model = network_model
    reference, regression = ReferenceNetworks(model.path), NetworkRegression(model)
    unworn = [model.info.labels.index(label) for label in model.info.unworn]
    for pose in poses[:20]:
        markers = tracked(model, pose)
        found, sigma = regression.estimate(markers)
        x = markers[features_of(model.info)].reshape(1, -1)
        z, expected = reference.regress(x, np.ones((1, len(markers)), np.float32))
        np.testing.assert_allclose(found, z.reshape(-1, 3), atol=1e-4)
        np.testing.assert_allclose(sigma, expected[0], rtol=1e-3)
        # It was trained on this capture: what it says is a pose, and near.
        assert np.sqrt(((found - pose)[unworn] ** 2).sum(axis=1).mean()) < 0.2


def test_a_mixture_guesses_by_its_gaussian_with_the_origin_at_zero(mixture_model, poses) -> None:
    info = mixture_model.info
    regression = MixtureRegression(mixture_model, info.history)
    gaussian = ConditionalGaussian(info.mean, info.covariance)
    features = features_of(info)
    origin = info.tracked.index("C7")
    present = np.ones(len(info.tracked), bool)
    present[[2, origin]] = False
    markers = np.where(present[:, None], tracked(mixture_model, poses[5]), np.float32(np.nan))
    guessed, sigma = regression.guess(markers, present, 0.02)
    expected = gaussian.fill(markers[features], present[features])
    np.testing.assert_array_equal(guessed[features], expected)
    assert not guessed[origin].any()
    assert (sigma >= 0.02 - 1e-6).all()
    missing = info.labels.index(info.tracked[2])
    variance = np.diag(gaussian.uncertainty(present[features])).reshape(-1, 3).mean(axis=1)[2]
    assert sigma[missing] ** 2 == pytest.approx(variance + 0.02**2, rel=1e-4)
    whole, _ = regression.guess(tracked(mixture_model, poses[5]), np.ones_like(present), 0.0)
    np.testing.assert_array_equal(whole[features], tracked(mixture_model, poses[5])[features])


def test_a_mixtures_sigma_grows_with_what_is_missing(mixture_model, poses) -> None:
    info = mixture_model.info
    regression = MixtureRegression(mixture_model, info.history)
    markers = tracked(mixture_model, poses[0])
    unworn = [info.labels.index(label) for label in info.unworn]
    present = np.ones(len(info.tracked), bool)
    before = regression.guess(markers, present, 0.0)[1][unworn]
    np.testing.assert_allclose(before, info.sigma, rtol=1e-5)
    for row in (0, 1, 5):
        present[row] = False
        after = regression.guess(markers, present, 0.0)[1][unworn]
        assert (after >= before - 1e-7).all()
        assert after.mean() > before.mean()
        before = after


@pytest.mark.parametrize(("rate", "frames"), [(120.0, 10), (60.0, 5), (240.0, 20)])
def test_the_history_is_a_time_not_a_number_of_frames(mixture_model, poses, rate, frames) -> None:
    """After a sudden change of pose the estimate moves for as long as the history is."""
    regression = MixtureRegression(mixture_model, 10)
    leaves = []
    for pose in poses:
        regression.estimate(tracked(mixture_model, pose))
        leaves.append(regression.leaf())
    one = tracked(mixture_model, poses[0])
    other = tracked(mixture_model, poses[int(np.flatnonzero(np.array(leaves) != leaves[0])[0])])
    regression.reset(rate)
    for _ in range(2 * frames):
        regression.estimate(one)
    after = np.array([regression.estimate(other)[0] for _ in range(2 * frames)])
    moving = np.abs(np.diff(after, axis=0)).max(axis=(1, 2)) > 1e-6
    assert moving[:frames].all()
    assert not moving[frames:].any()
