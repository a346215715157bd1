from __future__ import annotations

import json
import shutil
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


def test_a_description_of_other_markers_than_the_graph_is_told(tmp_path: Path) -> None:
    """As many as the description needs, but not those that the graph takes."""
    info = Model("default").info
    fewer = info.labels[:-1]
    path = changed(tmp_path / "fewer.onnx", labels=fewer, sigma=info.sigma[:-1])
    with pytest.raises(ModelError, match="the graph gives shapes"):
        Model(path)


def test_a_mixture_needs_its_global_map(tmp_path: Path, mixture_model: Model) -> None:
    assert isinstance(mixture_model.path, Path)
    path = changed(tmp_path / "mapless.onnx", mixture_model.path, sensitivity=[])
    with pytest.raises(ModelError, match="sensitivity is not of shape"):
        Model(path)


def test_a_foreign_onnx_file_is_told_from_ours(tmp_path: Path) -> None:
    graph = onnx.load(DEFAULT)
    del graph.metadata_props[:]
    onnx.save(graph, tmp_path / "foreign.onnx")
    with pytest.raises(ModelError, match="not one that `markerbridge train` wrote"):
        Model(tmp_path / "foreign.onnx")


def test_a_copy_elsewhere_is_the_same_model(tmp_path: Path) -> None:
    shutil.copy(DEFAULT, tmp_path / "copy.onnx")
    one, other = Model("default"), Model(tmp_path / "copy.onnx")
    x = np.random.default_rng(0).normal(size=(1, one.width)).astype(np.float32)
    present = np.ones((1, len(one.info.tracked)), np.float32)
    for here, there in zip(one.regress(x, present), other.regress(x, present), strict=True):
        np.testing.assert_array_equal(here, there)
