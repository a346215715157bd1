import numpy as np
import pytest
from sklearn.decomposition import PCA
from sklearn.utils.estimator_checks import parametrize_with_checks

from training import clustering
from training.clustering import DivisiveKMeans, principal_axes, segment_features
from training.moments import SegmentMoments, mirrored_moments, moments_of


@parametrize_with_checks([DivisiveKMeans()])
def test_it_keeps_scikit_learns_contract(estimator, check, monkeypatch):
    monkeypatch.setenv("SCIPY_ARRAY_API", "1")  # or one of the checks is skipped
    check(estimator)


def divide(rows, tolerance, seed):
    return DivisiveKMeans(tolerance, seed).fit_predict(rows)


def limit_of(rows, tolerance):
    return tolerance * np.sqrt(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("tolerance", [0.3, 0.6, 1.0])
def test_every_member_of_a_leaf_is_within_tolerance_of_its_mean(tolerance):
    rows = np.random.default_rng(0).normal(size=(120, 5))
    leaf = divide(rows, tolerance, seed=0)
    for number in range(leaf.max() + 1):
        members = rows[leaf == number]
        away = np.linalg.norm(members - members.mean(axis=0), axis=1)
        assert away.max() <= limit_of(rows, tolerance)


def test_no_cluster_is_halved_without_need():
    """Tight groups far apart: exactly one leaf each, however the halving went."""
    random = np.random.default_rng(1)
    centres = 10 * random.normal(size=(7, 3))
    group = np.repeat(np.arange(7), 15)
    rows = centres[group] + random.normal(scale=0.05, size=(105, 3))
    leaf = divide(rows, 0.05, seed=0)
    assert leaf.max() == 6
    assert len(set(zip(leaf.tolist(), group.tolist(), strict=True))) == 7


def test_all_within_tolerance_is_one_leaf():
    rows = np.random.default_rng(2).normal(size=(30, 4))
    assert divide(rows, 10.0, seed=0).max() == 0
    assert divide(rows[:1], 0.1, seed=0).tolist() == [0]


def test_equal_rows_are_one_leaf():
    for row in ([1.0, 1.0, 1.0], [0.1, 0.1, 0.1], np.random.default_rng(3).normal(size=9)):
        for count in (2, 6, 7, 13):
            assert divide(np.tile(row, (count, 1)), 0.5, seed=0).tolist() == [0] * count


def test_copies_of_a_segment_are_one_leaf():
    moments = moments_of(poses_of(np.random.default_rng(11), 50))
    for count in (5, 13, 14, 18):
        assert divide(features_of([moments] * count, 0.5).rows, 0.5, seed=0).max() == 0


def test_leaves_are_numbered_in_order_of_first_rows():
    leaf = divide(np.array([[5.0], [0.0], [5.0], [9.0]]), 0.1, seed=3)
    assert leaf.tolist() == [0, 1, 0, 2]


def members_of(tree, node):
    """The rows in a leaf or under a halving."""
    if node < tree.n_leaves_:
        return np.flatnonzero(tree.labels_ == node).tolist()
    left, right = tree.children_[node - tree.n_leaves_]
    return members_of(tree, left) + members_of(tree, right)


@pytest.mark.parametrize("tolerance", [0.3, 0.8])
def test_every_halving_was_needed(tolerance):
    rows = np.random.default_rng(6).normal(size=(90, 4))
    tree = DivisiveKMeans(tolerance, 0).fit(rows)
    assert tree.limit_ == pytest.approx(limit_of(rows, tolerance))
    assert sorted(members_of(tree, 2 * tree.n_leaves_ - 2)) == list(range(90))
    for node in range(2 * tree.n_leaves_ - 1):
        members = rows[members_of(tree, node)]
        radius = np.linalg.norm(members - members.mean(axis=0), axis=1).max()
        assert tree.radius_[node] == pytest.approx(radius)
        assert (radius > tree.limit_) == (node >= tree.n_leaves_)


def test_the_axes_are_those_of_scikit_learns_pca():
    random = np.random.default_rng(4)
    rows = random.normal(size=(50, 90)) * np.geomspace(10, 0.1, 90)
    rows -= rows.mean(axis=0)
    axes, variances = principal_axes(rows, 0.95)
    expected = PCA(n_components=0.95, svd_solver="full").fit(rows)
    assert axes.shape == (90, expected.n_components_)
    np.testing.assert_allclose(np.abs((axes.T * expected.components_).sum(axis=1)), 1.0)
    np.testing.assert_allclose(
        variances[: axes.shape[1]] * 50 / 49, expected.explained_variance_, rtol=1e-9
    )


def features_of(moments, weight):
    moments = np.array(moments)
    return segment_features(SegmentMoments(moments, np.arange(len(moments)), False), weight)


def poses_of(random, frames):
    """Poses (frames, 41, 3) whose coordinates vary along a few directions."""
    directions = random.normal(size=(5, 123))
    return (random.normal(size=(frames, 5)) @ directions).reshape(frames, 41, 3).astype(np.float32)


def test_the_features_are_the_papers():
    """By their definition: upper triangle of the covariance, mean, scaled, weighted, PCA."""
    random = np.random.default_rng(7)
    segments = [poses_of(random, 40 + n) for n in range(12)]
    rows = [part.reshape(len(part), -1).astype(float) for part in segments]
    upper = np.triu_indices(123)
    v = np.array([np.cov(part, rowvar=False)[upper] for part in rows])
    mu = np.array([part.mean(axis=0) for part in rows])
    v, mu = (part / np.sqrt(part.var(axis=0).sum()) for part in (v, mu))
    expected = PCA(n_components=0.95, svd_solver="full").fit_transform(
        np.hstack([0.3 * v, 0.7 * mu])
    )
    found = features_of([moments_of(part) for part in segments], 0.3).rows
    assert found.shape == expected.shape
    apart = [np.linalg.norm(part[:, None] - part[None], axis=2) for part in (found, expected)]
    np.testing.assert_allclose(*apart, atol=1e-6)


def test_of_many_segments_some_tell_the_axes(monkeypatch):
    random = np.random.default_rng(8)
    kinds = [poses_of(random, 60) for _ in range(4)]
    moments = np.array(
        [moments_of(kinds[n % 4] + random.normal(scale=0.01, size=(60, 41, 3))) for n in range(80)]
    )
    whole = features_of(moments, 0.5)
    monkeypatch.setattr(clustering, "BASIS", 41)
    some = features_of(moments, 0.5)
    assert len(some.variances) == 41
    assert len(some.rows) == len(whole.rows) == 80
    for features in (whole, some):
        groups = DivisiveKMeans(0.5, 0).fit_predict(features.rows)
        assert groups.tolist() == [0, 1, 2, 3] * 20


def test_features_tell_covariance_from_mean():
    """Four segments: two means, two covariances; the weight says what counts."""
    base = poses_of(np.random.default_rng(5), 500)
    segments = [scale * base + mean for scale in (1.0, 3.0) for mean in (0.0, 50.0)]
    moments = np.array([moments_of(part) for part in segments])

    def groups(weight):
        return divide(features_of(moments, weight).rows, 0.5, seed=0).tolist()

    assert groups(1.0) == [0, 0, 1, 1]
    assert groups(0.0) == [0, 1, 0, 1]
    assert groups(0.5) == [0, 1, 2, 3]


def test_mirror_images_have_features_of_their_own():
    random = np.random.default_rng(10)
    moments = np.array([moments_of(poses_of(random, 40)) for _ in range(5)])
    some = np.array([3, 0])
    found = segment_features(SegmentMoments(moments, some, True), 0.5).rows
    expected = features_of([*moments[some], *mirrored_moments(moments[some])], 0.5).rows
    np.testing.assert_array_equal(found, expected)


def test_a_single_segment_has_features():
    moments = [moments_of(poses_of(np.random.default_rng(9), 30))]
    assert divide(features_of(moments, 0.5).rows, 0.5, seed=0).tolist() == [0]
