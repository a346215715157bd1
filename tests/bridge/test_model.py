from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import onnx
import pytest

from bridge.model import METADATA_KEY, Model, ModelError

DEFAULT = Path(str(files("bridge") / "models" / "default.onnx"))


def changed(path: Path, source: Path = DEFAULT, **entries: object) -> Path:
    """A model with entries of its description replaced."""
    graph = onnx.load(source)
    for entry in graph.metadata_props:
        if entry.key == METADATA_KEY:
            entry.value = json.dumps(json.loads(entry.value) | entries)
    onnx.save(graph, path)
    return path


def test_the_default_model_says_what_it_is() -> None:
    info = Model("default").info
    assert info.estimator == "best"
    assert len(info.principal) == 6
    assert info.references == ("C7", "LSHO", "RSHO")
    assert len(info.labels) == 41
    assert len(info.unworn) == 32
    assert info.training["data"]
    assert info.accuracy["folds"]
    assert info.accuracy["test"]


def test_the_default_model_is_small() -> None:
    assert DEFAULT.stat().st_size < 20_000_000


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("absent", lambda path: None, "no such model file"),
        ("empty", lambda path: path.touch(), "not a whole ONNX file"),
        ("text", lambda path: path.write_text("hello\n" * 99), "not a whole ONNX file"),
        (
            "cut",
            lambda path: path.write_bytes(DEFAULT.read_bytes()[: DEFAULT.stat().st_size // 2]),
            "not a whole ONNX file",
        ),
        ("version", lambda path: changed(path, format=99), "model format 99"),
        ("old", lambda path: changed(path, format=1), "model format 1, this program reads 2"),
        ("history", lambda path: changed(path, history="ten"), "history is not a number"),
        ("frame", lambda path: changed(path, body_frame="upside-down"), "unknown body frame"),
        ("shape", lambda path: changed(path, sigma=[0.1]), "sigma is not of shape"),
        ("entry", lambda path: changed(path, extra=1), "unexpected or missing entries"),
        ("markers", lambda path: changed(path, principal=["LFHD"]), "is not of shape"),
    ],
)
def test_a_file_that_is_no_model_gets_one_clear_line(tmp_path: Path, name, make, words) -> None:
    path = tmp_path / f"{name}.onnx"
    make(path)
    with pytest.raises(ModelError) as caught:
        Model(path)
    assert words in str(caught.value)
    assert path.name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["network", "mixture"])
def test_a_description_of_other_markers_than_the_graphs_is_told(
    tmp_path: Path, kind, request
) -> None:
    """As many as the description needs, but not those that the graph gives."""
    model = request.getfixturevalue(f"{kind}_model")
    info = model.info
    assert info.labels[-1] in info.unworn
    path = changed(
        tmp_path / "fewer.onnx",
        model.path,
        labels=info.labels[:-1],
        sigma=info.sigma[:-1],
        sensitivity=info.sensitivity[:-3],
    )
    with pytest.raises(ModelError, match="not usable as a model"):
        Model(path)


def test_a_description_of_other_tracked_markers_than_the_graph_takes_is_told(
    tmp_path: Path, network_model: Model
) -> None:
    """The first principal marker as one that nobody wears, and all else as it must be then."""
    info = network_model.info
    sensitivity, covariance = np.array(info.sensitivity), np.array(info.covariance)
    path = changed(
        tmp_path / "unworn.onnx",
        network_model.path,
        principal=info.principal[1:],
        mean=info.mean[1:],
        covariance=covariance[3:, 3:].tolist(),
        sigma=[0.1, *info.sigma],
        sensitivity=np.vstack([sensitivity[:3], sensitivity])[:, 3:].tolist(),
    )
    with pytest.raises(ModelError, match="not usable as a model") as caught:
        Model(path)
    assert "\n" not in str(caught.value)


