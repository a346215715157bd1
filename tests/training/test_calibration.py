"""Adapting a model to one person, and scoring what that gains."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from bridge.estimator import PoseEstimator, body_frame
from bridge.model import Model
from bridge.regression import regression_of
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout, MarkerFrame
from drivers.marker_set import MARKERS
from tests.training.small_models import small_mixture, small_networks
from training.calibration import (
    NOISE,
    SHARE,
    _correction,
    _mixture_errors,
    _network_errors,
    _shown,
    adapted,
    calibrated,
)
from training.dataset import DatasetError
from training.evaluate_command import main
from training.reference import ReferenceModel


@pytest.fixture(scope="module")
def mixture(small_dir, tmp_path_factory) -> Model:
    return small_mixture(tmp_path_factory.mktemp("mixture") / "small.onnx", small_dir, "07")


@pytest.fixture(scope="module")
def networks(data_dir, tmp_path_factory) -> Model:
    """Networks that know nobody of the walk's performer."""
    names = ("02_01", "16_07", "01_01")
    captures = [read_c3d(data_dir / f"real/{name}.c3d").xyz for name in names]
    return small_networks(tmp_path_factory.mktemp("networks") / "small.onnx", captures)


@pytest.fixture(scope="module")
def walk(data_dir) -> np.ndarray:
    return read_c3d(data_dir / "real/07_12.c3d").xyz


@pytest.fixture(scope="module")
def mine(networks, walk, tmp_path_factory) -> Model:
    """The networks, adapted to the first half of the walk."""
    path = tmp_path_factory.mktemp("networks") / "mine.onnx"
    path.write_bytes(calibrated(networks, walk[:130], 120.0))
    return Model(path)


