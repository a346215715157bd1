from dataclasses import replace

import numpy as np
import onnx
import pytest
from sklearn.ensemble import RandomForestClassifier

from bridge.model import Model, ModelInfo
from training.export import Mixture, to_onnx
from training.forest import sparse_forest
from training.network import Network
from training.reference import ReferenceModel, ReferenceNetworks
from training.regressor import POSE, Networks, Regressor

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
    graph = Mixture(sparse_forest([forest], hard), hard, maps, offsets)
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


@pytest.fixture(scope="module", params=[1, 2], ids=["one member", "two members"])
def networks(request, minimal_info, tmp_path_factory):
    """Random networks: their file, the networks, and rows with the markers that are present."""
    random = np.random.default_rng(0)
    tracked, markers = minimal_info.tracked, len(minimal_info.labels)
    rows = np.repeat([tracked.index(label) for label in minimal_info.features], 3)
    inputs = len(rows) + len(tracked)
    mean = random.normal(0, 0.3, len(rows)).astype(np.float32)

    def regressor(hidden):
        members = tuple(
            Network.random((inputs, *hidden, POSE + markers), random) for _ in range(request.param)
        )
        for member in members:
            for bias in member.weights[1::2]:
                bias[:] = random.normal(0, 0.2, bias.shape)
            member.weights[-1][POSE:] -= 3.0  # sigma is some centimetres
        skip = random.normal(0, 0.1, (inputs + 1, POSE)).astype(np.float32)
        return Regressor(mean, rows, skip, 0.8, members)

    # Of different sizes: the two may differ in all but what they take and give.
    graph = Networks(regressor((32, 24)), regressor((40,)))
    info = replace(minimal_info, estimator="best", history=0, sensitivity=[])
    path = tmp_path_factory.mktemp("export") / "networks.onnx"
    path.write_bytes(to_onnx(graph, info))
    count = 50
    features = random.normal(0, 0.5, (count, len(rows) // 3, 3)).astype(np.float32)
    present = (random.random((count, len(tracked))) < 0.6).astype(np.float32)
    present[0] = 0.0
    return path, graph, features, present


def test_networks_give_the_same_in_the_file_in_the_reference_and_in_training(networks):
    """Frame by frame: with all markers, without some, and without any."""
    path, graph, features, present = networks
    model, reference = Model(path), ReferenceNetworks(path)
    whole = np.ones_like(present)
    for number in range(len(features)):
        one = slice(number, number + 1)
        x = features[one].reshape(1, -1)
        for marks in (present[one], whole[one]):
            z, sigma = model.regress(x, marks)
            same_z, same_sigma = reference.regress(x, marks)
            np.testing.assert_allclose(z, same_z, atol=1e-4)
            np.testing.assert_allclose(sigma, same_sigma, rtol=1e-4)
            pose, trained_sigma = graph.estimate(features[one], marks)
            np.testing.assert_allclose(z, pose.reshape(1, -1), atol=1e-4)
            np.testing.assert_allclose(sigma, trained_sigma, rtol=1e-4)
            assert z.dtype == sigma.dtype == np.float32


def test_many_frames_at_once_are_as_one_by_one(networks):
    """Of several frames all must be whole for the network of whole frames."""
    path, graph, features, present = networks
    model, reference = Model(path), ReferenceNetworks(path)
    assert present.any()
    assert not present.all()
    x = features.reshape(len(features), -1)
    for marks, used in ((present, graph.part), (np.ones_like(present), graph.whole)):
        z, sigma = model.regress(x, marks)
        for expected_z, expected_sigma in (
            reference.regress(x, marks),
            used.estimate(features, marks),
        ):
            np.testing.assert_allclose(z, expected_z.reshape(len(z), -1), atol=1e-4)
            np.testing.assert_allclose(sigma, expected_sigma, rtol=1e-4)


def test_what_a_missing_marker_would_say_does_not_count(networks):
    path, _, features, present = networks
    model = Model(path)
    rows = [model.info.tracked.index(label) for label in model.info.features]
    other = features + 5.0 * (present[:, rows, None] == 0)
    assert (other != features).any()
    for one, two in zip(
        model.regress(features.reshape(len(features), -1), present),
        model.regress(other.reshape(len(features), -1).astype(np.float32), present),
        strict=True,
    ):
        np.testing.assert_array_equal(one, two)


def test_the_same_networks_give_the_same_bytes(networks):
    path, graph, _, _ = networks
    info = ModelInfo.from_json(onnx.load(str(path)).metadata_props[0].value)
    assert to_onnx(graph, info) == path.read_bytes()
    onnx.checker.check_model(onnx.load(str(path)))
