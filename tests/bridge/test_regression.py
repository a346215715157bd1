"""What a model says of one frame: networks and mixtures."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from bridge.body_frame import PAPER_FRAME
from bridge.imputation import ConditionalGaussian
from bridge.model import Model
from bridge.regression import (
    COAST,
    FADE,
    MixtureRegression,
    NetworkRegression,
    Sightings,
    features_of,
    regression_of,
)
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.dataset import load_training
from training.poses import MovingPoses, moving_poses
from training.reference import ReferenceNetworks

LACKING = [[1], [6], [0, 4, 7], [2, 3, 4, 5, 6, 8]]


@pytest.fixture(scope="module")
def takes(small_dir) -> list[MovingPoses]:
    """Four captures."""
    captures = load_training(small_dir, pytest.fail)
    return [moving_poses(take.xyz, take.rate, PAPER_FRAME) for take in captures]


@pytest.fixture(scope="module")
def poses(takes) -> Floats:
    """Every tenth pose of theirs, (N, 41, 3)."""
    return np.concatenate([take.poses for take in takes])[::10]


def tracked(model: Model, pose: Floats) -> Floats:
    """Of a pose, or of each (..., 41, 3)."""
    return pose[..., [MARKERS.index(label) for label in model.info.tracked], :]


def lacking(model: Model, missing: list[int]) -> np.ndarray:
    present = np.ones(len(model.info.tracked), bool)
    present[missing] = False
    return present


def sightings(model: Model, ages: list[float], seed: int = 0) -> Sightings:
    """Of a body that has gone on meanwhile, a metre or so."""
    random, count = np.random.default_rng(seed), len(ages)
    shape = count, len(model.info.tracked), 3
    then = random.normal(0, 0.5, shape)
    return Sightings(
        then=then.astype(np.float32),
        left=(then + random.normal(0, 0.5, (count, 1, 3))).astype(np.float32),
        pace=random.normal(0, 1.0, shape).astype(np.float32),
        age=np.array(ages),
    )


def one_of(several: Sightings, row: int) -> Sightings:
    return Sightings(*(getattr(several, part.name)[row : row + 1] for part in fields(several)))


def test_a_model_gets_the_regression_of_its_kind(network_model, mixture_model) -> None:
    assert isinstance(regression_of(network_model, 0), NetworkRegression)
    mixture = regression_of(mixture_model, 10)
    assert isinstance(mixture, MixtureRegression)
    assert regression_of(network_model, 0).leaf() == 0


def test_features_are_all_tracked_but_a_lone_origin(network_model) -> None:
    info = network_model.info
    assert [info.tracked[row] for row in features_of(info)] == list(info.features)
    assert "C7" not in info.features


@pytest.mark.parametrize("missing", LACKING)
def test_networks_recall_as_the_reference_does_whatever_missing_rows_hold(
    network_model, poses, missing
) -> None:
    model, reference = network_model, ReferenceNetworks(network_model.path)
    regression, present = NetworkRegression(model), lacking(network_model, missing)
    ages = list(np.geomspace(0.008, 1e6, len(missing) + 4))
    for seed, pose in enumerate(poses[:10]):
        markers, seen = tracked(model, pose), sightings(model, ages, seed)
        count = len(ages)
        shown = np.where(present[:, None], markers, np.float32(0)).reshape(1, -1)
        memory = np.hstack(
            [part.reshape(count, -1) for part in (seen.then, seen.left, seen.pace, seen.age)]
        )
        expected, sigma = reference.recall(
            np.repeat(shown, count, 0), np.repeat(present[None], count, 0), memory
        )
        for filler in (np.nan, 7.0):
            held = np.where(present[:, None], markers, np.float32(filler))
            found, deviation = regression.recall(held, present, seen, 0.0)
            assert found.shape == (count, len(markers), 3)
            np.testing.assert_allclose(found, expected, atol=1e-4)
            np.testing.assert_allclose(deviation, sigma, rtol=1e-3)


@pytest.mark.parametrize("kind", ["network", "mixture"])
def test_several_sightings_at_once_are_as_one_by_one(kind, request, poses) -> None:
    model = request.getfixturevalue(f"{kind}_model")
    regression, present = regression_of(model, 10), lacking(model, [0, 3, 7])
    seen = sightings(model, [0.01, 0.2, 3.0])
    markers = np.where(present[:, None], tracked(model, poses[3]), np.float32(np.nan))
    together = regression.recall(markers, present, seen, 0.01)
    assert np.isfinite(together[0]).all()
    for row in range(3):
        alone = regression.recall(markers, present, one_of(seen, row), 0.01)
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_[row], atol=1e-6)


def recalled(
    model: Model, take: MovingPoses, missing: int, frames: int, rate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors (n, 3), metres, and sigma (n,), of a marker that is missing for so many frames, by the
    network and (n, 3) by leaving it where it was in the body.
    """
    regression, present = NetworkRegression(model), lacking(model, [missing])
    markers, pace = tracked(model, take.poses), tracked(model, take.velocities)
    errors, sigma, stayed = [], [], []
    for now in range(frames, len(markers), 5):
        then = now - frames
        cos, sin = np.cos(take.yaw[[then, now]]), np.sin(take.yaw[[then, now]])
        # Columns: the body's axes in the world.
        axes = [np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) for c, s in zip(cos, sin, strict=True)]
        world = markers[then] @ axes[0].T + take.origin[then]
        seen = Sightings(
            then=markers[then][None],
            left=((world - take.origin[now]) @ axes[1])[None].astype(np.float32),
            pace=(pace[then] @ axes[0].T @ axes[1])[None].astype(np.float32),
            age=np.array([frames / rate]),
        )
        found, deviation = regression.recall(markers[now], present, seen, 0.0)
        errors.append(found[0, missing] - markers[now, missing])
        sigma.append(deviation[0, missing])
        stayed.append(markers[then, missing] - markers[now, missing])
    return np.array(errors), np.array(sigma), np.array(stayed)