def without_an_input(model: Model, name: str, path: Path) -> Path:
    """The graph with an input made a constant, so that nobody may feed it."""
    proto = onnx.load(model.path)
    entry = next(entry for entry in proto.graph.input if entry.name == name)
    shape = [size.dim_value or 1 for size in entry.type.tensor_type.shape.dim]
    zeros = onnx.numpy_helper.from_array(np.zeros(shape, np.float32), name)
    proto.graph.input.remove(entry)
    proto.graph.initializer.append(zeros)
    onnx.save(proto, path)
    return path


@pytest.mark.parametrize(
    ("kind", "name"),
    [("network", "x"), ("network", "v"), ("network", "memory"), ("mixture", "x")],
)
def test_a_graph_without_one_of_its_inputs_is_told(tmp_path: Path, kind, name, request) -> None:
    model = request.getfixturevalue(f"{kind}_model")
    with pytest.raises(ModelError, match="not usable as a model"):
        Model(without_an_input(model, name, tmp_path / "deaf.onnx"))


@pytest.mark.parametrize("kind", ["network", "mixture"])
def test_a_model_needs_its_global_map(tmp_path: Path, kind, request) -> None:
    model = request.getfixturevalue(f"{kind}_model")
    path = changed(tmp_path / "mapless.onnx", model.path, sensitivity=[])
    with pytest.raises(ModelError, match="sensitivity is not of shape"):
        Model(path)


def test_networks_answer_for_frames_that_lack_nothing_and_for_those_that_do(
    network_model: Model,
) -> None:
    info, random = network_model.info, np.random.default_rng(0)
    count, markers = len(info.tracked), len(info.labels)
    assert network_model.leaves == 0
    assert network_model.width == 3 * count
    still = np.zeros((count, 3), np.float32)
    pose, sigma, velocities = network_model.estimate(still, still)
    assert (pose.shape, sigma.shape, velocities.shape) == ((markers, 3), (markers,), (markers, 3))
    assert (sigma > 0).all()
    for frames in (1, 5):
        present = np.ones((frames, count), np.float32)
        present[:, 0] = 0
        memory = random.normal(size=(frames, 9 * count + 1)).astype(np.float32)
        memory[:, -1] = 0.5
        shown = np.zeros((frames, 3 * count), np.float32)
        recalled, sigma = network_model.recall(shown, present, memory)
        assert (recalled.shape, sigma.shape) == ((frames, count, 3), (frames, count))
        assert (sigma > 0).all()


def test_a_foreign_onnx_file_is_told_from_ours(tmp_path: Path) -> None:
    graph = onnx.load(DEFAULT)
    del graph.metadata_props[:]
    onnx.save(graph, tmp_path / "foreign.onnx")
    with pytest.raises(ModelError, match="not one that `markerbridge train` wrote"):
        Model(tmp_path / "foreign.onnx")


def test_a_copy_elsewhere_is_the_same_model(tmp_path: Path) -> None:
    shutil.copy(DEFAULT, tmp_path / "copy.onnx")
    one, other = Model("default"), Model(tmp_path / "copy.onnx")
    assert one.info == other.info
    tracked, velocity = (
        np.random.default_rng(0).normal(size=(2, len(one.info.tracked), 3)).astype(np.float32)
    )
    here, there = one.estimate(tracked, velocity), other.estimate(tracked, velocity)
    for found, again in zip(here, there, strict=True):
        np.testing.assert_array_equal(found, again)


def test_the_model_leaves_nothing_behind_and_tells_nobody_that_it_is_used(tmp_path: Path) -> None:
    """onnxruntime's telemetry keeps a number for the machine below the user's home."""
    speaks = ("ORT_DISABLE_TELEMETRY", "CI", "XDG_CACHE_HOME", "GITHUB_ACTIONS")
    environment = {name: value for name, value in os.environ.items() if name not in speaks}
    subprocess.run(
        [sys.executable, "-P", "-c", "from bridge.model import Model; Model('default')"],
        env=environment | {"HOME": str(tmp_path)},
        check=True,
    )
    assert list(tmp_path.iterdir()) == []
