"""Fade, hide, hold: what becomes of bones and markers that nobody is sure of."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.humanoid.skeleton import BONES, ROW
from bridge.uncertainty import BLEND, Bones, Caution, Doubt, Points, Policy
from tests.bridge.poses import LEFT, NONE, RAISED, SQUARE, posture, product, turned

SURE, UNSURE = 0.02, 0.2
ARM, HAND = ROW["LeftUpperArm"], ROW["LeftHand"]
RIGHT = (0.0, 0.0, -SQUARE, SQUARE)
HALF = (0.0, np.sin(np.pi / 8), 0.0, np.cos(np.pi / 8))  # half of RAISED


def same(found: np.ndarray, expected: object) -> None:
    np.testing.assert_allclose(found, np.array(expected), atol=1e-6)


def raised(sigma: float, t: float = 0.0, hips: tuple[float, ...] = (1, 2, 1)) -> tuple:
    return t, posture({"LeftUpperArm": RAISED}, hips, {"LeftUpperArm": sigma})


def test_doubt_comes_and_goes_over_pose_time() -> None:
    doubt = Doubt(0.08, 1)
    times = [0.0, 1.0, 1.15, 1.3, 1.45, 2.0, 2.1, 2.4]
    sigmas = [SURE, SURE, UNSURE, UNSURE, UNSURE, SURE, SURE, SURE]
    shares = [doubt.step(t, np.float32([s]))[0] for t, s in zip(times, sigmas, strict=True)]
    assert shares == pytest.approx([0, 0, 0.5, 1, 1, 0, 0, 0])


def test_what_is_in_doubt_from_the_first_is_so_wholly() -> None:
    share = Doubt(0.08, 4).step(5.0, np.float32([SURE, UNSURE, np.inf, np.nan]))
    assert share.tolist() == [0, 1, 1, 1]


def test_nothing_flickers_at_the_threshold() -> None:
    doubt = Doubt(0.08, 1)
    seen = []
    for frame in range(60):
        doubt.step(frame / 120, np.float32([0.08 + 0.004 * (-1) ** frame]))
        seen.append(bool(doubt.doubted[0]))
    assert sum(a != b for a, b in pairwise(seen)) <= 1
    doubt.step(1.0, np.float32([0.063]))  # well below
    assert not doubt.doubted[0]


def test_time_that_stands_still_or_runs_back_moves_nothing() -> None:
    doubt = Doubt(0.08, 1)
    doubt.step(1.0, np.float32([SURE]))
    assert doubt.step(1.1, np.float32([UNSURE]))[0] == pytest.approx(1 / 3)
    assert doubt.step(1.1, np.float32([UNSURE]))[0] == pytest.approx(1 / 3)
    assert doubt.step(0.2, np.float32([UNSURE]))[0] == pytest.approx(1 / 3)


def test_shown_bones_are_as_they_are() -> None:
    bones = Bones(Caution())
    t, body = raised(np.inf)
    found = bones(t, body)
    np.testing.assert_array_equal(found.local, body.local)
    np.testing.assert_array_equal(found.hips, body.joints[0])
    assert found.shown.all()


def test_a_bone_fades_to_the_rest_pose_and_comes_back() -> None:
    bones = Bones(Caution(Policy.FADE))
    same(bones(*raised(SURE, 0.0)).local[ARM], RAISED)
    same(bones(*raised(UNSURE, 0.15)).local[ARM], HALF)
    same(bones(*raised(UNSURE, 0.40)).local[ARM], NONE)
    same(bones(*raised(SURE, 0.55)).local[ARM], HALF)
    found = bones(*raised(SURE, 0.80))
    same(found.local[ARM], RAISED)
    assert found.shown.all()


def test_a_bone_is_held_as_it_was_when_it_was_sure() -> None:
    bones = Bones(Caution(Policy.HOLD))
    bones(*raised(SURE, 0.0))
    lowered = posture({"LeftUpperArm": LEFT}, sigma={"LeftUpperArm": UNSURE})
    same(bones(0.5, lowered).local[ARM], RAISED)
    same(bones(0.8, lowered).local[ARM], RAISED)
    sure = posture({"LeftUpperArm": NONE})
    same(bones(0.95, sure).local[ARM], HALF)  # from where it was held, not at once
    same(bones(1.10, sure).local[ARM], NONE)


def test_a_blend_takes_the_shorter_way_round() -> None:
    """A quaternion and its negative are one rotation."""
    bones = Bones(Caution(Policy.HOLD))
    bones(*raised(SURE))
    other = posture({"LeftUpperArm": -np.array(RAISED)}, sigma={"LeftUpperArm": UNSURE})
    same(np.abs(bones(0.15, other).local[ARM]), RAISED)


def test_a_bone_that_was_never_sure_is_held_in_the_rest_pose() -> None:
    same(Bones(Caution(Policy.HOLD))(*raised(UNSURE)).local[ARM], NONE)


def test_a_hidden_bone_is_left_out_and_the_hips_never() -> None:
    bones = Bones(Caution(Policy.HIDE))
    found = bones(0.0, posture(sigma={"LeftUpperArm": UNSURE, "Hips": UNSURE}))
    assert [BONES[row] for row in np.flatnonzero(~found.shown)] == ["LeftUpperArm"]
    assert bones(0.1, posture()).shown.all()


@pytest.mark.parametrize("policy", [Policy.FADE, Policy.HOLD, Policy.HIDE])
def test_the_hips_are_held(policy: Policy) -> None:
    bones = Bones(Caution(policy))
    bones(0.0, posture({"Hips": LEFT}, (1, 2, 1)))
    away = posture({"Hips": NONE}, (3, 2, 1), {"Hips": UNSURE})
    halfway = bones(0.15, away)
    same(halfway.hips, (2, 2, 1))
    same(halfway.local[0], (0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)))
    held = bones(0.45, away)
    same(held.hips, (1, 2, 1))
    same(held.local[0], LEFT)


def hand(sigma: float, local: dict, hips: tuple[float, ...] = (1, 2, 1), far: float = 0.1) -> tuple:
    """A marker beyond the left hand's joint, the hand's axes being the body's."""
    body = posture(local, hips, {"LeftHand": sigma})
    beyond = turned(body.rotations[HAND], (-far, 0, 0))
    at = (body.joints[HAND] + beyond)[None].astype(np.float32)
    return at, np.float32([sigma]), body


