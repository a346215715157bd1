import numpy as np
import onnxruntime
import pytest
from skl2onnx import to_onnx as oracle
from sklearn.ensemble import RandomForestClassifier

from training.export import Mixture, to_onnx
from training.forest import Forest, ForestOptions, grow_forest, round_down, sparse_forest


@pytest.fixture(scope="module")
def trained():
    random = np.random.default_rng(0)
    x = random.normal(size=(600, 6)).astype(np.float32)
    labels = (x[:, 0] > 0) + 2 * (x[:, 1] + 0.5 * random.normal(size=600) > 0)
    x[300:, 5] = np.round(x[300:, 5], 1)  # ties, where thresholds fall on rows' own values
    return RandomForestClassifier(12, min_samples_leaf=3, random_state=0).fit(x, labels), x


def walk(forest, row):
    """Class weights of one row, node by node."""
    at = {(t, n): i for i, (t, n) in enumerate(zip(forest.tree, forest.node, strict=True))}
    weights = np.zeros(forest.classes)
    for tree in range(forest.tree.max() + 1):
        node = 0
        while forest.feature[at[tree, node]] >= 0:
            i = at[tree, node]
            node = (forest.left if row[forest.feature[i]] <= forest.threshold[i] else forest.right)[
                i
            ]
        mine = (forest.entry_tree == tree) & (forest.entry_node == node)
        weights[forest.entry_class[mine]] += forest.entry_weight[mine]
    return weights


def probabilities_in_onnx(content, rows, classes):
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    history = np.zeros((0, classes), np.float32)
    return np.concatenate(
        [session.run(["p"], {"x": row[None], "history": history})[0] for row in rows]
    )


def test_the_sparse_forest_gives_the_probabilities_of_scikit_learn(trained):
    forest, x = trained
    found = np.array([walk(sparse_forest([forest], hard=False), row) for row in x[::10]])
    np.testing.assert_allclose(found, forest.predict_proba(x[::10]), atol=1e-6)


@pytest.mark.parametrize("trees", [5, 10, 23])
def test_grown_in_parts_it_is_scikit_learns_forest(trained, trees):
    _, x = trained
    labels = (x[:, 0] > 0).astype(int)
    whole = RandomForestClassifier(trees, min_samples_leaf=3, random_state=7).fit(x, labels)
    expected = sparse_forest([whole], hard=False)
    found = sparse_forest(grow_forest(x, labels, ForestOptions(trees, 3), seed=7), hard=False)
    assert found.classes == expected.classes == 2
    for name in Forest.__slots__[1:]:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


def test_only_leaves_have_weights_and_none_is_zero(trained):
    forest = sparse_forest([trained[0]], hard=False)
    leaves = set(zip(forest.tree[forest.feature < 0], forest.node[forest.feature < 0], strict=True))
    assert set(zip(forest.entry_tree, forest.entry_node, strict=True)) == leaves
    assert (forest.entry_weight > 0).all()


def test_hard_votes_count_one_class_per_tree(trained):
    forest, x = trained
    found = np.array([walk(sparse_forest([forest], hard=True), row) for row in x[::10]])
    votes = np.array([tree.predict(x[::10]) for tree in forest.estimators_], int)
    expected = np.array([np.bincount(column, minlength=4) / len(votes) for column in votes.T])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_exported_forest_agrees_with_skl2onnx(trained, minimal_info):
    forest, x = trained
    rows = np.random.default_rng(1).normal(size=(100, 6)).astype(np.float32)
    rows = np.concatenate([rows, x[:100]])
    graph = Mixture(
        sparse_forest([forest], hard=False), False, np.zeros((4, 3, 6)), np.zeros((4, 3))
    )
    found = probabilities_in_onnx(to_onnx(graph, minimal_info), rows, 4)
    content = oracle(
        forest, x[:1], options={"zipmap": False}, target_opset={"": 17, "ai.onnx.ml": 3}
    ).SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    np.testing.assert_allclose(found, session.run(None, {"X": rows})[1], atol=1e-5)


def test_rows_on_a_threshold_go_where_scikit_learn_sends_them(trained, minimal_info):
    """A threshold in double precision next to a row's value must not round up past it."""
    forest, _ = trained
    tree = forest.estimators_[0].tree_
    inner = tree.children_left >= 0
    rows = np.zeros((inner.sum(), 6), np.float32)
    rows[np.arange(inner.sum()), tree.feature[inner]] = np.nextafter(
        tree.threshold[inner].astype(np.float32), np.float32(np.inf)
    )
    graph = Mixture(
        sparse_forest([forest], hard=False), False, np.zeros((4, 3, 6)), np.zeros((4, 3))
    )
    found = probabilities_in_onnx(to_onnx(graph, minimal_info), rows, 4)
    np.testing.assert_allclose(found, forest.predict_proba(rows), atol=1e-5)


def test_rounding_down_never_goes_up_and_stays_close():
    values = np.random.default_rng(2).normal(size=10_000)
    rounded = round_down(values)
    assert rounded.dtype == np.float32
    assert (rounded.astype(float) <= values).all()
    assert (np.nextafter(rounded, np.float32(np.inf)).astype(float) > values).all()
    exact = np.array([0.5, -0.25, 0.0])
    np.testing.assert_array_equal(round_down(exact), exact)