def _errors(model: Model, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    complete = ~np.isnan(xyz).any(axis=(1, 2))
    return _mixture_errors(model, xyz, complete, 120.0)


def _rms(model: Model, xyz: np.ndarray) -> float:
    """What the runtime is off by over the unworn markers, metres."""
    rows = [MARKERS.index(label) for label in model.info.unworn]
    layout = Layout(MARKERS, 120.0)
    estimator = PoseEstimator(model)
    poses = [
        estimator.step(MarkerFrame(index, index / 120, index / 120, layout, frame)).xyz
        for index, frame in enumerate(xyz)
    ]
    off = (np.array(poses) - xyz)[:, rows]
    return float(np.sqrt(np.nanmean(off**2)))


def test_the_map_added_is_the_ridge_of_what_the_mixture_is_off_by(mixture, walk, tmp_path) -> None:
    """Against numpy's least squares with the penalty as further rows, and a forward run."""
    path = tmp_path / "mine.onnx"
    path.write_bytes(calibrated(mixture, walk[:130], 120.0))
    x, off = _errors(mixture, walk[:130])
    penalty = np.sqrt(len(x)) * NOISE * np.eye(x.shape[1], x.shape[1] + 1)
    rows = np.vstack([np.column_stack([x, np.ones(len(x))]), penalty])
    wanted = np.vstack([off, np.zeros((x.shape[1], off.shape[1]))])
    correction, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
    history = np.zeros((0, mixture.leaves), np.float32)
    reference = ReferenceModel(mixture.path)
    for frame in x[::20]:
        before, p = reference.run(frame[None], history)
        after, p_after = Model(path).run(frame[None], history)
        np.testing.assert_allclose(p_after, p, atol=1e-6)
        np.testing.assert_allclose(
            after - before, np.append(frame, 1.0)[None] @ correction, atol=1e-4
        )


def test_the_correction_is_the_ridge_of_what_the_network_is_off_by() -> None:
    """Against least squares with the penalty as further rows; fewer frames than units, and more."""
    random = np.random.default_rng(0)
    for frames in (20, 200):
        units = np.column_stack([random.normal(size=(frames, 40)), np.ones(frames)])
        off = random.normal(size=(frames, 6))
        power = (units[:, :-1] ** 2).sum() / frames
        penalty = np.sqrt(SHARE * frames * np.append(np.full(40, power), 1.0))
        rows = np.vstack([units, np.diag(penalty)])
        wanted, *_ = np.linalg.lstsq(rows, np.vstack([off, np.zeros((41, 6))]), rcond=None)
        np.testing.assert_allclose(_correction(units, off), wanted, atol=1e-9)


def test_the_correction_is_what_the_file_says_more(networks, mine, walk) -> None:
    """Of frames that lack no marker and of frames that lack one, by a forward run of both files."""
    complete = ~np.isnan(walk).any(axis=(1, 2))
    complete[130:] = False
    file = onnx.load(str(networks.path))
    constants = {entry.name: numpy_helper.to_array(entry) for entry in file.graph.initializer}
    whole, lacking = _shown(networks, walk[:130], complete[:130])
    units, off = _network_errors(networks, constants, "whole", whole)
    moved = mine.regress(whole.features, whole.present)[0]
    moved = moved - networks.regress(whole.features, whole.present)[0]
    np.testing.assert_allclose(moved, units @ _correction(units, off), atol=1e-4)
    for label, frames in zip(networks.info.tracked, lacking, strict=True):
        assert (frames.present.sum(axis=1) == len(lacking) - 1).all()
        row = MARKERS.index(label)
        columns = slice(3 * row, 3 * row + 3)
        units, off = _network_errors(networks, constants, "part", frames)
        moved = mine.regress(frames.features, frames.present)[0]
        moved = moved - networks.regress(frames.features, frames.present)[0]
        expected = units @ _correction(units, off[:, columns])
        np.testing.assert_allclose(moved[:, columns], expected, atol=1e-4)


def test_the_estimate_comes_nearer_on_the_rest_of_the_walk(mixture, networks, mine, walk) -> None:
    for before, after in (
        (mixture, adapted(mixture, walk[:130], 120.0)),
        (networks, mine),
    ):
        assert _rms(after, walk[130:]) < 0.7 * _rms(before, walk[130:])
        assert after.info.training["calibrated_frames"] > 100
        assert after.info.training["calibrated_seconds"] > 0.8


def test_a_missing_marker_is_guessed_nearer(networks, mine, walk) -> None:
    tracked = networks.info.tracked
    hidden = tracked.index("LANK")
    rows = [MARKERS.index(label) for label in tracked]
    present = np.arange(len(tracked)) != hidden
    off = []
    for one in (networks, mine):
        body, regression = body_frame(one.info), regression_of(one, 0)
        guesses = []
        for frame in walk[130:, rows]:
            body.update(frame)
            seen = body.to_body(frame)
            guessed, _ = regression.guess(seen, present, 0.0)
            guesses.append(guessed[hidden] - seen[hidden])
        off.append(np.sqrt(np.mean(np.square(guesses))))
    assert off[1] < 0.8 * off[0]


def test_sigma_shrinks_within_bounds_and_the_rest_of_the_file_stays(networks, mine) -> None:
    before, after = (
        {
            entry.name: numpy_helper.to_array(entry)
            for entry in onnx.load(str(one.path)).graph.initializer
        }
        for one in (networks, mine)
    )
    assert before.keys() == after.keys()
    changed = {name for name in before if not np.array_equal(before[name], after[name])}
    assert changed == {
        f"{name}_last_{part}" for name in ("whole", "part") for part in ("weights", "bias")
    }
    x, present = np.zeros((1, networks.width), np.float32), np.ones((1, 9), np.float32)
    shrinks = mine.regress(x, present)[1] / networks.regress(x, present)[1]
    np.testing.assert_allclose(shrinks, shrinks[0, 0], rtol=1e-4)
    assert 0.5 < shrinks[0, 0] < 0.99  # a second of walking does not tell everything


def test_too_few_whole_frames_are_refused(mixture, networks, walk) -> None:
    for one in (mixture, networks):
        with pytest.raises(DatasetError, match=r"needs 0.25 s with all 41 .*there are 0.12 s"):
            calibrated(one, walk[:20], 120.0)


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
    assert "left out: holed.c3d: calibration needs 0.25 s" in capsys.readouterr().err


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
