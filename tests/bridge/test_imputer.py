"""Markers that go and come back: where they are meanwhile, and that nothing jumps or sums up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bridge.body_frame import BodyFrame
from bridge.imputer import NEVER, RETURN, SPEED, Imputer
from bridge.regression import Sightings
from drivers.frame import Floats

LABELS = ("LFHD", "RTOE", "C7", "LSHO", "RSHO")
STAND = np.array(
    [[0, 0.1, 1.7], [0.1, 0, 0.1], [0, 0, 1.5], [-0.2, 0, 1.5], [0.2, 0, 1.5]], np.float32
)
USUAL = STAND - STAND[2]
HEAD, TOE = 0, 1
SHIFT = 0.3  # m in x: where the model below says any missing marker is, too far to the right
APART = 0.05  # m in y: and for each other one that is missing
INTERVAL = 1 / 120
SIGMA = 0.1


class Saying:
    """A regression that says that every missing marker is beside where it stands, at once."""

    def __init__(self) -> None:
        self.heard: Sightings | None = None
        self.leaf = lambda: 0

    def reset(self, rate: float) -> None: ...

    def recall(
        self, tracked: Floats, present: np.ndarray, sightings: Sightings, placed: float
    ) -> tuple[Floats, Floats]:
        self.heard = sightings
        aside = USUAL + np.array([SHIFT, APART * ((~present).sum() - 1), 0])
        count = len(sightings.age)
        sigma = np.full((count, len(LABELS)), SIGMA, np.float32)
        return np.repeat(aside[None], count, axis=0).astype(np.float32), sigma

    def estimate(self, tracked: Floats, velocity: Floats) -> tuple[Floats, Floats, Floats | None]:
        raise NotImplementedError


def turned(xyz: np.ndarray, yaw: float) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return (xyz @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])).astype(np.float32)


class Performer:
    """Stands, unless told to do otherwise; as the estimator does, the body frame follows what the
    imputer gives.
    """

    def __init__(self) -> None:
        self.body = BodyFrame(LABELS, USUAL, np.full(5, 0.1))
        self.saying = Saying()
        self.imputer = Imputer(self.saying, self.body, USUAL)
        self.velocity = np.zeros((5, 3))

    def step(self, missing: list[int], xyz: Floats = STAND) -> tuple[Floats, Floats]:
        measured = xyz.copy()
        measured[missing] = np.nan
        present = ~np.isnan(measured[:, 0])
        found, sigma = self.imputer.complete(measured, present, self.velocity, INTERVAL)
        self.body.place(found)
        self.body.learn(measured)
        return found, sigma

    def hold(self, seconds: float, shown: Floats = STAND) -> None:
        """Too few markers are there."""
        for _ in range(round(seconds / INTERVAL)):
            self.imputer.hold(shown, self.velocity, INTERVAL)

    def toe(self, frames: int, missing: list[int]) -> np.ndarray:
        """How far the toe is given from where it stands, m, (frames, 3)."""
        return np.array([self.step(missing)[0][TOE] for _ in range(frames)], float) - STAND[TOE]


@pytest.fixture
def performer() -> Performer:
    """All of whose markers have been seen."""
    performer = Performer()
    performer.step([])
    return performer


def speeds(path: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(path, axis=0), axis=-1) / INTERVAL


def test_nothing_missing_is_nothing_changed() -> None:
    performer = Performer()
    assert not performer.imputer.whole
    for _ in range(3):
        found, sigma = performer.step([])
        np.testing.assert_array_equal(found, STAND)
        assert not sigma.any()
        assert performer.imputer.whole
        assert not performer.imputer.away.any()
    assert performer.imputer.pass_on(STAND) is STAND


def test_markers_that_are_there_stay_where_they_are(performer) -> None:
    for _ in range(60):
        found, sigma = performer.step([TOE])
        np.testing.assert_array_equal(np.delete(found, TOE, 0), np.delete(STAND, TOE, 0))
        np.testing.assert_array_equal(sigma, np.where(np.arange(5) == TOE, np.float32(SIGMA), 0))
        assert not performer.imputer.whole


def test_a_missing_marker_comes_to_where_it_is_said_to_be_without_a_jump(performer) -> None:
    path = performer.toe(60, [TOE])
    whole_way = np.vstack([np.zeros(3), path])
    assert speeds(whole_way).max() <= max(SPEED, SHIFT / RETURN) * 1.001
    settled = math.ceil(RETURN / INTERVAL)
    np.testing.assert_allclose(
        path[settled:], np.full_like(path[settled:], [SHIFT, 0, 0]), atol=1e-6
    )
    assert path[settled - 2, 0] < SHIFT - 0.01
    assert np.ptp(np.diff(whole_way[:settled, 0])) < 1e-6  # evenly


def test_it_goes_on_as_it_went_while_it_comes_there(performer) -> None:
    performer.velocity[TOE] = [0, 2.0, 0]
    path = performer.toe(1, [TOE])
    # The leap is from where it would be next, and a first bit of it is walked at once.
    leap = np.array([SHIFT, -2.0 * INTERVAL, 0])
    first = [0, 2.0 * INTERVAL, 0] + leap * INTERVAL / RETURN
    np.testing.assert_allclose(path[0], first, atol=1e-6)


def test_a_small_leap_is_over_sooner(performer) -> None:
    performer.toe(60, [TOE])
    path = performer.toe(60, [TOE, HEAD])
    needed = math.ceil(APART / SPEED / INTERVAL)
    assert needed * INTERVAL < RETURN
    np.testing.assert_allclose(speeds(path[: needed - 1]), SPEED, rtol=0.01)
    np.testing.assert_allclose(
        path[needed:], np.full((60 - needed, 3), [SHIFT, APART, 0]), atol=1e-6
    )


@pytest.mark.parametrize("gone", [2, 12, 400])
def test_a_marker_that_is_back_comes_to_its_place_in_time_at_no_great_speed(
    performer, gone
) -> None:
    before = performer.toe(gone, [TOE])[-2:]
    path = performer.toe(60, [])
    # It may go on as it went for a moment, if it was still on its way.
    fastest = max(SPEED, (np.linalg.norm(before[-1]) + 0.02) / RETURN, speeds(before)[0])
    assert speeds(np.vstack([before[-1:], path])).max() <= fastest * 1.001
    settled = math.ceil(RETURN / INTERVAL)
    np.testing.assert_allclose(path[settled:], 0, atol=1e-6)
    assert performer.imputer.whole


@pytest.mark.parametrize("missing", [[TOE], []])
def test_how_far_it_still_has_to_go_is_told(performer, missing) -> None:
    if not missing:
        performer.toe(200, [TOE])
    goal = STAND[TOE] + ([SHIFT, 0, 0] if missing else [0, 0, 0])
    for _ in range(20):
        found, _ = performer.step(missing)
        away = np.linalg.norm(found[TOE] - goal)
        assert away > 0.01
        assert performer.imputer.away[TOE] == pytest.approx(away, abs=1e-5)
        assert not np.delete(performer.imputer.away, TOE).any()


def test_others_that_come_and_go_do_not_make_a_missing_marker_drift(performer) -> None:
    performer.toe(400, [TOE])
    ends = []
    for _ in range(60):
        performer.toe(7, [TOE, HEAD])
        ends.append(performer.toe(5, [TOE])[-1])
    # Between what is said with the one and without.
    assert abs(np.array(ends) - [SHIFT, APART / 2, 0]).max() < APART
    random = np.random.default_rng(1)
    flickering = [
        performer.toe(1, [TOE, HEAD] if random.random() < 0.5 else [TOE])[0] for _ in range(2000)
    ]
    assert abs(np.array(flickering) - [SHIFT, APART / 2, 0]).max() < 2 * APART
    calm = performer.toe(60, [TOE])[-1]
    np.testing.assert_allclose(calm, [SHIFT, 0, 0], atol=1e-6)


def test_what_is_left_of_a_way_does_not_turn_with_the_body(performer) -> None:
    """A spin on one's heel must not swing it round."""
    performer.toe(200, [TOE])
    for frame in range(20):
        xyz = turned(STAND, 0.1 * frame)  # 12 rad/s
        found, _ = performer.step([], xyz)
        rest = (found - xyz)[TOE]
        assert np.linalg.norm(rest) > 0.02
        np.testing.assert_allclose(rest / np.linalg.norm(rest), [1, 0, 0], atol=1e-3)


