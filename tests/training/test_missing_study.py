"""How many markers may be missing: the ways of filling in, what is hidden, and the study."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from bridge.model import Model
from drivers.errors import UsageError
from simulators.corruption import Faults, Gaps
from training.dataset import Take, load, load_training
from training.evaluate_command import main
from training.evaluation import evaluate
from training.missing_study import (
    DROP,
    EXPERIMENTS,
    GAP,
    METHODS,
    NUMBER,
    STEPS,
    Extrapolation,
    lacking,
    methods_of,
    missing_study,
)
from training.poses import body_poses
from training.report.missing import add_missing, missing_figure
from training.report.page import Report


@pytest.fixture(scope="module")
def model(mixture_model) -> Model:
    """One that has a forest."""
    return mixture_model


@pytest.fixture(scope="module")
def poses(small_dir):
    return np.concatenate([body_poses(take.xyz) for take in load_training(small_dir, print)])


@pytest.fixture(scope="module")
def take(data_dir) -> Take:
    """24 s of a real capture that lacks nothing."""
    return next(one for one in load(data_dir, "test", print) if "HDM_bd" in one.name)


@pytest.fixture(scope="module")
def short(take) -> Take:
    return replace(take, xyz=take.xyz[:100])


@pytest.fixture(scope="module")
def study(model, poses, short):
    told = []
    scores = missing_study(model, [short], poses, 0, lambda what, units: told.append(units))
    assert sum(told) == STEPS
    return scores


def path(method, seen: list[float], interval: float = 1 / 120) -> np.ndarray:
    """Where one marker is filled in, x alone; NaN: missing."""
    xyz = np.zeros((len(seen), 1, 3), np.float32)
    xyz[:, 0, 0] = seen
    xyz[np.isnan(seen)] = np.nan
    return np.array([method.fill(frame, ~np.isnan(frame[:, 0]), interval)[0, 0] for frame in xyz])


def test_before_it_is_seen_a_marker_is_at_its_mean() -> None:
    method = Extrapolation([[0.3, 0, 0]])
    np.testing.assert_allclose(path(method, [np.nan, np.nan, 0.5, np.nan]), [0.3, 0.3, 0.5, 0.5])
    method.reset()
    np.testing.assert_allclose(path(method, [np.nan]), [0.3])


def test_a_marker_goes_on_as_it_went_and_comes_to_rest() -> None:
    """At 1 m/s and a time constant of 0.1 s it goes on for 0.1 m in all, and for 1 - 1/e of that
    in the first 0.1 s.
    """
    interval, damping = 0.01, 0.1
    seen = [-0.02, -0.01, 0.0] + [np.nan] * 200
    found = path(Extrapolation([[0, 0, 0]], damping), seen, interval)[2:]
    assert found[10] == pytest.approx(0.1 * (1 - np.exp(-1)), rel=1e-4)
    assert found[-1] == pytest.approx(0.1, rel=1e-4)
    assert (np.diff(found) >= 0).all()
    assert found[1] == pytest.approx(0.01, rel=0.06)


def test_a_velocity_is_over_the_time_since_it_was_seen() -> None:
    seen = [0.0, np.nan, np.nan, 0.03, np.nan]
    found = path(Extrapolation([[0, 0, 0]], 1e6), seen, 0.01)
    np.testing.assert_allclose(found, [0, 0, 0, 0.03, 0.04], atol=1e-6)
    np.testing.assert_allclose(path(Extrapolation([[0, 0, 0]], 0), seen)[4], 0.03)


@pytest.mark.parametrize("count", [0, 1, 4])
def test_so_many_are_hidden_every_other_second(model, take, count) -> None:
    measured = lacking(take, model.info, NUMBER, count, 0)
    hidden = np.isnan(measured).all(axis=2)
    second = (np.arange(len(hidden)) - 60) // 120
    for number in range(-1, second[-1] + 1):
        of_second = hidden[second == number]
        assert (of_second == of_second[0]).all()
        assert of_second[0].sum() == (0 if number % 2 else count)
    more = np.isnan(lacking(take, model.info, NUMBER, count + 1, 0)).all(axis=2)
    assert more[hidden].all()
    other = np.isnan(lacking(take, model.info, NUMBER, count, 1)).all(axis=2)
    assert bool((other != hidden).any()) == bool(count)


@pytest.mark.parametrize("rate", [120.0, 60.0])
def test_gaps_have_the_length_asked_for_at_any_rate(model, take, rate) -> None:
    take = replace(take, rate=rate)
    hidden = np.isnan(lacking(take, model.info, GAP, 40, 0)[:, :, 0])
    assert hidden.mean() == pytest.approx(0.2, abs=0.05)
    for marker in hidden.T:
        starts, ends = (np.flatnonzero(np.diff(marker.astype(int)) == step) for step in (1, -1))
        ends = ends[ends > starts[0]]
        whole = ends - starts[: len(ends)]
        assert len(whole) > 5
        # Two gaps may follow each other with no frame between.
        assert (whole % (40 * rate / 120) == 0).all()


def test_drops_are_a_share_of_the_samples(model, take) -> None:
    hidden = np.isnan(lacking(take, model.info, DROP, 30, 0)[:, :, 0])
    assert hidden.mean() == pytest.approx(0.3, abs=0.01)


def test_with_nothing_missing_all_are_as_plainly_evaluated(model, short, study) -> None:
    (result,) = evaluate(model, [short])
    clean = [score for score in study if (score.experiment, score.value) == (NUMBER, 0)]
    assert [score.method for score in clean] == list(METHODS)
    for score in clean:
        assert score.rms_mm == result.scores.rms_mm
        assert score.jerk_mm == result.scores.jerk_mm
        assert score.rms_missing_mm is None


def test_the_bridge_is_scored_as_the_bridge_is_evaluated(model, short, study) -> None:
    """The same faults through `evaluate`, which knows nothing of the study."""
    for experiment, value, faults in (
        (DROP, 30, Faults(drop=0.3)),
        (GAP, 20, Faults(gaps=Gaps(0.2, 20, 20))),
    ):
        (result,) = evaluate(model, [short], faults)
        (score,) = (
            one
            for one in study
            if (one.method, one.experiment, one.value) == ("bridge", experiment, value)
        )
        assert (score.rms_mm, score.jerk_mm) == (result.scores.rms_mm, result.scores.jerk_mm)


def test_the_share_that_was_missing_is_told(model, study, short) -> None:
    for score in study:
        measured = lacking(short, model.info, score.experiment, score.value, 0)
        assert score.missing_percent == pytest.approx(100 * np.isnan(measured[:, :, 0]).mean())


def test_there_is_a_row_for_each_and_the_methods_differ(study) -> None:
    rows = [(score.experiment, score.value, score.method) for score in study]
    assert rows == [
        (experiment, value, method)
        for experiment, values in EXPERIMENTS.items()
        for value in values
        for method in METHODS
    ]
    for experiment, values in EXPERIMENTS.items():
        last = [one for one in study if (one.experiment, one.value) == (experiment, values[-1])]
        assert len({one.rms_mm for one in last}) == len(METHODS)
        assert all(one.rms_missing_mm > 0 for one in last)


def test_of_networks_all_but_the_proximities_are_compared(network_model, poses, short) -> None:
    """The network's own way is plainly evaluated; the others run it on markers filled in, and so
    differ by these alone.
    """
    scores = missing_study(network_model, [short], poses, 0, lambda what, units: None)
    assert methods_of(score.method for score in scores) == ["conditional", "temporal", "bridge"]
    (plain,) = evaluate(network_model, [short])
    for score in scores[:3]:
        assert (score.experiment, score.value) == (NUMBER, 0)
        clean = plain.scores.rms_mm, plain.scores.jerk_mm
        assert (score.rms_mm, score.jerk_mm) == pytest.approx(clean, rel=1e-4)
    (result,) = evaluate(network_model, [short], Faults(gaps=Gaps(0.2, 20, 20)))
    of_gaps = {
        score.method: score.rms_mm
        for score in scores
        if (score.experiment, score.value) == (GAP, 20)
    }
    assert of_gaps["bridge"] == result.scores.rms_mm
    assert len(set(of_gaps.values())) == 3
    lines = [line for line in missing_figure(scores).axes[0].lines if len(line.get_xdata()) > 2]
    assert len(lines) == 3


def test_the_same_seed_gives_the_same_rows(model, poses, short, study) -> None:
    assert missing_study(model, [short], poses, 0, lambda what, units: None) == study


def test_the_report_has_a_curve_for_each_method(study, tmp_path) -> None:
    figure = missing_figure(study)
    panels = figure.axes
    assert len(panels) == 6
    for column, (experiment, values) in enumerate(EXPERIMENTS.items()):
        for row, name in enumerate(("rms_mm", "jerk_mm")):
            curves = [line for line in panels[3 * row + column].lines if len(line.get_xdata()) > 2]
            assert len(curves) == len(METHODS)
            for method, line in zip(METHODS, curves, strict=True):
                assert tuple(line.get_xdata()) == values
                assert list(line.get_ydata()) == [
                    getattr(one, name)
                    for one in study
                    if (one.method, one.experiment) == (method, experiment)
                ]
    report = Report(tmp_path, "test")
    add_missing(report, study)
    report.write()
    with (tmp_path / "missing_scores.csv").open(newline="") as file:
        _, *rows = csv.reader(file)
    assert [float(row[4]) for row in rows] == [one.rms_mm for one in study]
    assert (tmp_path / "missing.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_wants_training_poses(data_dir) -> None:
    with pytest.raises(UsageError, match=r"--missing-study .*--train"):
        main(["default", str(data_dir), "--split", "test", "--missing-study"])


def test_the_command_prints_and_writes_the_study(
    model, data_dir, small_dir, tmp_path, capsys
) -> None:
    folder, file = tmp_path / "data", tmp_path / "found.json"
    folder.mkdir()
    shutil.copy(data_dir / "real" / "02_03.c3d", folder)
    argv = [model.path, folder, "--train", small_dir, "--missing-study"]
    argv += ["--json", file, "--report", tmp_path / "report"]
    assert main([str(word) for word in argv]) == 0
    found = json.loads(file.read_text())
    assert len(found["missing_study"]) == STEPS * len(METHODS)
    assert found["missing_study"][2] == {
        "method": "bridge",
        "experiment": "number",
        "value": 0,
        "missing_percent": found["missing_study"][0]["missing_percent"],
        "rms_mm": pytest.approx(found["mean"]["rms_mm"]),
        "rms_missing_mm": found["missing_study"][2]["rms_missing_mm"],
        "jerk_mm": pytest.approx(found["mean"]["jerk_mm"]),
    }
    shown = capsys.readouterr().out
    for score in found["missing_study"]:
        assert f"{score['rms_mm']:.1f}" in shown
    assert (tmp_path / "report" / "missing.png").is_file()
    assert "Missing markers" in (tmp_path / "report" / "index.html").read_text()
