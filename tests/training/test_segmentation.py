import numpy as np
import pytest

from training.dataset import captures, read_take
from training.poses import body_poses
from training.segmentation import Segmentation

RATE = 120.0


def behaviour(random, frames, axes, mean, width=12):
    """Smooth motion along fixed axes about a mean, the same every second; 2 mm of noise."""
    t = np.arange(frames)[:, None] / RATE
    phases = random.uniform(0, 2 * np.pi, len(axes))
    scores = 0.2 * np.sin(2 * np.pi * np.arange(1, len(axes) + 1) * t + phases)
    return mean + scores @ axes + random.normal(scale=0.002, size=(frames, width))


def two_behaviours(seed, first, second):
    random = np.random.default_rng(seed)
    axes = np.linalg.qr(random.normal(size=(12, 12)))[0]
    mean = random.normal(size=12)
    return np.concatenate(
        [behaviour(random, first, axes[:3], mean), behaviour(random, second, axes[3:6], mean)]
    )


@pytest.mark.parametrize("seed", range(5))
def test_a_change_of_behaviour_is_cut_where_it_is(seed):
    segments = Segmentation().cut(two_behaviours(seed, 600, 500), RATE)
    assert len(segments) == 2
    assert segments[1].start == pytest.approx(600, abs=Segmentation().ahead * RATE)


@pytest.mark.parametrize("seed", range(5))
def test_one_behaviour_is_one_segment(seed):
    random = np.random.default_rng(seed)
    axes = np.linalg.qr(random.normal(size=(12, 12)))[0][:3]
    assert len(Segmentation().cut(behaviour(random, 1200, axes, 0.0), RATE)) == 1


@pytest.mark.parametrize("frames", [2, 50, 209, 210, 1000])
def test_segments_cover_all_frames_in_order(frames):
    poses = np.random.default_rng(1).normal(size=(frames, 6)).cumsum(axis=0)
    segments = Segmentation().cut(poses, RATE)
    assert [i for part in segments for i in range(frames)[part]] == list(range(frames))
    assert len(segments) == 1 or min(s.stop - s.start for s in segments) >= RATE


def test_cuts_are_in_seconds_not_frames():
    poses = two_behaviours(0, 600, 500)
    slow = Segmentation().cut(poses[::2], RATE / 2)
    fast = Segmentation().cut(poses, RATE)
    assert len(slow) == len(fast) == 2
    assert 2 * slow[1].start == pytest.approx(fast[1].start, abs=40)


# Each of one behaviour, and no two of the same.
BEHAVIOURS = {
    "walk": "real/07_01.c3d",
    "punch": "real/02_05.c3d",
    "jump": "virtual/jumping_3.c3d",
    "long walk": "virtual/walking_20.c3d",
    "signals": "virtual/basketball_signal_1.c3d",
    "run": "virtual/running_3.c3d",
}
LONGEST = 500  # frames of each that are glued
NEAR = 60  # frames: 0.5 s


@pytest.fixture(scope="module")
def behaviours(data_dir):
    found = {}
    by_name = {capture.name: capture for capture in captures(data_dir)}
    for behaviour, name in BEHAVIOURS.items():
        poses = body_poses(read_take(data_dir, by_name[name]).xyz)[:LONGEST]
        found[behaviour] = poses.reshape(len(poses), -1)
    return found


def cuts(poses):
    return [part.start for part in Segmentation().cut(poses, RATE)][1:]


@pytest.mark.parametrize("first", ["walk", "punch", "jump", "long walk", "signals"])
def test_captures_glued_together_are_cut_at_the_seam_alone(behaviours, first):
    for second in BEHAVIOURS.keys() - {first, "long walk" if first == "walk" else "walk"}:
        glued = np.concatenate([behaviours[first], behaviours[second]])
        found = cuts(glued)
        assert len(found) == 1, (first, second, found)
        assert abs(found[0] - len(behaviours[first])) <= NEAR, (first, second, found)


@pytest.mark.parametrize("behaviour", BEHAVIOURS)
def test_no_cut_inside_a_single_behaviour(behaviours, behaviour):
    assert cuts(behaviours[behaviour]) == []