def test_a_shoulder_that_comes_and_goes_does_not_make_others_leap(performer) -> None:
    """Without a shoulder the frame's yaw is another; what is still to go stays where it is."""
    performer.toe(300, [TOE])
    before = performer.step([])[0][TOE]
    for missing in ([3], [3], [], [4], []):
        after = performer.step(missing)[0][TOE]
        assert np.linalg.norm(after - before) < 0.03
        before = after


def walk(seconds: float) -> Floats:
    """Somebody who turns and goes on."""
    going = np.array([1.0, 0.5, 0.1]) * seconds
    return (turned(STAND, 2.0 * seconds) + going).astype(np.float32)


def test_the_last_sighting_is_told_as_it_looks_now(performer) -> None:
    frames = [walk(frame * INTERVAL) for frame in range(40)]
    for xyz in frames[:10]:
        performer.step([], xyz)
    performer.velocity[:] = np.arange(15).reshape(5, 3)
    for xyz in frames[10:]:
        performer.step([TOE], xyz)
    last = BodyFrame(LABELS)
    last.update(frames[9])
    now = BodyFrame(LABELS)
    now.update(frames[-1])
    heard = performer.saying.heard
    np.testing.assert_allclose(heard.then, [last.to_body(frames[9])], atol=1e-5)
    np.testing.assert_allclose(heard.left, [now.to_body(frames[9])], atol=1e-5)
    np.testing.assert_allclose(heard.pace, [performer.velocity @ now.rotation], atol=1e-4)
    np.testing.assert_allclose(heard.age, [30 * INTERVAL])


