"""Where the body stands, faces and goes, in every construction of its frame."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.body_frame import (
    CONSTRUCTIONS,
    MIN_PROJECTION,
    PAPER_FRAME,
    SIX_FRAME,
    BodyFrame,
    Construction,
)
from drivers.c3d_file import read_c3d

# A body at yaw zero; of those who wear no C7, all but that.
STANDING = {
    "LFHD": (0.0, 0.15, 0.15),
    "RELB": (0.4, 0.05, -0.3),
    "LTOE": (-0.1, 0.2, -1.4),
    "RTOE": (0.1, -0.1, -1.4),
    "C7": (0.0, 0.0, 0.0),
    "LSHO": (-0.18, 0.05, -0.02),
    "RSHO": (0.17, 0.05, -0.04),
}
each_construction = pytest.mark.parametrize(
    "construction", CONSTRUCTIONS.values(), ids=list(CONSTRUCTIONS)
)
angles = st.floats(-math.pi, math.pi)
shifts = st.tuples(*[st.floats(-5, 5)] * 3)


class Wearer:
    """The markers worn by those whose body frame is of this construction, and their frames."""

    def __init__(self, construction: Construction) -> None:
        self.construction = construction
        worn = [name for name in STANDING if construction is PAPER_FRAME or name != "C7"]
        self.labels = tuple(worn)
        self.body = np.array([STANDING[name] for name in worn], np.float32)
        self.origin = self.rows(*construction.origin)
        self.left, self.right = self.rows(*construction.axis)

    def rows(self, *names: str) -> list[int]:
        return [self.labels.index(name) for name in names]

    def frame(self, mean: np.ndarray | None = None, spread: np.ndarray | None = None) -> BodyFrame:
        return BodyFrame(self.labels, mean, spread, self.construction)

    def placed(self, xyz: np.ndarray) -> BodyFrame:
        frame = self.frame()
        frame.update(xyz)
        return frame

    def middle(self, xyz: np.ndarray) -> np.ndarray:
        """Where the origin is."""
        return xyz[self.origin].mean(axis=0)


def turned(xyz: np.ndarray, yaw: float, shift: tuple[float, float, float]) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return (xyz @ rotation.T + np.array(shift)).astype(np.float32)


def without(xyz: np.ndarray, *rows: int) -> np.ndarray:
    holed = xyz.copy()
    holed[list(rows)] = np.nan
    return holed


def test_a_lone_origin_tells_nothing() -> None:
    labels = tuple(STANDING)
    assert PAPER_FRAME.references == ("C7", "LSHO", "RSHO")
    assert SIX_FRAME.references == ("LSHO", "RSHO")
    assert PAPER_FRAME.features(labels) == tuple(name for name in labels if name != "C7")
    assert SIX_FRAME.features(labels) == labels


@each_construction
@given(yaw=angles, shift=shifts)
def test_the_axes_are_the_papers(construction, yaw, shift) -> None:
    wearer = Wearer(construction)
    world = turned(wearer.body, yaw, shift)
    frame = wearer.placed(world)
    np.testing.assert_allclose(frame.origin, wearer.middle(world), atol=1e-6)
    across = (world[wearer.right] - world[wearer.left]).astype(float)
    x = np.array([across[0], across[1], 0]) / math.hypot(across[0], across[1])
    z = np.array([0, 0, 1.0])
    np.testing.assert_allclose(frame.rotation, np.column_stack([x, np.cross(z, x), z]), atol=1e-6)
    left, right = frame.to_body(world)[[wearer.left, wearer.right]]
    assert left[0] < 0 < right[0]
    assert left[1] == pytest.approx(right[1], abs=1e-5)


@each_construction
@given(yaw=angles, shift=shifts)
def test_where_the_body_stands_and_faces_does_not_change_it(construction, yaw, shift) -> None:
    wearer = Wearer(construction)
    moved = turned(wearer.body, yaw, shift)
    here, there = wearer.placed(wearer.body), wearer.placed(moved)
    np.testing.assert_allclose(there.to_body(moved), here.to_body(wearer.body), atol=1e-5)
    np.testing.assert_allclose(there.to_world(there.to_body(moved)), moved, atol=1e-5)


@each_construction
@given(data=st.data(), yaw=angles, shift=shifts)
def test_a_stiff_body_is_followed_exactly_with_any_markers_missing(
    construction, data, yaw, shift
) -> None:
    """Two markers, whichever, tell where a body stands and faces that does not move in itself.

    Neither pair of these stands one above the other.
    """
    wearer = Wearer(construction)
    count = len(wearer.labels)
    lost = data.draw(st.sets(st.integers(0, count - 1), max_size=count - 2))
    moved = turned(wearer.body, yaw, shift)
    frame, exact = wearer.placed(wearer.body), wearer.placed(moved)
    frame.update(without(moved, *lost))
    np.testing.assert_allclose(frame.origin, exact.origin, atol=1e-4)
    np.testing.assert_allclose(frame.rotation, exact.rotation, atol=1e-4)
    assert (frame.sigma > 0) == bool(lost & set(wearer.origin))


@each_construction
def test_nothing_is_learned_while_a_shoulder_is_missing(construction) -> None:
    """Where the frame is only fitted, markers that moved do not become what is known."""
    wearer = Wearer(construction)
    frame, same = wearer.placed(wearer.body), wearer.placed(wearer.body)
    moved = wearer.body.copy()
    moved[wearer.rows("RELB")] += [0.1, 0.2, 0.3]
    frame.update(without(moved, wearer.left))
    for one in (frame, same):
        one.update(without(wearer.body, wearer.left))
    np.testing.assert_array_equal(frame.origin, same.origin)
    np.testing.assert_array_equal(frame.rotation, same.rotation)


@each_construction
def test_what_might_have_been_seen_is_not_learned(construction) -> None:
    wearer = Wearer(construction)
    frame, same = wearer.placed(wearer.body), wearer.placed(wearer.body)
    frame.place(wearer.body * np.float32(1.5))
    for one in (frame, same):
        one.place(without(wearer.body, wearer.left))
    np.testing.assert_array_equal(frame.origin, same.origin)
    np.testing.assert_array_equal(frame.rotation, same.rotation)


@each_construction
def test_with_no_marker_it_holds(construction) -> None:
    wearer = Wearer(construction)
    frame = wearer.placed(turned(wearer.body, 0.7, (1, 2, 3)))
    origin, rotation = frame.origin.copy(), frame.rotation.copy()
    frame.update(np.full_like(wearer.body, np.nan))
    np.testing.assert_array_equal(frame.origin, origin)
    np.testing.assert_array_equal(frame.rotation, rotation)
    assert frame.sigma == math.inf


def steep(wearer: Wearer) -> np.ndarray:
    """A body at yaw 0.5 whose shoulder line all but stands upright."""
    xyz = turned(wearer.body, 0.5, (0, 0, 1))
    xyz[wearer.left], xyz[wearer.right] = [0.02, -0.03, 1.2], [0.01, 0.02, 0.8]
    return xyz


@each_construction
def test_the_yaw_holds_while_the_shoulder_line_is_steep(construction) -> None:
    wearer = Wearer(construction)
    frame = wearer.placed(turned(wearer.body, 0.5, (0, 0, 1)))
    yaw = frame.yaw
    frame.update(steep(wearer))
    assert frame.yaw == yaw
    np.testing.assert_allclose(frame.origin, wearer.middle(steep(wearer)), atol=1e-6)


@each_construction
def test_the_prior_stands_in_before_the_first_good_frame(construction) -> None:
    """The mean of the training poses, which is in the same frame."""
    wearer = Wearer(construction)
    mean = wearer.placed(wearer.body).to_body(wearer.body)
    frame = wearer.frame(mean, np.full(len(wearer.labels), 0.05))
    moved = turned(wearer.body, -2.0, (3, 1, 0))
    frame.update(without(moved, *wearer.origin, wearer.left))
    assert frame.known
    np.testing.assert_allclose(frame.origin, wearer.middle(moved), atol=1e-4)


@each_construction
def test_one_marker_alone_moves_the_origin_and_leaves_the_yaw(construction) -> None:
    wearer = Wearer(construction)
    frame = wearer.placed(turned(wearer.body, 1.0, (0, 0, 0)))
    yaw = frame.yaw
    moved = turned(wearer.body, 1.0, (0.3, 0.0, 0.0))
    others = set(range(len(moved))) - set(wearer.rows("RTOE"))
    frame.update(without(moved, *others))
    assert frame.yaw == yaw
    np.testing.assert_allclose(frame.origin, wearer.middle(moved), atol=1e-5)


@each_construction
def test_a_break_dance_does_not_whirl_the_frame(construction, data_dir) -> None:
    """In 85_12 the shoulder line stands upright at times, and its bare direction whirls there."""
    wearer = Wearer(construction)
    clip = read_c3d(data_dir / "real/85_12.c3d", wearer.labels)
    frame = wearer.frame()
    across = clip.xyz[:, wearer.right] - clip.xyz[:, wearer.left]
    bare = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    level = np.linalg.norm(across[:, :2], axis=1) / np.linalg.norm(across, axis=1)
    upright = level < MIN_PROJECTION
    yaws = []
    for xyz in clip.xyz:
        frame.update(xyz)
        yaws.append(frame.yaw)
    turns = np.abs(np.diff(np.unwrap(yaws)))
    assert 20 < upright.sum() < 0.2 * len(upright)
    assert np.abs(np.diff(bare))[upright[1:]].sum() > 3  # rad, in all
    assert turns[upright[1:]].sum() == 0
    np.testing.assert_allclose(np.cos(yaws)[~upright], np.cos(bare)[~upright], atol=1e-4)


@each_construction
def test_of_a_person_who_walks_a_lost_shoulder_is_fitted(construction, data_dir) -> None:
    """A second without it costs little: what moves least against the trunk tells most of it."""
    wearer = Wearer(construction)
    clip = read_c3d(data_dir / "real/02_01.c3d", wearer.labels)
    exact = wearer.frame()
    poses = []
    for xyz in clip.xyz:
        exact.update(xyz)
        poses.append(exact.to_body(xyz))
    frame = wearer.frame(np.mean(poses, axis=0), np.std(poses, axis=0).mean(axis=1))
    exact.reset()
    errors, turns = [], []
    for index, xyz in enumerate(clip.xyz[:220]):
        exact.update(xyz)
        frame.update(without(xyz, wearer.right) if index >= 100 else xyz)
        errors.append(math.dist(frame.origin, exact.origin))
        turns.append(abs(math.remainder(frame.yaw - exact.yaw, math.tau)))
    assert max(errors[:100]) == max(turns[:100]) == 0.0
    assert np.mean(errors[100:]) < 0.05
    assert 0.0 < np.mean(turns[100:]) < 0.25


@each_construction
@given(shift=shifts)
def test_the_origin_goes_as_its_markers_go(construction, shift) -> None:
    """Whatever the others do: a velocity against the origin's is that within the body's axes."""
    wearer = Wearer(construction)
    random = np.random.default_rng(0)
    velocity = (random.normal(0, 1, wearer.body.shape) + np.array(shift)).astype(np.float32)
    before, after = wearer.placed(wearer.body), wearer.placed(wearer.body + velocity)
    moved = velocity[before.origins].mean(axis=0)
    assert moved.shape == (3,)
    np.testing.assert_allclose(moved, after.origin - before.origin, atol=1e-5)
