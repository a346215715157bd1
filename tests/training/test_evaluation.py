import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.errors import MarkerbridgeError, UsageError
from drivers.marker_set import MARKERS
from simulators.corruption import Faults, Gaps
from training.dataset import load, load_training
from training.evaluate_command import main
from training.evaluation import GAMMA_EDGES, evaluate, report, score
from training.nearest_neighbour import NearestNeighbour
from training.poses import body_poses

FACTS = ("file", "subject", "motion", "category", "performer", "frames")
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
    groups = {"categories", "performers"}
    assert set(found) == {"mean", *groups, "sequences", "sigma", "latency_us"}
    one, two = (found["sigma"][f"within_{n}"] for n in (1, 2))
    assert 0 < one["mean"] < two["mean"] < 1
    assert set(one["markers"]) == set(Model("default").info.unworn)
    assert set(found["mean"]) == {*SCORES, *BASELINE}
    (row,) = found["sequences"]
    assert set(row) == {*FACTS, *SCORES, *BASELINE}
    facts = ["real/07_12.c3d", "07", "brisk walk", "walking", row["performer"], 263]
    assert [row[name] for name in FACTS] == facts
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
    assert mean("--noise", "2mm")["jerk_mm"] > clean["jerk_mm"] + 0.1
    assert mean("--drop", "30%")["rms_all_mm"] > clean["rms_all_mm"]
    gaps = mean("--gaps", "30%:10-100")
    assert gaps["rms_mm"] > clean["rms_mm"]
    assert mean("--gaps", "30%:10-100", "--seed", "1") != gaps


def test_missing_truth_gives_null_and_valid_json(model, takes):
    take = takes[0]
    truth = take.xyz[:30].copy()
    truth[:, [MARKERS.index(label) for label in model.info.unworn]] = np.nan
    blind = type(take)(take.name, "x", "", "", True, 120.0, truth)
    found = report(evaluate(model, [blind]), model.info)
    assert [found["mean"][name] for name in SCORES if name != "rms_all_mm"] == [None] * 3
    assert found["mean"]["rms_all_mm"] < 3  # of worn markers alone: what the filter makes of them
    json.dumps(found, allow_nan=False)
    short = type(take)(take.name, "x", "", "", True, 120.0, take.xyz[:3])
    assert report(evaluate(model, [short]), model.info)["latency_us"] == {
        "p50": None,
        "p99": None,
    }


def test_groups_are_means_over_their_sequences(model, takes):
    trained = replace(model.info, training={"performers": ["02", "16"]})
    results = evaluate(model, takes)
    found = report(results, trained)
    kinds = {"walking": ["02_01", "07_01", "07_12", "walking_t1"], "jumping": ["16_07"]}
    known = {"new": ["07_01", "07_12"], "seen": ["02_01", "16_07"], "unknown": ["walking_t1"]}
    rms = {Path(result.file).stem: result.scores.rms_mm for result in results}
    frames = {Path(take.name).stem: len(take.xyz) for take in takes}
    for name, groups in (("categories", kinds), ("performers", known)):
        assert list(found[name]) == list(groups)  # the largest first
        for group, files in groups.items():
            row = found[name][group]
            assert row["rms_mm"] == pytest.approx(sum(rms[file] for file in files) / len(files))
            assert row["sequences"] == len(files)
            assert row["frames"] == sum(frames[file] for file in files)
            assert row["nn_rms_mm"] is None
    untold = replace(model.info, training={})
    assert list(report(results, untold)["performers"]) == ["unknown"]


def test_the_trace_is_the_scores_frame_by_frame(model, takes, baseline):
    for result in evaluate(model, takes, baseline=baseline):
        scores, trace, nearest = result.scores, result.trace, result.nn_trace
        assert len(trace.rms) == len(nearest.jerk) == len(result.transition) == result.frames
        assert np.nanmean(trace.rms) == pytest.approx(scores.rms_mm)
        assert np.nanmean(nearest.rms) == pytest.approx(scores.nn_rms_mm)
        assert np.isnan(trace.jerk[0])
        # By frames and not by samples: the same but for frames that lack some of the truth.
        assert np.nanmean(trace.jerk) == pytest.approx(scores.jerk_mm, rel=0.05)
        assert np.nanmean(nearest.jerk) == pytest.approx(scores.nn_jerk_mm, rel=0.05)


def test_velocity_errors_are_counted_at_transitions_and_apart(mixture_model, takes):
    model = mixture_model
    take = next(take for take in takes if take.split == "test")
    (result,) = evaluate(model, [take])
    unworn = take.xyz[:, [MARKERS.index(label) for label in model.info.unworn]]
    there = ~np.isnan(unworn[..., 0])
    both = (there[1:] & there[:-1]).sum(axis=1)
    assert 0 < result.transition[1:].sum() < len(both)
    assert result.gamma.sum(axis=1).tolist() == [
        both[~result.transition[1:]].sum(),
        both[result.transition[1:]].sum(),
    ]
    middles = GAMMA_EDGES[:-1] + 0.5
    mean = result.gamma.sum(axis=0) @ middles / result.gamma.sum()
    assert mean == pytest.approx(result.scores.jerk_mm, abs=0.5)


def test_without_the_mixture_it_is_rougher_and_transitions_are_single_frames(mixture_model, takes):
    model = mixture_model
    tests = [take for take in takes if take.split == "test"]
    (mixed,) = evaluate(model, tests)
    (plain,) = score(PoseEstimator(model, history=0), tests)
    (same,) = score(PoseEstimator(model, history=model.info.history), tests)
    assert same.scores == mixed.scores
    assert plain.scores.roughness > mixed.scores.roughness
    assert plain.scores.rms_mm == pytest.approx(mixed.scores.rms_mm, rel=0.2)
    # The votes are the same: each change of leaf lasts the longer by the mixture.
    changes = np.flatnonzero(plain.transition)
    lasting = {frame + later for frame in changes for later in range(model.info.history + 1)}
    assert 0 < len(changes) < len(lasting)
    assert np.flatnonzero(mixed.transition).tolist() == sorted(
        frame for frame in lasting if frame < mixed.frames
    )


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


WITHOUT = """
import sys

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name in ("sklearn", "onnx", "skl2onnx", "joblib", "scipy", "matplotlib", "jinja2"):
            raise ModuleNotFoundError("No module named " + name, name=name)

sys.meta_path.insert(0, Finder())
import training.evaluate_command
"""


def test_a_plain_install_is_enough():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