def test_a_marker_fades_to_its_place_in_the_rest_pose() -> None:
    """In the rest pose the hand's joint is 0.6875 m left of the hips and 0.4375 m above them."""
    points = Points(Caution(Policy.FADE), [HAND])
    local = {"Hips": LEFT, "LeftUpperArm": RAISED}
    now = hand(SURE, local)
    same(points(0.0, *now).xyz, now[0])
    found = points(0.5, *hand(UNSURE, local))
    same(found.xyz, [[1, 2 - 0.7875, 1.4375]])  # the body is turned to the left: our -y
    same(found.turns, [LEFT])
    halfway = points(0.65, *hand(SURE, local))
    same(halfway.xyz, (now[0] + found.xyz) / 2)
    back = points(0.8, *hand(SURE, local))
    same(back.xyz, now[0])
    same(back.turns, [(-0.5, 0.5, 0.5, 0.5)])


def test_a_marker_fades_to_where_it_last_was_on_its_bone() -> None:
    points = Points(Caution(Policy.FADE), [HAND])
    points(0.0, *hand(SURE, {}))
    points(0.1, *hand(SURE, {"LeftUpperArm": RAISED}, far=0.3))
    found = points(0.5, *hand(UNSURE, {}, far=0.5))
    same(found.xyz, [[1 - 0.6875 - 0.3, 2, 1.4375]])


@pytest.mark.parametrize(("before", "after", "turn"), [(NONE, LEFT, LEFT), (LEFT, NONE, RIGHT)])
def test_a_marker_is_held_against_the_hips(before: tuple, after: tuple, turn: tuple) -> None:
    """The body goes on and turns, and its arm is somewhere else."""
    points = Points(Caution(Policy.HOLD), [HAND])
    first, sigma, body = hand(SURE, {"Hips": before, "LeftUpperArm": RAISED})
    points(0.0, first, sigma, body)
    found = points(0.5, *hand(UNSURE, {"Hips": after, "RightUpperArm": RAISED}, (5, 5, 1)))
    same(found.xyz[0], np.array([5, 5, 1]) + turned(turn, first[0] - [1, 2, 1]))
    same(found.turns, [product(after, RAISED)])


def test_a_marker_that_was_never_sure_is_held_where_it_would_fade_to() -> None:
    held, faded = (Points(Caution(policy), [HAND]) for policy in (Policy.HOLD, Policy.FADE))
    now = hand(np.inf, {"LeftUpperArm": RAISED})
    same(held(0.0, *now).xyz, [[1 - 0.7875, 2, 1.4375]])
    same(held(0.1, *now).xyz, faded(0.1, *now).xyz)


def test_markers_need_no_posture_where_none_is_moved() -> None:
    xyz, sigma = np.ones((2, 3), np.float32), np.float32([SURE, UNSURE])
    for policy in Policy:
        found = Points(Caution(policy), [0, HAND])(0.0, xyz, sigma, None)
        assert found.xyz is xyz
        assert found.shown.tolist() == [True, policy is not Policy.HIDE]
        same(found.turns, [NONE, NONE])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.booleans(), min_size=5, max_size=40), st.sampled_from(["fade", "hold"]))
def test_nothing_ever_jumps(unsure: list[bool], policy: str) -> None:
    """A body that stands still: from pose to pose no more than the blend's share of the way."""
    caution = Caution(Policy(policy))
    bones, points = Bones(caution), Points(caution, [HAND])
    steps = []
    for frame, here in enumerate(unsure):
        at, sigma, body = hand(UNSURE if here else SURE, {"LeftUpperArm": RAISED})
        body.sigma[ARM] = body.sigma[0] = sigma[0]
        shown = bones(frame / 60, body)
        steps.append(np.concatenate([shown.local[ARM], points(frame / 60, at, sigma, body).xyz[0]]))
    farthest = 2 * SQUARE + 1.2  # m, and a quaternion's quarter turn
    assert np.abs(np.diff(steps, axis=0)).max() < farthest / 60 / BLEND
