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

from bridge.estimator import PoseEstimator
from bridge.humanoid.body import measured
from bridge.model import Model
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout, MarkerFrame
from drivers.marker_set import MARKERS
from tests.training.small_models import small_mixture, small_networks
from training.calibration import (
    MAX_FRAMES,
    NOISE,
    SHARE,
    _correction,
    _mixture_errors,
    _pose_errors,
    _seen,
    _velocity_errors,
    adapted,
    calibrated,
)
from training.dataset import DatasetError
from training.evaluate_command import main
from training.poses import body_poses
from training.reference import ReferenceModel


@pytest.fixture(scope="module")
def mixture(small_dir, tmp_path_factory) -> Model:
    return small_mixture(tmp_path_factory.mktemp("mixture") / "small.onnx", small_dir, "07")


@pytest.fixture(scope="module")
def networks(data_dir, tmp_path_factory) -> Model:
    """Networks that know nobody of the walk's performer."""
    path = tmp_path_factory.mktemp("networks") / "small.onnx"
    return small_networks(path, data_dir, ("02_01", "16_07", "01_01"))


@pytest.fixture(scope="module")
def walk(data_dir) -> np.ndarray:
    return read_c3d(data_dir / "real/07_12.c3d").xyz


@pytest.fixture(scope="module")
def mine(networks, walk, tmp_path_factory) -> Model:
    """The networks, adapted to the first half of the walk."""
    path = tmp_path_factory.mktemp("networks") / "mine.onnx"
    path.write_bytes(calibrated(networks, walk[:130], 120.0))
    return Model(path)


def test_it_knows_how_the_person_is_built(mine, networks, walk) -> None:
    assert networks.info.proportions is None
    order = [MARKERS.index(label) for label in mine.info.labels]
    build = measured(mine.info.labels, walk[:130, order][::7])
    np.testing.assert_allclose(mine.info.proportions, build.values, atol=0.02)


def _errors(model: Model, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    complete = ~np.isnan(xyz).any(axis=(1, 2))
    return _mixture_errors(model, xyz, complete, 120.0)


def _constants(model: Model) -> dict[str, np.ndarray]:
    file = onnx.load(str(model.path))
    return {entry.name: numpy_helper.to_array(entry) for entry in file.graph.initializer}


def _shown(model: Model, xyz: np.ndarray) -> np.ndarray:
    """The tracked markers of whole frames (N, 41, 3), in the body frame."""
    return body_poses(xyz)[:, [MARKERS.index(label) for label in model.info.tracked]]


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


def test_the_corrections_are_what_the_file_says_more(networks, mine, walk) -> None:
    """By a forward run of both files, also on frames that it was not adapted to."""
    constants = _constants(networks)
    few, every = _seen(networks, walk[:130], 120.0), _seen(networks, walk, 120.0)
    pose = _correction(*_pose_errors(networks, constants, few))
    moving = _correction(*_velocity_errors(networks, constants, few))
    units, _ = _pose_errors(networks, constants, every)
    weighted, _ = _velocity_errors(networks, constants, every)
    moving_units = weighted / weighted[:, -1:]  # the last is the constant
    assert len(every.tracked) > len(few.tracked)
    for row, (tracked, velocity) in enumerate(zip(every.tracked, every.moving, strict=True)):
        before, after = (one.estimate(tracked, velocity) for one in (networks, mine))
        np.testing.assert_allclose((after[0] - before[0]).ravel(), units[row] @ pose, atol=1e-4)
        speed = np.sqrt((velocity**2).mean() + constants["slow"])
        changed = (after[2] - before[2]).ravel() / speed
        np.testing.assert_allclose(changed, moving_units[row] @ moving, atol=1e-3)


def test_errors_of_velocity_are_told_in_the_bodys_speed(networks, walk) -> None:
    """What is fitted is the truth less what the file says, for each frame as much as its speed."""
    constants, seen = _constants(networks), _seen(networks, walk, 120.0)
    units, off = _velocity_errors(networks, constants, seen)
    row = 40
    said = networks.estimate(seen.tracked[row], seen.moving[row])[2].ravel()
    speeds = np.sqrt((seen.moving**2).mean(axis=(1, 2)) + constants["slow"])
    wanted = (seen.velocities[row] - said) / speeds[row] * units[row, -1]
    np.testing.assert_allclose(off[row], wanted, atol=1e-4)
    np.testing.assert_allclose(units[:, -1] ** 2, speeds / speeds.mean(), rtol=1e-4)


def test_of_a_long_recording_frames_are_taken_evenly(networks, walk) -> None:
    complete = walk[~np.isnan(walk).any(axis=(1, 2))]
    long = np.concatenate([complete] * 4)
    assert len(long) > MAX_FRAMES
    seen = _seen(networks, long, 120.0)
    chosen = np.linspace(0, len(long) - 1, MAX_FRAMES).round().astype(int)
    every = _shown(networks, complete)
    np.testing.assert_allclose(seen.tracked, every[chosen % len(complete)], atol=1e-5)


def test_the_estimate_comes_nearer_on_the_rest_of_the_walk(mixture, networks, mine, walk) -> None:
    for before, after in (
        (mixture, adapted(mixture, walk[:130], 120.0)),
        (networks, mine),
    ):
        assert _rms(after, walk[130:]) < 0.7 * _rms(before, walk[130:])
        assert after.info.training["calibrated_frames"] > 100
        assert after.info.training["calibrated_seconds"] > 0.8


def test_only_last_layers_change_and_sigma_shrinks(networks, mine, walk) -> None:
    before, after = _constants(networks), _constants(mine)
    assert before.keys() == after.keys()
    changed = {name for name in before if not np.array_equal(before[name], after[name])}
    assert changed == {
        f"{name}_last_{part}" for name in ("pose", "velocity") for part in ("weights", "bias")
    }
    # Of the weights, those of the hidden units: what the markers say by themselves stays.
    width = len(before["mean"])
    for name, inputs in (("pose", width), ("velocity", 2 * width)):
        weights = [one[f"{name}_last_weights"][-inputs:] for one in (before, after)]
        np.testing.assert_array_equal(*weights)
    tracked, other = _shown(networks, walk)[[5, 50]]
    (_, sigma, _), (_, less, _) = (
        one.estimate(tracked, tracked - other) for one in (networks, mine)
    )
    shrinks = less / sigma
    np.testing.assert_allclose(shrinks, shrinks[0], rtol=1e-4)
    assert 0.5 < shrinks[0] < 0.99  # a second of walking does not tell everything


def test_where_a_missing_marker_is_is_told_by_its_last_sighting_as_before(networks, mine) -> None:
    markers = len(networks.info.tracked)
    random = np.random.default_rng(0)
    x, memory = random.normal(0, 0.3, (5, 3 * markers)), random.random((5, 9 * markers + 1))
    present = np.float32(random.random((5, markers)) < 0.5)
    present[:, 0] = 0.0
    fed = x.astype(np.float32), present, memory.astype(np.float32)
    for before, after in zip(networks.recall(*fed), mine.recall(*fed), strict=True):
        np.testing.assert_array_equal(before, after)


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