def root_mean_square(errors: np.ndarray) -> float:
    return float(np.sqrt((errors.astype(float) ** 2).mean()))


def test_networks_know_where_a_marker_is_that_just_went_and_know_less_later(
    network_model, takes
) -> None:
    """On what they were trained on, over all tracked markers but the lone origin."""
    take = takes[0]
    features = features_of(network_model.info)
    told = []
    for frames in (2, 12, 60):
        parts = [recalled(network_model, take, row, frames, 120.0) for row in features]
        errors, sigma, stayed = (np.array(part) for part in zip(*parts, strict=True))
        assert root_mean_square(errors) < root_mean_square(stayed)
        told.append((root_mean_square(errors), root_mean_square(sigma)))
    assert told[0][0] < 0.01
    assert told[0][0] < told[1][0] < told[2][0] < 0.2
    assert told[0][1] < told[1][1] < told[2][1]


def test_networks_estimate_as_the_reference_does(network_model, takes) -> None:
    model, take = network_model, takes[0]
    reference, regression = ReferenceNetworks(model.path), NetworkRegression(model)
    unworn = [model.info.labels.index(label) for label in model.info.unworn]
    off, moving = [], []
    for pose, velocity in zip(take.poses[::10], take.velocities[::10], strict=True):
        velocity = velocity - velocity[MARKERS.index("C7")]
        markers, going = tracked(model, pose), tracked(model, velocity)
        found, sigma, velocities = regression.estimate(markers, going)
        assert velocities is not None
        expected = reference.estimate(markers, going)
        np.testing.assert_allclose(found, expected[0], atol=1e-4)
        np.testing.assert_allclose(sigma, expected[1], rtol=1e-3)
        np.testing.assert_allclose(velocities, expected[2], atol=1e-3)
        off.append((found - pose)[unworn])
        moving.append(((velocities - velocity)[unworn], velocity[unworn]))
    # They were trained on this capture: what they say is a pose, and near, and how it moves.
    assert root_mean_square(np.array(off)) < 0.1
    errors, truth = (np.array(part) for part in zip(*moving, strict=True))
    assert root_mean_square(errors) < 0.5 * root_mean_square(truth)


