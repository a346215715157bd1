"""What becomes of a marker that is hidden for a while, and of the pose when it returns."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.errors import UsageError
from drivers.frame import Layout, MarkerFrame
from simulators.corruption import Faults
from training.dataset import Take, load_training
from training.evaluate_command import main
from training.hiding import ALL, Hidden, Hiding, evaluate_hidden, parse_hiding

GONE = 60  # frames that are seen before
AFTER = 36


@pytest.fixture(scope="module")
def model() -> Model:
    return Model("default")


@pytest.fixture(scope="module")
def take(small_dir) -> Take:
    return next(t for t in load_training(small_dir, pytest.fail) if t.name == "real/02_01.c3d")


def hide(model: Model, takes: list[Take], text: str) -> Hidden:
    told: list[float] = []
    hiding = parse_hiding(text)
    found = evaluate_hidden(
        model, takes, hiding, Faults(), 0, lambda what, units: told.append(units)
    )
    assert sum(told) == len(takes)
    return found


def test_what_is_written_is_meant() -> None:
    assert parse_hiding("RTOE@1s") == Hiding("RTOE", 1.0)
    assert parse_hiding("C7@0.5s") == Hiding("C7", 0.5)
    assert parse_hiding("all@2s") == Hiding(ALL, 2.0)
    for text in ("RTOE", "RTOE@1", "@1s", "RTOE@0s", "RTOE@-1s"):
        with pytest.raises(ValueError, match="write for example"):
            parse_hiding(text)


def test_ages_are_those_that_fit_and_the_time_asked_for() -> None:
    assert Hiding("C7", 2.0).ages == (0.1, 0.5, 1.0, 2.0)
    assert Hiding("C7", 0.7).ages == (0.1, 0.5, 0.7)
    assert Hiding("C7", 0.05).ages == (0.05,)
    assert Hiding("C7", 3.0).ages == (0.1, 0.5, 1.0, 2.0, 3.0)


def by_hand(model: Model, take: Take, marker: str | None, gone: slice) -> tuple:
    info = model.info
    layout = Layout(info.labels, take.rate)
    estimator = PoseEstimator(model)
    poses = []
    for index, xyz in enumerate(take.xyz):
        seen = xyz.copy()
        if marker is not None and gone.start <= index < gone.stop:
            seen[info.labels.index(marker)] = np.nan
        poses.append(estimator.step(MarkerFrame(index, 0.0, 0.0, layout, seen)))
    return np.array([pose.xyz for pose in poses], float), np.array([pose.sigma for pose in poses])


@pytest.mark.parametrize("kind", ["default", "network"])
def test_one_hiding_by_hand(kind, model, network_model, take) -> None:
    """A take with room for one: seen for half a second, hidden for 0.5, watched for 0.3."""
    model, foot = (model, "RANK") if kind == "default" else (network_model, "RTOE")
    gone = slice(GONE, GONE + 60 + 1)
    one = replace(take, xyz=take.xyz[: gone.stop + AFTER])
    found = hide(model, [one], f"{foot}@0.5s")
    assert (found.windows, found.too_short) == (1, ())
    (told,) = found.markers
    row = model.info.labels.index(foot)
    unworn = [model.info.labels.index(label) for label in model.info.unworn]
    poses, sigma = by_hand(model, one, foot, gone)
    whole, _ = by_hand(model, one, None, gone)
    error = poses - one.xyz
    assert [at.age_s for at in told.ages] == [0.1, 0.5]
    for at, age in zip(told.ages, (12, 60), strict=True):
        frame = GONE + age
        off = 1000 * np.linalg.norm(error[frame, row])
        assert at.error_mm == pytest.approx(off, rel=1e-5)
        rms = 1000 * np.sqrt((error[frame, unworn] ** 2).sum(axis=1).mean())
        assert at.unworn_rms_mm == pytest.approx(rms, rel=1e-4)
        for share, n in ((at.within_1, 1), (at.within_2, 2)):
            assert share == pytest.approx((abs(error[frame, row]) <= n * sigma[frame, row]).mean())
    for share, n in ((told.within_1, 1), (told.within_2, 2)):
        inside = abs(error[gone, row]) <= n * sigma[gone, row, None]
        assert share == pytest.approx(inside.mean())

    def largest(difference: np.ndarray) -> float:
        steps = 1000 * np.linalg.norm(np.diff(difference, axis=0), axis=2)
        return float(steps[gone.stop - 1 : gone.stop - 1 + AFTER].max())

    for part, difference in (
        (told.returning, error),
        (told.blending, poses - whole),
        (found.unhidden, whole - one.xyz),
    ):
        expected = pytest.approx(largest(difference), rel=1e-3)
        assert part.mean_mm == part.p99_mm == part.max_mm == expected
    assert replace(found.mean, marker=foot) == told


def test_all_is_each_in_turn_and_their_mean(model, take) -> None:
    short = replace(take, xyz=take.xyz[:220])
    every = hide(model, [short], "all@0.2s")
    assert [one.marker for one in every.markers] == list(model.info.tracked)
    assert every.windows == 2  # from frames 60 and 120
    for marker in ("C7", "LANK"):
        alone = hide(model, [short], f"{marker}@0.2s")
        assert alone.markers == tuple(one for one in every.markers if one.marker == marker)
        assert alone.unhidden == every.unhidden
    for row in range(2):
        errors = [one.ages[row].error_mm for one in every.markers]
        assert every.mean.ages[row].error_mm == pytest.approx(np.mean(errors))
        shares = [one.ages[row].within_1 for one in every.markers]
        assert every.mean.ages[row].within_1 == pytest.approx(np.mean(shares))
    largest = [one.returning for one in every.markers]
    assert every.mean.returning.max_mm == max(part.max_mm for part in largest)
    assert every.mean.returning.mean_mm == pytest.approx(np.mean([p.mean_mm for p in largest]))


def test_a_marker_is_the_farther_off_the_longer_it_is_hidden(model, take) -> None:
    (told,) = hide(model, [take], "RANK@1s").markers
    errors = [at.error_mm for at in told.ages]
    assert errors == sorted(errors)
    assert errors[0] < 100
    assert errors[0] < 0.8 * errors[2] < 400
    assert 0 < told.within_1 < told.within_2 <= 1
    assert told.blending.max_mm <= 25


def test_truth_that_is_missing_is_left_out(model, take) -> None:
    blind = take.xyz.copy()[: 60 + 61 + AFTER]
    blind[60:, model.info.labels.index("RANK")] = np.nan
    (told,) = hide(model, [replace(take, xyz=blind)], "RANK@0.5s").markers
    assert (told.ages[0].error_mm, told.within_1) == (None, None)
    assert told.ages[0].unworn_rms_mm > 0
    assert told.returning.max_mm > 0


def test_takes_without_room_are_named(model, take) -> None:
    """One frame less than seen, hidden and watched takes."""
    room = GONE + 120 + 1 + AFTER
    short = replace(take, name="short.c3d", xyz=take.xyz[: room - 1])
    found = hide(model, [short], "RANK@1s").to_json()
    assert (found["windows"], found["too_short"]) == (0, ("short.c3d",))
    nothing = {"mean_mm": None, "p99_mm": None, "max_mm": None}
    assert found["unhidden"] == found["mean"]["returning"] == nothing
    assert found["markers"][0]["ages"][0]["error_mm"] is None
    json.dumps(found, allow_nan=False)
    assert hide(model, [short, replace(take, xyz=take.xyz[:room])], "RANK@1s").windows == 1


def test_the_command_tells_all_and_their_mean(small_dir, tmp_path, capsys) -> None:
    file = tmp_path / "found.json"
    argv = ["default", str(small_dir), "--split", "test", "--hide", "all@0.3s", "--json", str(file)]
    assert main(argv) == 0
    found = json.loads(file.read_text())["hidden"]
    model = Model("default")
    assert [row["marker"] for row in found["markers"]] == list(model.info.tracked)
    shown = capsys.readouterr().out
    assert "Hidden for 0.3 s" in shown
    for row in (*found["markers"], found["mean"]):
        for at in row["ages"]:
            assert f"{at['error_mm']:.0f} ({at['unworn_rms_mm']:.1f})" in shown
        assert f"{row['returning']['max_mm']:.1f}" in shown
    assert "…" not in shown
    assert f"{found['unhidden']['p99_mm']:.1f}" in shown


def test_wrong_markers_are_wrong_usage(small_dir) -> None:
    with pytest.raises(UsageError, match=r"RFIN is not tracked .*; all: each in turn"):
        main(["default", str(small_dir), "--hide", "RFIN@1s"])
