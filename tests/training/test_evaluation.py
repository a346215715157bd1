import json
import math
import subprocess
import sys

import numpy as np
import pytest

from bridge.model import Model
from drivers.errors import MarkerbridgeError, UsageError
from drivers.marker_set import MARKERS
from simulators.corruption import Faults, Gaps
from training.dataset import load, load_training
from training.evaluate_command import main
from training.evaluation import evaluate, report
from training.nearest_neighbour import NearestNeighbour
from training.poses import body_poses

SCORES = ("rms_mm", "rms_all_mm", "jerk_mm", "roughness")
BASELINE = ("nn_rms_mm", "nn_jerk_mm", "rms_ratio", "jerk_ratio")


@pytest.fixture(scope="module")
def model():
    return Model("default")


@pytest.fixture(scope="module")
def takes(small_dir):
    return load(small_dir, None, print)


@pytest.fixture(scope="module")
def baseline(small_dir, model):
    poses = [body_poses(take.xyz) for take in load_training(small_dir, print)]
    return NearestNeighbour(np.concatenate(poses), model.info)


def run(capsys, *argv):
    status = main([str(word) for word in argv])
    return status, capsys.readouterr().out


def test_the_json_is_as_documented(small_dir, tmp_path, capsys):
    file = tmp_path / "out.json"
    status, shown = run(
        capsys, "default", small_dir, "--split", "test", "--train", small_dir, "--json", file
    )
    found = json.loads(file.read_text(), parse_constant=pytest.fail)
    assert status == 0
    assert set(found) == {"mean", "sequences", "sigma", "latency_us"}
    one, two = (found["sigma"][f"within_{n}"] for n in (1, 2))
    assert 0 < one["mean"] < two["mean"] < 1
    assert set(one["markers"]) == set(Model("default").info.unworn)
    assert set(found["mean"]) == {*SCORES, *BASELINE}
    (row,) = found["sequences"]
    assert set(row) == {"file", "frames", *SCORES, *BASELINE}
    assert (row["file"], row["frames"]) == ("real/07_12.c3d", 263)
    assert {name: row[name] for name in found["mean"]} == pytest.approx(found["mean"])
    assert row["rms_ratio"] == pytest.approx(row["rms_mm"] / row["nn_rms_mm"])
    assert row["jerk_ratio"] == pytest.approx(row["jerk_mm"] / row["nn_jerk_mm"])
    assert 0 < found["latency_us"]["p50"] <= found["latency_us"]["p99"]
    assert "07_12" in shown
    assert f"{row['rms_mm']:.1f}" in shown


def test_without_training_poses_the_baseline_is_null(small_dir, tmp_path, capsys):
    file = tmp_path / "out.json"
    run(capsys, "default", small_dir, "--json", file)
    found = json.loads(file.read_text())
    assert len(found["sequences"]) == 5
    for row in (found["mean"], *found["sequences"]):
        assert [row[name] for name in BASELINE] == [None] * 4
        assert all(row[name] > 0 for name in SCORES)
    assert found["mean"]["rms_mm"] == pytest.approx(
        np.mean([row["rms_mm"] for row in found["sequences"]])
    )


def test_the_baseline_finds_a_training_capture_itself(model, takes, baseline):
    """Searched among its own poses, a complete capture is found exactly, back in the world."""
    known = next(take for take in takes if take.name == "real/07_01.c3d")
    (result,) = evaluate(model, [known], baseline=baseline)
    assert not np.isnan(known.xyz).any()
    assert result.scores.nn_rms_mm < 0.01
    assert result.scores.nn_jerk_mm < 0.01
    assert result.scores.rms_mm > 1.0


def test_measured_markers_count_as_exact_over_all_41(model, takes):
    for result in evaluate(model, takes[:1]):
        unworn, all_markers = result.scores.rms_mm, result.scores.rms_all_mm
        assert all_markers == pytest.approx(unworn * math.sqrt(32 / 41), rel=1e-3)


def test_faults_are_those_of_the_sequence_whatever_the_order(model, takes, baseline):
    faults = Faults(noise=0.002, drop=0.05, gaps=Gaps(0.2, 10, 100))

    def scores(takes, seed=0):
        results = evaluate(model, takes, faults, seed, baseline)
        return {result.file: result.scores for result in results}

    first = scores(takes)
    assert scores(takes[::-1]) == first
    assert scores(takes[1:2]) == {takes[1].name: first[takes[1].name]}
    assert scores(takes, seed=1) != first


def test_faults_make_it_worse_and_each_option_arrives(small_dir, tmp_path, capsys):
    def mean(*options):
        file = tmp_path / "out.json"
        run(capsys, "default", small_dir, "--split", "test", "--json", file, *options)
        return json.loads(file.read_text())["mean"]

    clean = mean()
    assert mean("--noise", "2mm")["jerk_mm"] > clean["jerk_mm"] + 1
    assert mean("--drop", "30%")["rms_all_mm"] > clean["rms_all_mm"]
    gaps = mean("--gaps", "30%:10-100")
    assert gaps["rms_mm"] > clean["rms_mm"]
    assert mean("--gaps", "30%:10-100", "--seed", "1") != gaps


def test_missing_truth_gives_null_and_valid_json(model, takes):
    take = takes[0]
    truth = take.xyz[:30].copy()
    truth[:, [MARKERS.index(label) for label in model.info.unworn]] = np.nan
    blind = type(take)(take.name, "x", "", "", True, 120.0, truth)
    found = report(evaluate(model, [blind]), model.info.unworn)
    assert [found["mean"][name] for name in SCORES] == [None, pytest.approx(0.0), None, None]
    json.dumps(found, allow_nan=False)
    short = type(take)(take.name, "x", "", "", True, 120.0, take.xyz[:3])
    assert report(evaluate(model, [short]), model.info.unworn)["latency_us"] == {
        "p50": None,
        "p99": None,
    }


def test_wrong_usage_and_what_cannot_be_read(small_dir, tmp_path, capsys):
    with pytest.raises(UsageError, match="no split 'nope'"):
        main(["default", str(small_dir), "--split", "nope"])
    with pytest.raises(UsageError, match=r"no manifest\.csv"):
        main(["default", str(small_dir / "real"), "--split", "test"])
    with pytest.raises(MarkerbridgeError, match="no such folder"):
        main(["default", str(tmp_path / "gone")])
    with pytest.raises(MarkerbridgeError, match="no such model"):
        main([str(tmp_path / "gone.onnx"), str(small_dir)])
    with pytest.raises(MarkerbridgeError, match="cannot write"):
        main(["default", str(small_dir), "--json", str(tmp_path / "no" / "f.json")])
    for wrong in (["--noise", "2"], ["--drop", "5"], ["--gaps", "20%"], ["--hide", "C7"]):
        with pytest.raises(SystemExit) as leaving:
            main(["default", str(small_dir), *wrong])
        assert leaving.value.code == 2
        assert "error:" in capsys.readouterr().err


def test_a_plain_install_is_enough():
    code = "import sys, training.evaluate_command; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"sklearn", "onnx", "skl2onnx", "joblib", "scipy"} & set(done.stdout.split())
