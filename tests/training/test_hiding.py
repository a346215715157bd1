"""The error of a marker that has been hidden for a while."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.frame import Layout, MarkerFrame
from simulators.corruption import Faults
from training.dataset import Take, load
from training.hiding import Hiding, evaluate_hidden, parse_hiding


@pytest.fixture(scope="module")
def model() -> Model:
    return Model("default")


@pytest.fixture(scope="module")
def take(data_dir) -> Take:
    return next(t for t in load(data_dir, "test", print) if t.name == "real/16_57.c3d")


def test_what_is_written_is_meant() -> None:
    assert parse_hiding("RTOE@1s") == Hiding("RTOE", 1.0)
    assert parse_hiding("C7@0.5s") == Hiding("C7", 0.5)
    for text in ("RTOE", "RTOE@1", "@1s", "RTOE@0s", "RTOE@-1s"):
        with pytest.raises(ValueError, match="write for example"):
            parse_hiding(text)


def test_one_hiding_by_hand(model, take) -> None:
    """A take with room for one: seen for half a second, hidden for one."""
    short = Take(take.name, "16", "", "", True, 120.0, take.xyz[:181])
    found = evaluate_hidden(model, [short], Hiding("RTOE", 1.0), Faults(), 0)
    info = model.info
    layout = Layout(info.labels, 120.0)
    toe = info.labels.index("RTOE")
    estimator = PoseEstimator(model)
    for index, xyz in enumerate(short.xyz):
        seen = xyz.copy()
        if index >= 60:
            seen[toe] = np.nan
        pose = estimator.step(MarkerFrame(index, 0.0, 0.0, layout, seen))
    assert found.windows == 1
    error = 1000 * np.linalg.norm(pose.xyz[toe] - short.xyz[180, toe])
    assert found.error_mm == pytest.approx(error, rel=1e-5)
    unworn = [info.labels.index(label) for label in info.unworn]
    squared = ((pose.xyz[unworn] - short.xyz[180, unworn]) ** 2).sum(axis=1)
    assert found.unworn_rms_mm == pytest.approx(1000 * np.sqrt(squared.mean()), rel=1e-4)


def test_a_marker_is_the_farther_off_the_longer_it_is_hidden(model, take) -> None:
    errors = [
        evaluate_hidden(model, [take], Hiding("RTOE", age), Faults(), 0).error_mm
        for age in (0.05, 0.2, 1.0)
    ]
    assert errors == sorted(errors)
    assert errors[0] < 50 < errors[2] < 400


def test_takes_without_room_are_named(model, take) -> None:
    short = Take("short.c3d", "16", "", "", True, 120.0, take.xyz[:100])
    found = evaluate_hidden(model, [short], Hiding("RTOE", 1.0), Faults(), 0)
    assert found.to_json() == {
        "marker": "RTOE",
        "age_s": 1.0,
        "windows": 0,
        "error_mm": None,
        "unworn_rms_mm": None,
        "too_short": ("short.c3d",),
    }
