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


def changed(path: Path, **entries: object) -> Path:
    """The default model with entries of its description replaced."""
    graph = onnx.load(DEFAULT)
    for entry in graph.metadata_props:
        if entry.key == METADATA_KEY:
            entry.value = json.dumps(json.loads(entry.value) | entries)
    onnx.save(graph, path)
    return path


def test_the_default_model_tracks_the_papers_markers() -> None:
    info = Model("default").info
    assert info.principal == ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")
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


def test_a_foreign_onnx_file_is_told_from_ours(tmp_path: Path) -> None:
    graph = onnx.load(DEFAULT)
    del graph.metadata_props[:]
    onnx.save(graph, tmp_path / "foreign.onnx")
    with pytest.raises(ModelError, match="not one that `markerbridge train` wrote"):
        Model(tmp_path / "foreign.onnx")


def test_a_copy_elsewhere_is_the_same_model(tmp_path: Path) -> None:
    shutil.copy(DEFAULT, tmp_path / "copy.onnx")
    x = np.random.default_rng(0).normal(size=(1, 24)).astype(np.float32)
    history = np.zeros((0, Model("default").leaves), np.float32)
    for one, two in zip(
        Model("default").run(x, history), Model(tmp_path / "copy.onnx").run(x, history), strict=True
    ):
        np.testing.assert_array_equal(one, two)
