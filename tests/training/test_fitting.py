import numpy as np
import pytest

from drivers.marker_set import MARKERS
from training.corpus import read_corpus
from training.dataset import training_captures
from training.fitting import cluster, fit_mixture, forest_rows
from training.forest import ForestOptions
from training.forest_error import HELD, forest_error
from training.local_models import affine
from training.mirroring import mirrored
from training.moments import columns_of, moments_of
from training.recipe import RECIPES, MixtureRecipe

SIX = ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")
ALL_POSES = {"pose_step": 0.0, "pose_rows": 10**6}


@pytest.fixture(scope="module")
def recipes():
    """As they ship, but keeping every pose, so that maps can be checked against frames."""
    local = RECIPES["local"]
    forest = ForestOptions(trees=5, leaf=5)
    return {
        "local": MixtureRecipe(
            plain=False, mirror=True, forest=forest, share=local.share, **ALL_POSES
        ),
        "paper": MixtureRecipe(plain=True, mirror=False, forest=forest, **ALL_POSES),
    }


@pytest.fixture(scope="module")
def corpus(small_dir, recipes):
    return read_corpus(
        small_dir, training_captures(small_dir), recipes["local"], lambda *_: None, pytest.fail
    )


def everything(corpus):
    return np.arange(len(corpus.frames))


def coordinates(poses, labels):
    return poses[:, [MARKERS.index(label) for label in labels]].reshape(len(poses), -1)


def test_the_papers_maps_are_least_squares_over_the_frames_of_each_leaf(corpus, recipes):
    fitted = fit_mixture(corpus, everything(corpus), SIX, recipes["paper"], 0)
    leaf = fitted.leaves.leaf[corpus.segment]  # of every frame
    assert fitted.leaves.count > 1
    for number in range(fitted.leaves.count):
        poses = corpus.poses[leaf == number].astype(float)
        x, z = coordinates(poses, SIX), coordinates(poses, fitted.info.unworn)
        expected = np.linalg.lstsq(x, z)[0]
        # The maps may differ where the frames leave them open; what they say of frames may not.
        np.testing.assert_allclose(x @ fitted.graph.maps[number].T, x @ expected, atol=1e-5)
        assert not fitted.graph.offsets[number].any()


def test_the_local_maps_are_ridge_regressions_over_own_and_mirrored_frames(corpus, recipes):
    recipe = recipes["local"]
    fitted = fit_mixture(corpus, everything(corpus), SIX, recipe, 0)
    features, unworn = fitted.info.features, fitted.info.unworn
    poses = np.concatenate([corpus.poses, mirrored(corpus.poses)]).astype(float)
    leaf = np.concatenate([fitted.leaves.leaf[corpus.segment], fitted.leaves.twin[corpus.segment]])
    x, z = affine(coordinates(poses, features)), coordinates(poses, unworn)
    np.testing.assert_allclose(fitted.info.mean, x[:, :-1].mean(axis=0).reshape(-1, 3), atol=1e-9)
    np.testing.assert_allclose(fitted.info.covariance, np.cov(x[:, :-1], rowvar=False), atol=1e-9)
    for number in range(fitted.leaves.count):
        own = leaf == number
        # Each frame of the leaf weighs 1, all frames together `share` of that.
        weight = own + recipe.share * own.sum() / len(poses)
        ridge = np.sqrt(recipe.noise**2 * weight.sum()) * np.eye(x.shape[1])
        ridge[-1] = 0.0
        root = np.sqrt(weight)[:, None]
        rows, targets = (
            np.vstack([root * x, ridge]),
            np.vstack([root * z, ridge[:, :1] * 0 @ z[:1]]),
        )
        expected = np.linalg.lstsq(rows, targets)[0].T
        np.testing.assert_allclose(fitted.graph.maps[number], expected[:, :-1], atol=1e-4)
        np.testing.assert_allclose(fitted.graph.offsets[number], expected[:, -1], atol=1e-4)


def test_a_segment_and_its_twin_are_clustered_by_their_own_frames(corpus, recipes):
    leaves = cluster(corpus, everything(corpus), recipes["local"], 0)
    assert len(leaves.leaf) == len(leaves.twin) == len(corpus.frames)
    assert leaves.count == 1 + max(leaves.leaf.max(), leaves.twin.max())
    some = np.array([0, 2])
    part = cluster(corpus, some, recipes["paper"], 0)
    assert part.twin is None
    assert len(part.leaf) == 2


def test_the_forest_sees_the_poses_of_its_segments_and_their_mirror_images(corpus, recipes):
    some = everything(corpus)[1:]
    leaves = cluster(corpus, some, recipes["local"], 0)
    rows = forest_rows(corpus, leaves, columns_of(("RTOE",)))
    kept = corpus.poses[corpus.segment >= 1]
    shown = np.concatenate([kept, mirrored(kept)])
    np.testing.assert_array_equal(rows.x, coordinates(shown, ("RTOE",)))
    assert set(rows.segment) == set(some)
    for segment, leaf, twin in zip(some, leaves.leaf, leaves.twin, strict=True):
        own, mirror = np.split(rows.leaf[rows.segment == segment], 2)
        assert set(own) == {leaf}
        assert set(mirror) == {twin}


def test_the_whole_is_the_sum_of_its_segments(corpus):
    np.testing.assert_allclose(
        moments_of(corpus.poses), corpus.moments.sum(axis=0), rtol=1e-9, atol=1e-6
    )


class _Rows:
    """40 segments of 50 poses in 4 leaves. The leaf shows in x, or only the segment does."""

    def __init__(self, tells_leaf):
        random = np.random.default_rng(0)
        self.pose = np.arange(2000)
        self.segment = self.pose // 50
        self.leaf = self.segment % 4
        told = self.leaf if tells_leaf else random.permutation(40)[self.segment]
        self.x = (10 * told[:, None] + random.normal(size=(2000, 3))).astype(np.float32)


def test_the_forest_error_of_what_can_be_told():
    found = forest_error(_Rows(tells_leaf=True), ForestOptions(10, 1), seed=0)
    assert found.frames == found.segments == found.segments_known == 0.0


def test_the_forest_error_on_new_segments_is_that_of_new_motion():
    """Where only the segment can be told, poses between known ones are named, new ones guessed."""
    found = forest_error(_Rows(tells_leaf=False), ForestOptions(10, 1), seed=0)
    assert found.frames < 0.01
    assert found.segments == found.segments_known > 0.4


def test_a_leaf_without_other_segments_cannot_be_named():
    rows = _Rows(tells_leaf=True)
    rows.leaf = rows.segment
    found = forest_error(rows, ForestOptions(10, 1), seed=0)
    assert found.segments == 1.0
    assert found.segments_known is None
    assert 0 < HELD < 1
    rows.segment = np.zeros(2000, int)
    assert forest_error(rows, ForestOptions(10, 1), seed=0) is None
