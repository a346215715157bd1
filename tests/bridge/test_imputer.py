"""Markers that go and come back: where they are meanwhile, and that nothing jumps or sums up."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.body_frame import BodyFrame
from bridge.imputer import FADE, RETURN, SPEED, Imputer
from drivers.frame import Floats

LABELS = ("LFHD", "RTOE", "C7", "LSHO", "RSHO")
STAND = np.array(
    [[0, 0.1, 1.7], [0.1, 0, 0.1], [0, 0, 1.5], [-0.2, 0, 1.5], [0.2, 0, 1.5]], np.float32
)
TOE = 1
SHIFT = 0.3  # m in x: where the model below expects any missing marker, too far to the right
INTERVAL = 1 / 120


class Expecting:
    """A regression that expects every missing marker beside where it stands."""

    def reset(self, rate: float) -> None: ...

    def guess(self, tracked: Floats, present: np.ndarray, placed: float) -> tuple[Floats, Floats]:
        aside = (STAND - STAND[2] + np.array([SHIFT, 0, 0])).astype(np.float32)
        # Each other marker that is missing makes it expect the toe a little elsewhere.
        aside[TOE, 1] += np.float32(0.05 * (~present[[0, 3, 4]]).sum())
        return aside, np.full(41, 0.1, np.float32)

    def estimate(self, tracked: Floats) -> tuple[Floats, Floats]:
        raise NotImplementedError

    def leaf(self) -> int:
        return 0


class Performer:
    """Stands; as the estimator does, the body frame follows what the imputer gives."""

    def __init__(self) -> None:
        self.body = BodyFrame(LABELS, STAND - STAND[2], np.full(5, 0.1))
        self.imputer = Imputer(Expecting(), self.body, len(LABELS))
        self.velocity = np.zeros((5, 3))

    def step(self, missing: list[int]) -> tuple[Floats, Floats | None]:
        measured = STAND.copy()
        measured[missing] = np.nan
        present = ~np.isnan(measured[:, 0])
        found, sigma = self.imputer.complete(measured, present, self.velocity, INTERVAL)
        self.body.place(found)
        self.body.learn(measured)
        return found, sigma

    def toe(self, frames: int, missing: list[int]) -> np.ndarray:
        """How far the toe is given from where it is, m, (frames, 3)."""
        return np.array([self.step(missing)[0][TOE] for _ in range(frames)], float) - STAND[TOE]


def test_nothing_missing_is_nothing_changed() -> None:
    performer = Performer()
    for _ in range(3):
        found, sigma = performer.step([])
        np.testing.assert_array_equal(found, STAND)
        assert sigma is None


def test_markers_that_are_there_stay_where_they_are() -> None:
    performer = Performer()
    performer.step([])
    for _ in range(60):
        found, sigma = performer.step([TOE])
        np.testing.assert_array_equal(np.delete(found, TOE, 0), np.delete(STAND, TOE, 0))
    assert sigma is not None


def test_a_missing_marker_comes_to_where_it_is_expected_without_a_jump() -> None:
    performer = Performer()
    performer.step([])
    path = performer.toe(round(6 * FADE / INTERVAL), [TOE])
    assert abs(path[0]).max() < 0.01
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.01
    np.testing.assert_allclose(path[-1], [SHIFT, 0, 0], atol=0.01)
    # What is left to go falls by a constant share.
    left = SHIFT - path[30:150, 0]
    np.testing.assert_allclose(left[1:] / left[:-1], np.exp(-INTERVAL / FADE), rtol=1e-3)


def test_a_missing_marker_goes_on_and_comes_to_rest() -> None:
    performer = Performer()
    performer.step([])
    performer.velocity[TOE] = [0, 0, 1.0]
    path = performer.toe(240, [TOE])
    assert path[5, 2] == pytest.approx(6 * INTERVAL, rel=0.3)
    assert 0.05 < path[:, 2].max() < 0.15
    assert abs(path[-1, 2]) < 0.02


@pytest.mark.parametrize("gone", [20, 400])
def test_a_marker_that_is_back_comes_to_its_place_in_time_at_no_great_speed(gone) -> None:
    performer = Performer()
    performer.step([])
    away = np.linalg.norm(performer.toe(gone, [TOE])[-1])
    assert away > 0.01
    path = np.linalg.norm(performer.toe(60, []), axis=1)
    steps = -np.diff(np.concatenate([[away], path]))
    assert steps.max() <= max(SPEED, away / RETURN) * INTERVAL * 1.1
    assert (steps > -1e-6).all()
    settled = round(RETURN / INTERVAL) + 1
    np.testing.assert_allclose(path[settled:], 0, atol=1e-6)
    assert performer.imputer.away.max() == 0


def test_how_far_it_still_has_to_go_is_told() -> None:
    performer = Performer()
    performer.step([])
    performer.toe(200, [TOE])
    for _ in range(20):
        found, _ = performer.step([])
        away = np.linalg.norm(found[TOE] - STAND[TOE])
        assert performer.imputer.away[TOE] == pytest.approx(away, abs=1e-5)


def test_memory_fades_while_a_marker_is_missing_and_ends_when_it_is_back() -> None:
    performer = Performer()
    performer.step([])
    told = []
    for _ in range(120):
        performer.step([TOE])
        told.append(performer.imputer.memory[TOE])
    assert told[10] > 0.8
    assert (np.diff(told[7:]) < 0).all()
    assert told[-1] < np.exp(-0.9 / FADE)
    performer.step([])
    assert performer.imputer.memory[TOE] == 0


def test_others_that_come_and_go_do_not_make_a_missing_marker_drift() -> None:
    performer = Performer()
    performer.step([])
    performer.toe(400, [TOE])
    ends = []
    for _ in range(60):
        performer.toe(12, [TOE, 0])
        ends.append(performer.toe(12, [TOE])[-1])
    np.testing.assert_allclose(ends, np.broadcast_to([SHIFT, 0, 0], (60, 3)), atol=0.08)


def test_offsets_do_not_turn_as_a_shoulder_goes_or_comes() -> None:
    """Without a shoulder the frame's yaw is another; what is still to go stays where it is."""
    performer = Performer()
    performer.step([])
    performer.toe(300, [TOE])
    before = performer.step([])[0][TOE]
    for missing in ([3], [3], [], [4], []):
        after = performer.step(missing)[0][TOE]
        assert np.linalg.norm(after - before) < 0.03
        before = after


def test_forgetting_is_starting_anew() -> None:
    performer = Performer()
    performer.step([])
    performer.toe(50, [TOE])
    performer.imputer.reset()
    np.testing.assert_array_equal(performer.step([])[0], STAND)
