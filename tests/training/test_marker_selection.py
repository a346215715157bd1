import numpy as np
import pytest

from bridge.body_frame import REFERENCES
from drivers.marker_set import MARKERS
from training.marker_selection import component_weights, cover, select_markers
from training.poses import body_poses


def test_components_hold_the_variance_asked_for():
    random = np.random.default_rng(1)
    data = random.normal(size=(5000, 4)) * np.sqrt([90.0, 6.0, 3.0, 1.0])
    weights = component_weights(np.cov(data.T), 0.95)
    assert weights.shape == (4, 2)
    np.testing.assert_allclose(weights[:2], np.eye(2), atol=0.05)


def test_the_least_important_markers_go_while_all_clusters_stay_covered():
    cluster = np.array([[0, 0, 0], [0, 1, 1], [2, 1, 0], [2, 2, 2], [3, 3, 3]])
    #  3 is all there is of cluster 4; 2 covers 0, 1 and 2 alone.
    assert cover(cluster, np.zeros(5)) == [2, 4]


def test_among_equals_the_one_nearer_to_its_clusters_stays():
    cluster = np.array([[0, 1, 1], [0, 0, 1], [1, 0, 1]])
    assert cover(cluster, np.array([0.3, 0.1, 0.2])) == [1]


def test_no_marker_chosen_can_go():
    random = np.random.default_rng(3)
    for _ in range(50):
        cluster = random.integers(0, 6, (12, 3))
        kept = cover(cluster, random.random(12))
        covered = {number for row in kept for number in cluster[row]}
        assert covered == set(cluster.ravel().tolist())
        for row in kept:
            others = {number for other in kept if other != row for number in cluster[other]}
            assert others != covered


def test_one_marker_per_independent_group():
    """Three groups of markers that move as one: one of each is enough, and nothing else."""
    random = np.random.default_rng(5)
    groups = random.normal(size=(2000, 3, 1, 3)) * [[[3.0, 2.0, 1.0]]]
    poses = np.repeat(groups, 4, axis=2).reshape(2000, 36)
    poses += random.normal(scale=0.01, size=poses.shape)
    labels = [f"{group}{number}" for group in "ABC" for number in range(4)]
    chosen = select_markers(np.cov(poses.T), labels, spare_clusters=0, restarts=20)
    assert sorted(label[0] for label in chosen.markers) == ["A", "B", "C"]


@pytest.fixture(scope="module")
def candidates(train_takes):
    labels = [label for label in MARKERS if label not in REFERENCES]
    columns = [MARKERS.index(label) for label in labels]
    poses = np.concatenate(
        [body_poses(take.xyz)[::4, columns] for take in train_takes if take.real]
    )
    return np.cov(poses.reshape(len(poses), -1).T), labels


def test_real_captures_give_about_as_many_markers_as_the_paper(candidates):
    chosen = select_markers(*candidates)
    assert 5 <= len(chosen.markers) <= 8
    assert chosen.clusters == chosen.components + 1
    assert not set(chosen.markers) & set(REFERENCES)


def test_the_choice_hardly_hangs_on_the_seed(candidates):
    first, *others = (set(select_markers(*candidates, seed=seed).markers) for seed in range(3))
    for other in others:
        assert len(first & other) >= len(first) - 1


def test_more_clusters_give_more_markers(candidates):
    few = select_markers(*candidates, spare_clusters=0, restarts=20)
    many = select_markers(*candidates, spare_clusters=12, restarts=20)
    assert len(many.markers) > len(few.markers)


def test_more_restarts_make_the_choice_surer(candidates):
    different = [
        len({select_markers(*candidates, seed, restarts=restarts).markers for seed in range(8)})
        for restarts in (1, 100)
    ]
    assert different[0] > different[1]