def test_each_marker_has_its_own_last_sighting(performer) -> None:
    for frame in range(1, 40):
        missing = [TOE] if frame < 20 else [HEAD, TOE]
        performer.step(missing, walk(frame * INTERVAL))
    heard = performer.saying.heard
    np.testing.assert_allclose(heard.age, [20 * INTERVAL, 39 * INTERVAL])
    assert performer.imputer.unseen[[HEAD, TOE]] == pytest.approx(heard.age)
    np.testing.assert_allclose(heard.then[1], USUAL, atol=1e-6)
    # The later one has the toe where it was said to be by then.
    assert heard.then[0, TOE, 0] == pytest.approx(USUAL[TOE, 0] + SHIFT, abs=0.15)


def test_a_glimpse_is_a_sighting(performer) -> None:
    """Where the marker was measured counts, not how far on its way there it was shown."""
    performer.toe(200, [TOE])
    assert np.linalg.norm(performer.toe(2, [])[-1]) > SHIFT / 2
    performer.step([TOE])
    heard = performer.saying.heard
    np.testing.assert_allclose(heard.then, [USUAL], atol=1e-6)
    np.testing.assert_allclose(heard.left, [USUAL], atol=1e-6)
    np.testing.assert_allclose(heard.age, [INTERVAL])


def test_markers_that_were_never_seen_are_where_they_usually_are() -> None:
    performer = Performer()
    for _ in range(3):
        found, sigma = performer.step([TOE])
        np.testing.assert_allclose(found[TOE] - STAND[TOE], [SHIFT, 0, 0], atol=1e-6)
        assert sigma[TOE] == np.float32(SIGMA)
        heard = performer.saying.heard
        np.testing.assert_array_equal(heard.then, [USUAL])
        np.testing.assert_array_equal(heard.left, [USUAL])
        assert not heard.pace.any()
        assert heard.age >= NEVER
    # They come as one that is back does.
    path = performer.toe(30, [])
    assert speeds(path).max() <= max(SPEED, SHIFT / RETURN) * 1.001
    np.testing.assert_allclose(path[-1], 0, atol=1e-6)


def test_after_a_hold_all_go_from_where_they_were_shown(performer) -> None:
    held = STAND + np.float32(0.5)
    performer.hold(0.5, held)
    path = np.array([held, *(performer.step([])[0] for _ in range(60))])
    far = np.linalg.norm(held - STAND, axis=1).max()
    assert speeds(path).max() <= far / RETURN * 1.001
    np.testing.assert_allclose(path[-30:], np.broadcast_to(STAND, (30, 5, 3)), atol=1e-6)
    assert performer.imputer.whole


def test_a_hold_is_no_sighting(performer) -> None:
    """Who is still missing after it was seen last before it."""
    for frame in range(1, 20):
        performer.step([], walk(frame * INTERVAL))
    performer.velocity[:] = np.arange(15).reshape(5, 3)
    performer.hold(0.5, walk(0.3))
    performer.step([TOE], walk(0.7))
    now = BodyFrame(LABELS)
    now.update(walk(0.7))
    heard = performer.saying.heard
    np.testing.assert_allclose(heard.left, [now.to_body(walk(19 * INTERVAL))], atol=1e-5)
    np.testing.assert_allclose(heard.pace, [performer.velocity @ now.rotation], atol=1e-4)
    np.testing.assert_allclose(heard.age, [0.5 + INTERVAL], atol=1e-6)


def test_forgetting_is_starting_anew(performer) -> None:
    performer.toe(50, [TOE])
    performer.imputer.reset()
    np.testing.assert_array_equal(performer.step([])[0], STAND)
    performer.imputer.reset()
    performer.step([TOE])
    assert performer.saying.heard.age >= NEVER
