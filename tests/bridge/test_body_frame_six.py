"""The body frame of those who wear no C7: the shoulders give it all."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.body_frame import PAPER_FRAME, SIX_FRAME, BodyFrame
from drivers.c3d_file import read_c3d
from tests.bridge import test_body_frame as paper
from tests.bridge.test_body_frame import angles, shifts, turned, without

WORN = [row for row, label in enumerate(paper.LABELS) if label != "C7"]
LABELS = tuple(paper.LABELS[row] for row in WORN)
BODY = paper.BODY[WORN]
LSHO, RSHO = LABELS.index("LSHO"), LABELS.index("RSHO")


def six_frame(mean: np.ndarray | None = None, spread: np.ndarray | None = None) -> BodyFrame:
    return BodyFrame(LABELS, mean, spread, SIX_FRAME)


def test_the_shoulders_are_references_and_features() -> None:
    assert SIX_FRAME.references == ("LSHO", "RSHO")
    assert SIX_FRAME.features(LABELS) == LABELS
    assert PAPER_FRAME.features(paper.LABELS) == LABELS  # a lone origin tells nothing


@given(angles, shifts)
def test_the_origin_is_midway_between_the_shoulders(yaw, shift) -> None:
    frame, world = six_frame(), turned(BODY, yaw, shift)
    frame.update(world)
    np.testing.assert_allclose(frame.origin, (world[LSHO] + world[RSHO]) / 2, atol=1e-6)
    across = world[RSHO] - world[LSHO]
    x = np.array([across[0], across[1], 0]) / math.hypot(across[0], across[1])
    z = np.array([0, 0, 1.0])
    np.testing.assert_allclose(frame.rotation, np.column_stack([x, np.cross(z, x), z]), atol=1e-6)
    left, right = frame.to_body(world)[[LSHO, RSHO]]
    np.testing.assert_allclose(left, -right, atol=1e-5)
    assert left[0] < 0
    assert left[1] == pytest.approx(0, abs=1e-5)


@given(angles, shifts)
def test_where_the_body_stands_and_faces_does_not_change_it(yaw, shift) -> None:
    here, there = six_frame(), six_frame()
    here.update(BODY)
    moved = turned(BODY, yaw, shift)
    there.update(moved)
    np.testing.assert_allclose(there.to_body(moved), here.to_body(BODY), atol=1e-5)
    np.testing.assert_allclose(there.to_world(there.to_body(moved)), moved, atol=1e-5)


lost = st.sets(st.integers(0, len(LABELS) - 1), max_size=len(LABELS) - 2)


@given(lost=lost, yaw=angles, shift=shifts)
def test_a_stiff_body_is_followed_exactly_with_any_markers_missing(lost, yaw, shift) -> None:
    """Two markers, whichever, tell where a body stands and faces that does not move in itself.

    Neither pair of these stands one above the other.
    """
    frame, exact = six_frame(), six_frame()
    frame.update(BODY)
    moved = turned(BODY, yaw, shift)
    exact.update(moved)
    frame.update(without(moved, *lost))
    np.testing.assert_allclose(frame.origin, exact.origin, atol=1e-4)
    np.testing.assert_allclose(frame.rotation, exact.rotation, atol=1e-4)
    assert (frame.sigma > 0) == bool(lost & {LSHO, RSHO})


def test_nothing_is_learned_while_a_shoulder_is_missing() -> None:
    """Where the origin is only fitted, markers that moved do not become what is known."""
    frame, same = six_frame(), six_frame()
    for one in (frame, same):
        one.update(BODY)
    moved = BODY.copy()
    moved[LABELS.index("RELB")] += [0.1, 0.2, 0.3]
    frame.update(without(moved, LSHO))
    for one in (frame, same):
        one.update(without(BODY, LSHO))
    np.testing.assert_array_equal(frame.origin, same.origin)
    np.testing.assert_array_equal(frame.rotation, same.rotation)


def test_the_prior_stands_in_before_the_shoulders_were_seen() -> None:
    """The mean of the training poses, which is in the same frame."""
    trained = six_frame()
    trained.update(BODY)
    frame = six_frame(trained.to_body(BODY), np.full(len(LABELS), 0.05))
    moved = turned(BODY, -2.0, (3, 1, 0))
    frame.update(without(moved, LSHO, RSHO))
    assert frame.known
    np.testing.assert_allclose(frame.origin, (moved[LSHO] + moved[RSHO]) / 2, atol=1e-4)


def test_the_yaw_holds_while_the_shoulder_line_is_steep() -> None:
    frame = six_frame()
    frame.update(turned(BODY, 0.5, (0, 0, 1)))
    yaw = frame.yaw
    steep = turned(BODY, 0.5, (0, 0, 1))
    steep[LSHO] = [0.02, -0.03, 1.2]
    steep[RSHO] = [0.01, 0.02, 0.8]
    frame.update(steep)
    assert frame.yaw == yaw
    np.testing.assert_allclose(frame.origin, [0.015, -0.005, 1.0], atol=1e-6)


def test_with_no_marker_it_holds() -> None:
    frame = six_frame()
    frame.update(turned(BODY, 0.7, (1, 2, 3)))
    origin, rotation = frame.origin.copy(), frame.rotation.copy()
    frame.update(np.full_like(BODY, np.nan))
    np.testing.assert_array_equal(frame.origin, origin)
    np.testing.assert_array_equal(frame.rotation, rotation)
    assert frame.sigma == math.inf


def test_of_a_person_who_walks_a_lost_shoulder_is_fitted(data_dir) -> None:
    """A second without it costs little: what moves least against the trunk tells most of it."""
    clip = read_c3d(data_dir / "real/02_01.c3d", LABELS)
    exact = six_frame()
    poses = []
    for xyz in clip.xyz:
        exact.update(xyz)
        poses.append(exact.to_body(xyz))
    frame = six_frame(np.mean(poses, axis=0), np.std(poses, axis=0).mean(axis=1))
    exact.reset()
    errors, turns = [], []
    for index, xyz in enumerate(clip.xyz[:220]):
        exact.update(xyz)
        frame.update(without(xyz, RSHO) if index >= 100 else xyz)
        errors.append(math.dist(frame.origin, exact.origin))
        turns.append(abs(math.remainder(frame.yaw - exact.yaw, math.tau)))
    assert max(errors[:100]) == 0.0
    assert 0.0 < np.mean(errors[100:]) < 0.05
    assert np.mean(turns[100:]) < 0.25
