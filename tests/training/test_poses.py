"""Poses and how they move, against the body frame that the runtime follows."""

import numpy as np
import pytest

from bridge.body_frame import CONSTRUCTIONS, BodyFrame
from drivers.marker_set import MARKERS
from training.mirroring import mirrored
from training.poses import body_poses, moving_poses

RATE = 1000.0
LEFT, RIGHT = MARKERS.index("LSHO"), MARKERS.index("RSHO")


@pytest.fixture(params=CONSTRUCTIONS.values(), ids=lambda frame: frame.name)
def construction(request):
    return request.param


def take(seed, frames=400, steep=False):
    """A body (N, 41, 3) in the world that walks, turns about and changes its shape smoothly."""
    random = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / RATE
    shape = random.normal(0, 0.4, (len(MARKERS), 3))
    shape[LEFT], shape[RIGHT] = [-0.2, 0, 0.1], [0.2, 0, 0]
    if steep:
        shape[LEFT], shape[RIGHT] = [-0.02, 0, 0.4], [0.02, 0, 0]
    swing = random.normal(0, 0.02, shape.shape)
    body = shape + swing * np.sin(2 * np.pi * random.uniform(0.5, 2, shape.shape) * t)
    yaw = random.uniform(-4, 4) + random.uniform(-4, 4) * t[:, 0, 0]  # through half a turn
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.zeros((frames, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cos, -sin, sin, cos
    turn[:, 2, 2] = 1.0
    walked = random.normal(0, 1.5, 3) * t + random.normal(0, 3, 3)
    return (body @ turn.transpose(0, 2, 1) + walked).astype(np.float32)


def axes(yaw):
    """The body's axes in the world, in columns."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


def test_poses_and_where_they_are_make_up_the_take(construction):
    xyz = take(0)
    moving = moving_poses(xyz, RATE, construction)
    np.testing.assert_array_equal(moving.frame, np.arange(len(xyz)))
    np.testing.assert_array_equal(moving.poses, body_poses(xyz, construction))
    steps = np.diff(xyz, axis=0) * RATE
    for number in range(1, len(xyz)):
        turn = axes(moving.yaw[number])
        placed = moving.poses[number] @ turn.T + moving.origin[number]
        np.testing.assert_allclose(placed, xyz[number], atol=1e-5)
        velocity = moving.velocities[number] @ turn.T
        np.testing.assert_allclose(velocity, steps[number - 1], atol=1e-4)


def test_poses_and_how_they_move_are_as_the_runtime_says(construction):
    """Frame by frame, upright and with shoulders that are too steep to tell where a body faces."""
    for steep in (False, True):
        xyz = take(1, steep=steep)
        moving = moving_poses(xyz, RATE, construction)
        assert (len(set(moving.yaw)) == 1) == steep
        body = BodyFrame(MARKERS, construction=construction)
        body.update(xyz[0])
        for number in range(1, len(xyz)):
            body.update(xyz[number])
            assert (moving.yaw[number], *moving.origin[number]) == (body.yaw, *body.origin)
            np.testing.assert_array_equal(moving.poses[number], body.to_body(xyz[number]))
            velocity = (xyz[number] - xyz[number - 1]) * RATE @ body.rotation
            np.testing.assert_allclose(moving.velocities[number], velocity, atol=1e-4)


def test_the_mirror_image_of_what_moves_is_what_moves_in_the_mirror(construction):
    """So examples may be mirrored: the frame of such a body is where the mirror puts it."""
    moving = moving_poses(take(3, frames=60), RATE, construction)
    twin = moving_poses(mirrored(take(3, frames=60)), RATE, construction)
    np.testing.assert_allclose(twin.poses, mirrored(moving.poses), atol=1e-5)
    np.testing.assert_allclose(twin.velocities, mirrored(moving.velocities), atol=1e-3)
    np.testing.assert_allclose(twin.origin, moving.origin * [-1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(np.cos(twin.yaw + moving.yaw), 1.0, atol=1e-6)


def test_after_a_gap_and_at_first_the_velocity_is_that_of_the_next_step(construction):
    xyz = take(4, frames=30)
    holed = xyz.copy()
    holed[10:14, 5] = np.nan
    whole, gaps = (moving_poses(one, RATE, construction) for one in (xyz, holed))
    assert gaps.frame.tolist() == [*range(10), *range(14, 30)]
    for name in ("poses", "origin", "yaw"):
        np.testing.assert_array_equal(getattr(gaps, name), getattr(whole, name)[gaps.frame])
    in_world = [
        velocity @ axes(yaw).T for velocity, yaw in zip(gaps.velocities, gaps.yaw, strict=True)
    ]
    steps = np.diff(xyz, axis=0) * RATE
    # The next step is told in the axes at its end.
    for row, frame in enumerate(gaps.frame):
        step = steps[frame] if frame in (0, 14) else steps[frame - 1]
        np.testing.assert_allclose(in_world[row], step, atol=0.02)


def test_whoever_moves_in_no_step_that_is_known_is_at_rest(construction):
    """All of the body: part of it standing still while the rest goes on would be a motion."""
    xyz = take(5, frames=5)
    xyz[[0, 1, 3, 4], [3, 3, 8, 8]] = np.nan
    moving = moving_poses(xyz, RATE, construction)
    assert moving.frame.tolist() == [2]
    assert not moving.velocities.any()


def test_of_no_whole_frames_there_is_nothing(construction):
    moving = moving_poses(np.full((4, len(MARKERS), 3), np.nan, np.float32), RATE, construction)
    assert len(moving.poses) == len(moving.velocities) == len(moving.yaw) == 0
