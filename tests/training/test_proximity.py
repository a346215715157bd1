"""Breiman's proximities, against scikit-learn's leaves and his definition, word by word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier

from bridge.model import Model
from drivers.marker_set import MARKERS
from training.export import Mixture, to_onnx
from training.forest import sparse_forest
from training.proximity import ITERATIONS, ProximityImputer, Trees, spread_evenly

FEATURES = [MARKERS.index(label) for label in ("LFHD", "LSHO", "RSHO")]
CLASSES, OUTPUTS = 4, 3 * 37


def save(path, x, labels, info, leaf=3, hard=False):
    """A model file around a forest trained on x (N, D), and the forest."""
    forest = RandomForestClassifier(12, min_samples_leaf=leaf, random_state=0).fit(x, labels)
    classes = len(forest.classes_)
    maps = np.zeros((classes, OUTPUTS, x.shape[1]), np.float32)
    offsets = np.zeros((classes, OUTPUTS), np.float32)
    path.write_bytes(to_onnx(Mixture(sparse_forest([forest], hard), hard, maps, offsets), info))
    return Model(path), forest


@pytest.fixture(scope="module", params=["local", "paper"])
def small(request, minimal_info, tmp_path_factory):
    """A model (its forest sees the principal marker alone in the paper's form) and whole poses."""
    random = np.random.default_rng(0)
    width = 3 if request.param == "paper" else 9
    x = random.normal(size=(600, 9)).astype(np.float32)
    x[:, 3:] += x[:, :3].repeat(2, axis=1)
    labels = np.argmax(x[:, :width] @ random.normal(size=(width, CLASSES)), axis=1)
    model, forest = save(
        tmp_path_factory.mktemp("proximity") / "small.onnx",
        x[:400, :width],
        labels[:400],
        replace(minimal_info, estimator=request.param),
        hard=request.param == "paper",
    )
    poses = np.zeros((600, len(MARKERS), 3), np.float32)
    poses[:, FEATURES] = x.reshape(-1, 3, 3)
    return model, forest, poses


def by_definition(forest, width, references, x, missing):
    """The proximity to each reference counted one by one; as often as Breiman says."""
    filled = np.where(missing, np.median(references, axis=0), x).astype(np.float32)
    of_references = forest.apply(references[:, :width])
    for _ in range(ITERATIONS):
        (own,) = forest.apply(filled[None, :width])
        proximity = np.array([np.mean(leaves == own) for leaves in of_references])
        if proximity.any():
            mean = np.average(references.astype(float), axis=0, weights=proximity)
            filled[missing] = mean[missing]
    return filled


def test_the_leaves_are_those_of_scikit_learn(small):
    model, forest, poses = small
    rows = poses[:, FEATURES].reshape(600, -1)[:, : model.width]
    count = [tree.tree_.node_count for tree in forest.estimators_]
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    trees = Trees(model.path)
    assert trees.nodes == sum(count)
    np.testing.assert_array_equal(trees.leaves(rows) - first, forest.apply(rows))


@pytest.mark.parametrize("hidden", [[0], [1], [0, 2], [0, 1, 2]])
def test_the_fill_is_the_mean_weighted_by_shared_leaves(small, hidden):
    model, forest, poses = small
    references = poses[:150]
    imputer = ProximityImputer(model, references)
    present = np.isin(range(3), hidden, invert=True)
    changed = 0
    for pose in poses[400:415]:
        x = np.where(present[:, None], pose[FEATURES], np.nan)
        filled = imputer.fill(x, present, 1 / 120)
        expected = by_definition(
            forest,
            model.width,
            references[:, FEATURES].reshape(150, -1),
            x.ravel(),
            np.repeat(~present, 3),
        )
        np.testing.assert_allclose(filled.ravel(), expected, atol=1e-5)
        np.testing.assert_array_equal(filled[present], x[present])
        changed += not np.allclose(
            filled[~present], np.median(references, axis=0)[FEATURES][hidden]
        )
    assert changed == 15


def test_a_missing_marker_comes_from_the_cluster_of_the_others(minimal_info, tmp_path):
    """Two kinds of pose; the marker stands elsewhere in each, the median is one of them."""
    random = np.random.default_rng(1)
    kind = np.arange(300) % 3 // 2  # a third are of kind 1
    centres = np.array([[0.0] * 9, [1.0] * 9])
    x = (centres[kind] + random.normal(0, 0.02, (300, 9))).astype(np.float32)
    model, _ = save(tmp_path / "two.onnx", x, kind, minimal_info)
    poses = np.zeros((300, len(MARKERS), 3), np.float32)
    poses[:, FEATURES] = x.reshape(-1, 3, 3)
    imputer = ProximityImputer(model, poses)
    present = np.array([False, True, True])
    for cluster in (0, 1):
        seen = np.full((3, 3), float(cluster), np.float32)
        seen[0] = np.nan
        filled = imputer.fill(seen, present, 1 / 120)
        np.testing.assert_allclose(filled[0], x[kind == cluster][:, :3].mean(axis=0), atol=0.01)


def test_where_no_reference_is_near_the_median_stays(minimal_info, tmp_path):
    """The trees see the one principal marker, and no reference is where it is."""
    x = np.linspace(0, 1, 100, dtype=np.float32)[:, None].repeat(3, axis=1)
    model, _ = save(tmp_path / "line.onnx", x, np.arange(100) // 10, minimal_info)
    poses = np.zeros((3, len(MARKERS), 3), np.float32)
    poses[:, FEATURES] = np.array([0.0, 0.01, 0.08], np.float32)[:, None, None]
    imputer = ProximityImputer(model, poses)
    present = np.array([True, True, False])
    far, near = (
        imputer.fill(np.full((3, 3), at, np.float32), present, 1 / 120)[2] for at in (1.0, 0.08)
    )
    np.testing.assert_allclose(far, 0.01)
    assert (near > 0.02).all()


def test_nothing_missing_is_nothing_changed(small):
    model, _, poses = small
    xyz = poses[0, FEATURES]
    assert ProximityImputer(model, poses[:10]).fill(xyz, np.ones(3, bool), 1 / 120) is xyz


def test_the_references_are_taken_evenly():
    poses = np.arange(1000)[:, None, None] * np.ones((1, 41, 3), np.float32)
    assert spread_evenly(poses, 4)[:, 0, 0].tolist() == [0, 333, 666, 999]
    assert len(spread_evenly(poses)) == 1000