def test_a_mixture_recalls_a_marker_where_it_was_last_and_then_where_the_others_tell(
    mixture_model, poses
) -> None:
    """From one to the other; at first it goes on through the world at its pace."""
    info = mixture_model.info
    regression = MixtureRegression(mixture_model, info.history)
    gaussian = ConditionalGaussian(info.mean, info.covariance)
    features, row, feature = features_of(info), 2, 2
    assert features[feature] == row
    present = lacking(mixture_model, [row])
    now = tracked(mixture_model, poses[5])

    def at(age: float) -> tuple[np.ndarray, float, Sightings]:
        seen = sightings(mixture_model, [age])
        found, sigma = regression.recall(now, present, seen, 0.0)
        return found[0, row], float(sigma[0, row]), seen

    told = gaussian.fill(now[features], present[features])[feature]
    variance = np.diag(gaussian.uncertainty(present[features])).reshape(-1, 3).mean(axis=1)[feature]
    # Where it was in the world, if everything else is as it was as well.
    seen = at(1e-6)[2]
    same = Sightings(np.tile(now, (1, 1, 1)), seen.left, seen.pace, seen.age)
    found, sigma = regression.recall(now, present, same, 0.0)
    np.testing.assert_allclose(found[0, row], seen.left[0, row], atol=1e-5)
    assert sigma[0, row] < 0.01 * np.sqrt(variance)
    age = 0.2 * COAST
    gone_on = Sightings(same.then, same.left, same.pace, np.array([age]))
    found, _ = regression.recall(now, present, gone_on, 0.0)
    expected = seen.left[0, row] + seen.pace[0, row] * age
    np.testing.assert_allclose(
        found[0, row], told + np.exp(-age / FADE) * (expected - told), atol=2e-3
    )
    # Whatever it was, after long: what the others tell.
    for long in (20 * FADE, 1e6):
        found, sigma, _ = at(long)
        np.testing.assert_allclose(found, told, atol=1e-5)
        assert sigma == pytest.approx(np.sqrt(variance), rel=1e-5)
    sigmas = [at(age)[1] for age in np.geomspace(0.001, 100, 30)]
    assert (np.diff(sigmas) >= 0).all()


def test_a_mixtures_sigma_counts_where_the_body_frame_is_and_what_is_missing(
    mixture_model, poses
) -> None:
    info = mixture_model.info
    regression = MixtureRegression(mixture_model, info.history)
    now, seen = tracked(mixture_model, poses[0]), sightings(mixture_model, [0.3])
    before = 0.0
    for missing in ([0], [0, 1], [0, 1, 5], [0, 1, 5, 6]):
        present = lacking(mixture_model, missing)
        found, sigma = regression.recall(now, present, seen, 0.0)
        placed, worse = regression.recall(now, present, seen, 0.02)
        np.testing.assert_array_equal(found, placed)
        np.testing.assert_allclose(worse**2, sigma**2 + 0.02**2, rtol=1e-5)
        assert sigma[0, 0] >= before
        assert not sigma[0, present].any()
        before = sigma[0, 0]
    # The origin, where it is missing, is where the body frame is.
    origin = info.tracked.index("C7")
    present = lacking(mixture_model, [2, origin])
    now[~present] = np.nan
    later = sightings(mixture_model, [1e6])
    found, sigma = regression.recall(now, present, later, 0.02)
    np.testing.assert_allclose(found[0, origin], 0, atol=1e-6)
    assert sigma[0, origin] == pytest.approx(0.02)


def test_a_mixture_estimates_with_its_own_sigma_and_no_velocities(mixture_model, poses) -> None:
    info = mixture_model.info
    regression = MixtureRegression(mixture_model, 0)
    unworn = [info.labels.index(label) for label in info.unworn]
    markers = tracked(mixture_model, poses[0])
    pose, sigma, velocities = regression.estimate(markers, np.ones_like(markers))
    assert velocities is None
    np.testing.assert_allclose(sigma[unworn], info.sigma, rtol=1e-6)
    still, _, _ = regression.estimate(markers, np.zeros_like(markers))
    np.testing.assert_array_equal(pose, still)


@pytest.mark.parametrize(("rate", "frames"), [(120.0, 10), (60.0, 5), (240.0, 20)])
def test_the_history_is_a_time_not_a_number_of_frames(mixture_model, poses, rate, frames) -> None:
    """After a sudden change of pose the estimate moves for as long as the history is."""
    regression = MixtureRegression(mixture_model, 10)
    still = np.zeros((len(mixture_model.info.tracked), 3), np.float32)
    leaves = []
    for pose in poses:
        regression.estimate(tracked(mixture_model, pose), still)
        leaves.append(regression.leaf())
    one = tracked(mixture_model, poses[0])
    other = tracked(mixture_model, poses[int(np.flatnonzero(np.array(leaves) != leaves[0])[0])])
    regression.reset(rate)
    for _ in range(2 * frames):
        regression.estimate(one, still)
    after = np.array([regression.estimate(other, still)[0].copy() for _ in range(2 * frames)])
    moving = np.abs(np.diff(after, axis=0)).max(axis=(1, 2)) > 1e-6
    assert moving[:frames].all()
    assert not moving[frames:].any()
