"""Networks learn from captures what no linear map and no standing still can tell."""

from dataclasses import replace

import numpy as np
import pytest

from bridge.body_frame import CONSTRUCTIONS
from bridge.estimator import influence
from drivers.marker_set import MARKERS
from tests.training.small_models import SIX, networks_recipe
from training.corpus import read_corpus
from training.dataset import training_captures
from training.examples import ExampleOptions, Examples
from training.network import NetworkOptions
from training.network_fitting import _Loss, _poses, fit_network
from training.networks import STEP

COUNT = 4000
# Less noise than it should be for people left out: there is more to learn.
RECIPE = replace(
    networks_recipe(NetworkOptions(hidden=(64, 64), steps=800, batch=128, dropout=0.0, rate=4e-3)),
    examples=ExampleOptions(noise=0.003),
)
CONSTRUCTION = CONSTRUCTIONS[RECIPE.body_frame]


@pytest.fixture(scope="module")
def corpus(small_dir):
    return read_corpus(
        small_dir, training_captures(small_dir), RECIPE, lambda *_: None, pytest.fail
    )


@pytest.fixture(scope="module")
def fitted(corpus):
    return fit_network(corpus, np.arange(len(corpus.frames)), SIX, RECIPE, 0)


@pytest.fixture(scope="module")
def examples(corpus, fitted):
    """Others than the networks were trained on, of the same captures."""
    poses = _poses(corpus, np.arange(len(corpus.frames)))
    tracked = fitted.info.tracked
    return Examples(poses, tracked, CONSTRUCTION, RECIPE.examples, np.random.default_rng(7))


def rms(error):
    return float(np.sqrt((error**2).mean()))


def test_the_pose_is_nearer_than_by_its_linear_prior(fitted, examples):
    network = fitted.graph.pose
    unworn = [MARKERS.index(label) for label in fitted.info.unworn]
    batch = examples.whole(COUNT)
    prior = network.linear(network.inputs(batch.tracked)).reshape(batch.poses.shape)
    by_prior = rms((prior - batch.poses)[:, unworn])
    found, sigma = network.estimate(batch.tracked)
    off = (found - batch.poses)[:, unworn]
    assert rms(off) < 0.8 * by_prior
    assert by_prior < 0.5 * rms((batch.poses - batch.poses.mean(axis=0))[:, unworn])
    # And it has learned how far off it is.
    within = np.abs(off) < sigma[:, unworn, None]
    assert 0.6 < within.mean() < 0.85


def test_velocities_are_nearer_than_by_their_linear_prior(fitted, examples):
    network = fitted.graph.velocity
    tracked, unworn = (
        [MARKERS.index(label) for label in labels]
        for labels in (fitted.info.tracked, fitted.info.unworn)
    )
    batch = examples.whole(COUNT)
    inputs, speed = network.inputs(batch.tracked, batch.velocities[:, tracked])
    prior = inputs[:, len(network.mean) :] @ network.prior * speed
    by_prior = rms((prior.reshape(batch.poses.shape) - batch.velocities)[:, unworn])
    found = network.estimate(batch.tracked, batch.velocities[:, tracked])
    assert rms((found - batch.velocities)[:, unworn]) < 0.8 * by_prior
    assert by_prior < 0.6 * rms(batch.velocities[:, unworn])


def test_a_missing_marker_goes_on_as_it_went_and_is_told_by_the_others(fitted, examples):
    network = fitted.graph.recall
    missing, true = examples.missing(5 * COUNT)
    found, sigma = network.estimate(missing)
    prior = (network.begin(missing) + network.linear(network.inputs(missing), missing.age)).reshape(
        true.shape
    )
    lacks = missing.present == 0

    def off(markers, where):
        return rms((markers - true)[lacks & where[:, None]])

    soon, later = missing.age < 0.02, (missing.age > 0.3) & (missing.age < 1.0)
    assert off(found, soon) < 0.5 * min(off(missing.then, soon), off(missing.left, soon))
    still = min(off(missing.then, later), off(missing.left, later))
    assert off(found, later) < 0.85 * off(prior, later)
    assert off(prior, later) < 0.5 * still
    within = (np.abs(found - true) < sigma[..., None])[lacks & later[:, None]]
    assert 0.6 < within.mean() < 0.85


def test_what_was_just_seen_is_where_it_was_seen(fitted, examples):
    """As age goes to nothing so does what any network says."""
    network = fitted.graph.recall
    missing, _ = examples.missing(200)
    missing.age[:] = 1e-5
    found, _ = network.estimate(missing)
    expected = missing.left + missing.pace * np.float32(1e-5)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_loss_leads_downhill():
    """Its gradient by finite differences of what it says it is."""
    random = np.random.default_rng(0)
    count, width = 4, 3
    target = random.normal(0, 0.1, (count, 3 * width))
    wanted = np.float64(random.random((count, width)) < 0.7)
    share = random.uniform(0.1, 1.0, (count, 1))
    outputs = np.column_stack(
        [random.normal(size=(count, 3 * width)), random.normal(-2, 0.2, (count, width))]
    )

    def loss(outputs):
        """Of the markers; a small share counts the more."""
        off = share * STEP * outputs[:, : 3 * width] - target
        square = ((off / STEP) ** 2 / share).reshape(count, width, 3).sum(axis=2)
        return 0.5 * (square * wanted).sum() / count

    gradient = _Loss(target, wanted, share)(outputs)
    for index in np.ndindex(count, 3 * width):
        changed = [outputs.copy() for _ in range(2)]
        changed[0][index] += 1e-5
        changed[1][index] -= 1e-5
        slope = (loss(changed[0]) - loss(changed[1])) / 2e-5
        assert gradient[index] == pytest.approx(slope, abs=1e-6)
    # Sigma is to grow where errors are larger than it, and to shrink where they are smaller.
    off = (share * STEP * outputs[:, : 3 * width] - target).reshape(count, width, 3)
    larger = (off**2).mean(axis=2) > np.exp(2 * outputs[:, 3 * width :])
    np.testing.assert_array_equal(gradient[:, 3 * width :] < 0, larger & (wanted == 1))
    np.testing.assert_array_equal(gradient[:, 3 * width :] > 0, ~larger & (wanted == 1))


def test_the_model_file_says_how_the_prior_follows_its_markers(fitted, examples):
    """An error of a tracked marker moves the linear estimate so far."""
    info, network = fitted.info, fitted.graph.pose
    batch = examples.whole(20)
    unworn = [MARKERS.index(label) for label in info.unworn]
    maps = np.array(info.sensitivity)
    for number, label in enumerate(info.features):
        moved = batch.tracked.copy()
        moved[:, info.tracked.index(label)] += [0.01, -0.02, 0.03]
        here, there = (
            network.linear(network.inputs(one)).reshape(20, -1, 3)[:, unworn]
            for one in (batch.tracked, moved)
        )
        expected = maps[:, 3 * number : 3 * number + 3] @ [0.01, -0.02, 0.03]
        found = (there - here).reshape(20, -1)
        np.testing.assert_allclose(found, np.tile(expected, (20, 1)), atol=1e-5)
    assert influence(info).shape == (len(MARKERS), len(info.tracked))
