from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.body_frame import MIN_PROJECTION, BodyFrame
from drivers.c3d_file import read_c3d

LABELS = ("LFHD", "RELB", "LTOE", "RTOE", "C7", "LSHO", "RSHO")
BODY = np.array(
    [
        [0.0, 0.15, 0.15],
        [0.4, 0.05, -0.3],
        [-0.1, 0.2, -1.4],
        [0.1, -0.1, -1.4],
        [0.0, 0.0, 0.0],
        [-0.18, 0.05, -0.02],
        [0.17, 0.05, -0.04],
    ],
    np.float32,
)
C7, LSHO, RSHO = 4, 5, 6
angles = st.floats(-math.pi, math.pi)
shifts = st.tuples(*[st.floats(-5, 5)] * 3)


def turned(xyz: np.ndarray, yaw: float, shift: tuple[float, float, float]) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return (xyz @ rotation.T + np.array(shift)).astype(np.float32)


def without(xyz: np.ndarray, *rows: int) -> np.ndarray:
    holed = xyz.copy()
    holed[list(rows)] = np.nan
    return holed


def test_the_axes_are_the_papers() -> None:
    frame = BodyFrame(LABELS)
    world = turned(BODY, 1.1, (2.0, -1.0, 1.3))
    frame.update(world)
    np.testing.assert_array_equal(frame.origin, world[C7])
    across = world[RSHO] - world[LSHO]
    x = np.array([across[0], across[1], 0]) / math.hypot(across[0], across[1])
    z = np.array([0, 0, 1.0])
    np.testing.assert_allclose(frame.rotation, np.column_stack([x, np.cross(z, x), z]), atol=1e-6)


@given(angles, shifts)
def test_where_the_body_stands_and_faces_does_not_change_it(yaw, shift) -> None:
    here, there = BodyFrame(LABELS), BodyFrame(LABELS)
    here.update(BODY)
    moved = turned(BODY, yaw, shift)
    there.update(moved)
    np.testing.assert_allclose(there.to_body(moved), here.to_body(BODY), atol=1e-5)


@given(angles, shifts)
def test_to_body_and_back_is_where_it_was(yaw, shift) -> None:
    frame = BodyFrame(LABELS)
    world = turned(BODY, yaw, shift)
    frame.update(world)
    np.testing.assert_allclose(frame.to_world(frame.to_body(world)), world, atol=1e-5)


@pytest.mark.parametrize("lost", [(C7,), (LSHO,), (C7, RSHO), (LSHO, RSHO), (C7, LSHO, RSHO)])
@given(yaw=angles, shift=shifts)
def test_a_stiff_body_is_followed_exactly_without_its_references(lost, yaw, shift) -> None:
    """Least squares on what is left has no error where nothing moves against the body."""
    frame = BodyFrame(LABELS)
    frame.update(BODY)
    moved = turned(BODY, yaw, shift)
    exact = BodyFrame(LABELS)
    exact.update(moved)
    frame.update(without(moved, *lost))
    np.testing.assert_allclose(frame.origin, exact.origin, atol=1e-4)
    np.testing.assert_allclose(frame.rotation, exact.rotation, atol=1e-4)
    assert (frame.sigma > 0) == (C7 in lost)


def test_with_no_marker_it_holds() -> None:
    frame = BodyFrame(LABELS)
    frame.update(turned(BODY, 0.7, (1, 2, 3)))
    origin, rotation = frame.origin.copy(), frame.rotation.copy()
    frame.update(np.full_like(BODY, np.nan))
    np.testing.assert_array_equal(frame.origin, origin)
    np.testing.assert_array_equal(frame.rotation, rotation)
    assert frame.sigma == math.inf


def test_the_yaw_holds_while_the_shoulder_line_is_steep() -> None:
    frame = BodyFrame(LABELS)
    frame.update(turned(BODY, 0.5, (0, 0, 1)))
    yaw = frame.yaw
    steep = turned(BODY, 0.5, (0, 0, 1))
    steep[LSHO] = steep[C7] + [0.02, -0.03, 0.2]
    steep[RSHO] = steep[C7] + [0.01, 0.02, -0.2]
    frame.update(steep)
    assert frame.yaw == yaw
    np.testing.assert_array_equal(frame.origin, steep[C7])


def test_the_prior_stands_in_before_the_first_good_frame() -> None:
    frame = BodyFrame(LABELS, BODY, np.full(len(LABELS), 0.05))
    moved = turned(BODY, -2.0, (3, 1, 0))
    frame.update(without(moved, C7, LSHO))
    assert frame.known
    np.testing.assert_allclose(frame.origin, moved[C7], atol=1e-4)


def test_one_marker_alone_moves_the_origin_and_leaves_the_yaw() -> None:
    frame = BodyFrame(LABELS)
    frame.update(turned(BODY, 1.0, (0, 0, 0)))
    moved = turned(BODY, 1.0, (0.3, 0.0, 0.0))
    frame.update(without(moved, 0, 1, 2, C7, LSHO, RSHO))
    assert frame.yaw == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(frame.origin, moved[C7], atol=1e-5)


def test_a_break_dance_does_not_whirl_the_frame(data_dir) -> None:
    """In 85_12 the shoulder line stands upright at times, and its bare direction whirls there."""
    clip = read_c3d(data_dir / "real/85_12.c3d", LABELS)
    frame = BodyFrame(LABELS)
    across = clip.xyz[:, RSHO] - clip.xyz[:, LSHO]
    bare = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    level = np.linalg.norm(across[:, :2], axis=1) / np.linalg.norm(across, axis=1)
    steep = level < MIN_PROJECTION
    yaws = []
    for xyz in clip.xyz:
        frame.update(xyz)
        yaws.append(frame.yaw)
    turns = np.abs(np.diff(np.unwrap(yaws)))
    assert 20 < steep.sum() < 0.2 * len(steep)
    assert np.abs(np.diff(bare))[steep[1:]].sum() > 3  # rad, in all
    assert turns[steep[1:]].sum() == 0
    np.testing.assert_allclose(np.cos(yaws)[~steep], np.cos(bare)[~steep], atol=1e-4)
