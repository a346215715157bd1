from dataclasses import replace

import numpy as np
import onnx
import pytest
from sklearn.ensemble import RandomForestClassifier

from bridge.model import Model, ModelInfo
from training.export import Graph, to_onnx
from training.forest import sparse_forest
from training.reference import ReferenceModel

LEAVES, WIDTH, OUTPUTS = 5, 9, 3 * 37


@pytest.fixture(scope="module", params=["local", "paper"])
def small(request, minimal_info, tmp_path_factory):
    """A random model of either kind: its file, its parts, and rows to run it on."""
    random = np.random.default_rng(0)
    width = 3 if request.param == "paper" else WIDTH
    x = random.normal(size=(400, width)).astype(np.float32)
    labels = np.argmax(x @ random.normal(size=(width, LEAVES)), axis=1)
    forest = RandomForestClassifier(9, min_samples_leaf=4, random_state=0).fit(x, labels)
    hard = request.param == "paper"
    maps = random.normal(size=(LEAVES, OUTPUTS, width)).astype(np.float32)
    offsets = random.normal(size=(LEAVES, OUTPUTS)).astype(np.float32)
    graph = Graph(sparse_forest([forest], hard), hard, maps, offsets)
    path = tmp_path_factory.mktemp("export") / "small.onnx"
    path.write_bytes(to_onnx(graph, replace(minimal_info, estimator=request.param)))
    return path, forest, graph, random.normal(size=(60, width)).astype(np.float32)


@pytest.mark.parametrize("h", [0, 1, 10])
def test_the_mixture_is_the_direct_count_of_the_paper(small, h):
    """w_k = r_k / (h + 1): counted anew for each frame, over the frames that there were."""
    path, forest, graph, rows = small
    model = Model(path)
    history = np.zeros((h, LEAVES), np.float32)
    shares = forest.predict_proba(rows)
    if graph.hard:
        votes = np.array([tree.predict(rows) for tree in forest.estimators_], int)
        majority = [np.bincount(column).argmax() for column in votes.T]
        shares = np.eye(LEAVES)[majority]
    for t, row in enumerate(rows):
        z, p = model.run(row[None], history)
        recent = shares[max(0, t - h) : t + 1]
        w = recent.sum(axis=0) / len(recent)
        expected = sum(w[k] * (graph.maps[k] @ row + graph.offsets[k]) for k in range(LEAVES))
        np.testing.assert_allclose(p[0], shares[t], atol=1e-6)
        np.testing.assert_allclose(z[0], expected, atol=1e-4)
        if h:
            history[t % h] = p[0]


def test_the_reference_agrees_with_the_graph(small):
    path, _, _, rows = small
    model, reference = Model(path), ReferenceModel(path)
    history = np.random.default_rng(1).dirichlet(np.ones(LEAVES), 7).astype(np.float32)
    for row in rows:
        for z, expected in zip(
            model.run(row[None], history), reference.run(row[None], history), strict=True
        ):
            assert z.shape == expected.shape
            np.testing.assert_allclose(z, expected, atol=1e-5)


def test_the_file_is_plain_onnx_with_our_description(small, minimal_info):
    path, _, graph, _ = small
    file = onnx.load(str(path))
    onnx.checker.check_model(file)
    assert {entry.domain: entry.version for entry in file.opset_import} == {
        "": 17,
        "ai.onnx.ml": 3,
    }
    described = ModelInfo.from_json(file.metadata_props[0].value)
    assert described == replace(minimal_info, estimator="paper" if graph.hard else "local")


def test_the_same_model_gives_the_same_bytes(small, minimal_info):
    path, _, graph, _ = small
    info = ModelInfo.from_json(onnx.load(str(path)).metadata_props[0].value)
    assert to_onnx(graph, info) == path.read_bytes()
