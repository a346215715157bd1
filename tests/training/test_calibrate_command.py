"""`markerbridge calibrate`: the file it writes, what it tells, and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from bridge.model import Model
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout
from drivers.marker_set import MARKERS
from tests.training.small_models import small_mixture, small_networks


@pytest.fixture(scope="module")
def networks(data_dir, tmp_path_factory) -> str:
    """The file of networks that know nobody of the walk's performer."""
    path = tmp_path_factory.mktemp("networks") / "small.onnx"
    small_networks(path, data_dir, ("02_01", "16_07", "01_01"))
    return str(path)


@pytest.fixture(scope="module")
def mixture(small_dir, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("mixture") / "small.onnx"
    small_mixture(path, small_dir, "07")
    return str(path)


@pytest.fixture
def walk(data_dir: Path) -> str:
    return str(data_dir / "real/07_12.c3d")


@pytest.mark.parametrize("kind", ["mixture", "networks"])
def test_a_model_is_written_and_what_it_gained_told(kind, walk, tmp_path, capsys, request) -> None:
    model = request.getfixturevalue(kind)
    out, file = tmp_path / "mine.onnx", tmp_path / "gain.json"
    assert main(["calibrate", model, walk, "--out", str(out), "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    held = found["held_out"]
    assert held["calibrated"]["rms_mm"] < 0.8 * held["generic"]["rms_mm"]
    assert held["frames"] == pytest.approx(263 / 3, abs=5)
    mine = Model(out).info
    assert mine.tracked == Model(model).info.tracked
    assert mine.training["calibrated_frames"] == found["calibrated_frames"] > 250
    shown = capsys.readouterr()
    assert f"{held['calibrated']['rms_mm']:.1f}" in shown.out
    assert "mine.onnx: adapted to" in shown.err
    assert "gained nothing" not in shown.err


def test_the_recording_is_taken_for_so_long(networks, walk, tmp_path) -> None:
    out, file = tmp_path / "mine.onnx", tmp_path / "gain.json"
    argv = ["calibrate", networks, walk, "--out", str(out), "--json", str(file)]
    assert main([*argv, "--seconds", "1.5"]) == 0
    found = json.loads(file.read_text())
    assert found["calibrated_seconds"] <= 1.5
    assert Model(out).info.training["calibrated_frames"] <= 180


def test_a_recording_that_gains_nothing_is_warned_of(networks, walk, tmp_path, capsys) -> None:
    """The knees sit elsewhere until the last third: what was learned before is wrong there."""
    clip = read_c3d(walk)
    xyz = clip.xyz.copy()
    knees = [MARKERS.index(label) for label in ("LKNE", "RKNE")]
    xyz[:150, knees, 2] += 2.0
    write_c3d(tmp_path / "moved.c3d", clip.layout, xyz)
    out = tmp_path / "mine.onnx"
    assert main(["calibrate", networks, str(tmp_path / "moved.c3d"), "--out", str(out)]) == 0
    assert "gained nothing" in capsys.readouterr().err
    assert out.is_file()


def _refused(capsys, status: int, *argv: str) -> str:
    assert main(["calibrate", *argv]) == status
    told = capsys.readouterr().err
    assert told.startswith("markerbridge calibrate: error: ")
    assert told.count("\n") == 1
    return told


def test_what_cannot_be_done_is_told_in_one_line(walk, tmp_path, capsys) -> None:
    out = ("--out", str(tmp_path / "mine.onnx"))
    text = tmp_path / "walk.txt"
    text.write_text("no capture")
    clip = read_c3d(walk)
    few, holed = tmp_path / "few.c3d", tmp_path / "holed.c3d"
    write_c3d(few, Layout(MARKERS[:39], 120.0), clip.xyz[:, :39])
    xyz = clip.xyz.copy()
    xyz[60:, MARKERS.index("LFIN")] = np.nan
    write_c3d(holed, clip.layout, xyz)
    assert "not a readable C3D file" in _refused(capsys, 1, "default", str(text), *out)
    lacking = _refused(capsys, 1, "default", str(few), *out)
    assert f"lacks the markers {MARKERS[39]}, {MARKERS[40]}" in lacking
    short = _refused(capsys, 1, "default", str(holed), *out)
    assert "needs 1 s with all 41 markers" in short
    assert "missing most often: LFIN" in short
    assert "no such model file" in _refused(capsys, 1, "none.onnx", walk, *out)
    assert "not a whole ONNX file" in _refused(capsys, 1, str(text), walk, *out)
    assert "ends in .onnx" in _refused(capsys, 2, "default", walk, "--out", "mine")
    nowhere = str(tmp_path / "none" / "mine.onnx")
    assert "no such folder" in _refused(capsys, 1, "default", walk, "--out", nowhere)
    json_nowhere = ("--json", str(tmp_path / "none" / "gain.json"))
    assert "no such folder" in _refused(capsys, 1, "default", walk, *out, *json_nowhere)
    brief = _refused(capsys, 2, "default", walk, *out, "--seconds", "0.5")
    assert "--seconds 0.5" in brief
    assert not (tmp_path / "mine.onnx").exists()
