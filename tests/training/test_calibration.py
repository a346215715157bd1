"""Adapting a model to one person, and scoring what that gains."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bridge.model import Model
from drivers.c3d_file import read_c3d, write_c3d
from training.calibration import NOISE, _residuals, calibrated
from training.dataset import DatasetError
from training.evaluate_command import main
from training.reference import ReferenceModel


@pytest.fixture(scope="module")
def model() -> Model:
    return Model("default")


@pytest.fixture(scope="module")
def walk(data_dir) -> np.ndarray:
    return read_c3d(data_dir / "real/07_12.c3d").xyz


def test_the_map_added_is_the_ridge_of_what_the_model_is_off_by(model, walk, tmp_path) -> None:
    """Against numpy's least squares with the penalty as further rows, and a forward run."""
    path = tmp_path / "mine.onnx"
    path.write_bytes(calibrated(model, walk[:130], 120.0))
    x, residual = _residuals(model, walk[:130], 120.0)
    penalty = np.sqrt(len(x)) * NOISE * np.eye(x.shape[1], x.shape[1] + 1)
    rows = np.vstack([np.column_stack([x, np.ones(len(x))]), penalty])
    wanted = np.vstack([residual, np.zeros((x.shape[1], residual.shape[1]))])
    correction, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
    history = np.zeros((0, model.leaves), np.float32)
    for frame in x[::20]:
        before, p = ReferenceModel(model.path).run(frame[None], history)
        after, p_after = Model(path).run(frame[None], history)
        np.testing.assert_allclose(p_after, p, atol=1e-6)
        np.testing.assert_allclose(
            after - before, np.append(frame, 1.0)[None] @ correction, atol=1e-4
        )


def test_the_estimate_comes_nearer_on_the_rest_of_the_walk(model, walk, tmp_path) -> None:
    path = tmp_path / "mine.onnx"
    path.write_bytes(calibrated(model, walk[:130], 120.0))
    before = np.sqrt((_residuals(model, walk[130:], 120.0)[1] ** 2).mean())
    after = np.sqrt((_residuals(Model(path), walk[130:], 120.0)[1] ** 2).mean())
    assert after < 0.7 * before
    assert Model(path).info.training["calibrated_frames"] > 100


def test_too_few_whole_frames_are_refused(model, walk) -> None:
    with pytest.raises(DatasetError, match="needs 30 frames with all 41 markers"):
        calibrated(model, walk[:20], 120.0)


def test_evaluate_scores_the_rest_and_names_what_is_too_short(
    data_dir: Path, tmp_path: Path, capsys
) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for name, frames in (("07_12", None), ("16_57", 100)):
        clip = read_c3d(data_dir / f"real/{name}.c3d")
        write_c3d(folder / f"{name}.c3d", clip.layout, clip.xyz[:frames])
    file = tmp_path / "out.json"
    assert main(["default", str(folder), "--calibrate", "10s", "--json", str(file)]) == 0
    found = json.loads(file.read_text())
    (row,) = found["sequences"]
    assert (row["file"], row["frames"]) == ("07_12.c3d", 263 - 131)
    shown = capsys.readouterr()
    assert "left out: 16_57.c3d: under 1 s" in shown.err
    assert main(["default", str(folder), "--json", str(file)]) == 0
    plain = {r["file"]: r["rms_mm"] for r in json.loads(file.read_text())["sequences"]}
    assert row["rms_mm"] < 0.7 * plain["07_12.c3d"]
    with pytest.raises(SystemExit):
        main(["default", str(folder), "--calibrate", "10"])
    assert "write for example 10s" in capsys.readouterr().err


def test_a_capture_without_whole_frames_is_left_out_and_the_others_scored(
    data_dir: Path, tmp_path: Path, capsys
) -> None:
    clip = read_c3d(data_dir / "real/07_12.c3d")
    holed = clip.xyz.copy()
    holed[:, 0] = np.nan
    write_c3d(tmp_path / "holed.c3d", clip.layout, holed)
    write_c3d(tmp_path / "whole.c3d", clip.layout, clip.xyz)
    file = tmp_path / "out.json"
    assert main(["default", str(tmp_path), "--calibrate", "10s", "--json", str(file)]) == 0
    assert [row["file"] for row in json.loads(file.read_text())["sequences"]] == ["whole.c3d"]
    assert "left out: holed.c3d: calibration needs 30 frames" in capsys.readouterr().err


def test_without_the_extra_it_says_what_to_install(data_dir: Path, tmp_path: Path) -> None:
    shutil.copy(data_dir / "real/07_12.c3d", tmp_path)
    code = (
        "import sys; sys.modules['onnx'] = None; from bridge.cli import main; "
        f"sys.exit(main(['evaluate', 'default', {str(tmp_path)!r}, '--calibrate', '10s']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "onnx is not installed: pip install 'markerbridge[train]'" in done.stderr
    assert "Traceback" not in done.stderr
