import numpy as np
import pytest

from training.clustering import divide, reduce, segment_features


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
    assert divide(np.ones((10, 3)), 0.5, seed=0).tolist() == [0] * 10


def test_leaves_are_numbered_in_order_of_first_rows():
    leaf = divide(np.array([[5.0], [0.0], [5.0], [9.0]]), 0.1, seed=3)
    assert leaf.tolist() == [0, 1, 0, 2]


def test_reduction_keeps_the_share_and_the_distances():
    random = np.random.default_rng(4)
    rows = random.normal(size=(50, 6)) * [10, 5, 1, 0.1, 0.01, 0.01]
    reduced = reduce(rows, 0.9999)
    assert reduced.shape[1] < 6
    total = ((rows - rows.mean(axis=0)) ** 2).sum()
    assert (reduced**2).sum() >= 0.9999 * total
    apart = np.linalg.norm(rows[0] - rows[1])
    assert np.linalg.norm(reduced[0] - reduced[1]) == pytest.approx(apart, rel=1e-2)


def test_features_tell_covariance_from_mean():
    """Four segments: two means, two covariances; the weight says what counts."""
    random = np.random.default_rng(5)
    base = random.normal(size=(500, 3))
    segments = [scale * base + mean for scale in (1.0, 3.0) for mean in (0.0, 50.0)]

    def groups(weight):
        return divide(segment_features(segments, weight), 0.5, seed=0).tolist()

    assert groups(1.0) == [0, 0, 1, 1]
    assert groups(0.0) == [0, 1, 0, 1]
    assert groups(0.5) == [0, 1, 2, 3]
