from dataclasses import replace

import numpy as np
import onnx
import pytest
from sklearn.ensemble import RandomForestClassifier

from bridge.imputer import NEVER
from bridge.model import Model, ModelInfo
from drivers.marker_set import MARKERS
from training.export import Mixture, to_onnx
from training.forest import sparse_forest
from training.network import Network
from training.networks import (
    FADES,
    POSE,
    Missing,
    Networks,
    PoseNetwork,
    RecallNetwork,
    VelocityNetwork,
)
from training.reference import ReferenceModel, ReferenceNetworks

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


COUNT = 50


@pytest.fixture(scope="module")
def networks(minimal_info, tmp_path_factory):
    """Random networks, of different sizes, and their file."""
    random = np.random.default_rng(0)
    markers = len(minimal_info.tracked)
    width, told = 3 * markers, 16 * markers + 4
    mean = normal(random, 0.3, width)

    def network(*sizes, sigmas=0):
        found = Network.random(sizes, random)
        for bias in found.weights[1::2]:
            bias[:] = random.normal(0, 0.2, bias.shape)
        found.weights[-1][sizes[-1] - sigmas :] -= 3.0  # sigma is some centimetres
        return found

    graph = Networks(
        PoseNetwork(
            mean,
            normal(random, 0.1, (width + 1, POSE)),
            network(width, 32, 24, POSE + len(MARKERS), sigmas=len(MARKERS)),
        ),
        VelocityNetwork(mean, normal(random, 0.3, (width, POSE)), network(2 * width, 40, POSE)),
        RecallNetwork(
            mean,
            normal(random, 0.1, (len(FADES) * (told + 1), width)),
            network(told, 16, 20, 12, width + markers, sigmas=markers),
        ),
    )
    path = tmp_path_factory.mktemp("export") / "networks.onnx"
    path.write_bytes(to_onnx(graph, replace(minimal_info, estimator="best", history=0)))
    return path, graph


def normal(random, spread, shape):
    return random.normal(0, spread, shape).astype(np.float32)


@pytest.fixture(scope="module")
def frames(networks):
    """Tracked markers (COUNT, T, 3) and velocities, from rest to many times a body's pace."""
    random = np.random.default_rng(1)
    shape = COUNT, len(networks[1].pose.mean) // 3, 3
    pace = np.geomspace(0.01, 10.0, COUNT - 1)[:, None, None] * normal(random, 1.0, shape)[1:]
    still = np.zeros((1, *shape[1:]))
    return normal(random, 0.5, shape), np.concatenate([still, pace]).astype(np.float32)


@pytest.fixture(scope="module")
def missing(frames):
    """Frames that lack a marker or all but one, last seen 1 ms to 1 h ago, or never."""
    random = np.random.default_rng(2)
    tracked, pace = frames
    lacks = random.random(tracked.shape[:2]) < random.random((COUNT, 1))
    lacks[np.arange(COUNT), random.integers(0, lacks.shape[1], COUNT)] = True
    lacks[lacks.all(axis=1), 0] = False
    then = tracked + normal(random, 0.2, tracked.shape)
    far = np.geomspace(0.01, 100.0, COUNT)[:, None, None]  # somebody walked away
    left = then + far * normal(random, 1.0, tracked.shape)
    age = np.geomspace(0.001, 3600.0, COUNT)
    left[-1], pace, age[-1] = then[-1], pace.copy(), NEVER
    pace[-1] = 0.0
    shown = np.where(lacks[:, :, None], 0.0, tracked)
    parts = (shown, ~lacks, then, left, pace, age)
    return Missing(*(part.astype(np.float32) for part in parts))


def fed(missing):
    """As the file takes them."""
    count = len(missing.age)
    parts = (missing.then, missing.left, missing.pace, missing.age)
    memory = np.concatenate([part.reshape(count, -1) for part in parts], axis=1)
    return missing.tracked.reshape(count, -1), missing.present, memory


def test_of_whole_frames_file_reference_and_training_say_the_same(networks, frames):
    path, graph = networks
    model, reference = Model(path), ReferenceNetworks(path)
    tracked, velocity = frames
    moving = graph.velocity.estimate(tracked, velocity)
    trained = zip(*graph.pose.estimate(tracked), moving, strict=True)
    for one, its, expected in zip(tracked, velocity, trained, strict=True):
        for source in (model, reference):
            pose, sigma, moves = source.estimate(one, its)
            np.testing.assert_allclose(pose, expected[0], atol=1e-4)
            np.testing.assert_allclose(sigma, expected[1], rtol=1e-4)
            np.testing.assert_allclose(moves, expected[2], rtol=1e-4, atol=1e-4)
            assert pose.dtype == sigma.dtype == moves.dtype == np.float32


def test_of_many_sightings_file_reference_and_training_say_the_same(networks, missing):
    """All at once and one by one."""
    path, graph = networks
    model, reference = Model(path), ReferenceNetworks(path)
    markers, sigma = graph.recall.estimate(missing)
    x, present, memory = fed(missing)
    # What is right of far places is so to float32.
    close = {"rtol": 1e-5, "atol": 2e-4}
    for source in (model, reference):
        found, deviation = source.recall(x, present, memory)
        np.testing.assert_allclose(found, markers, **close)
        np.testing.assert_allclose(deviation, sigma, rtol=1e-4)
        assert found.dtype == deviation.dtype == np.float32
    for row in range(COUNT):
        one = slice(row, row + 1)
        found, deviation = model.recall(x[one], present[one], memory[one])
        np.testing.assert_allclose(found, markers[one], **close)
        np.testing.assert_allclose(deviation, sigma[one], rtol=1e-4)


def test_what_a_missing_marker_would_say_does_not_count(networks, missing):
    path, _ = networks
    model = Model(path)
    x, present, memory = fed(missing)
    lies = np.where(np.repeat(present, 3, axis=1) == 0, x + 5.0, x).astype(np.float32)
    assert (lies != x).any(axis=1).all()
    expected = model.recall(x, present, memory)
    for one, two in zip(expected, model.recall(lies, present, memory), strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_same_networks_give_the_same_bytes(networks):
    path, graph = networks
    info = ModelInfo.from_json(onnx.load(str(path)).metadata_props[0].value)
    assert to_onnx(graph, info) == path.read_bytes()
    onnx.checker.check_model(onnx.load(str(path)))
