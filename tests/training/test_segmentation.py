from itertools import permutations

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


BEHAVIOURS = {
    "walk": "real/07_01.c3d",
    "punch": "real/02_05.c3d",
    "jump": "virtual/jumping_3.c3d",
    "signals": "virtual/basketball_signal_1.c3d",
}
# With these, all motions of which there is a capture long enough.
OTHERS = (
    "real/02_01.c3d",
    "virtual/running_3.c3d",
    "virtual/walking_20.c3d",
    "virtual/washwindow_t1.c3d",
    "virtual/basketball_2.c3d",
    "virtual/directing_traffic_1.c3d",
    "virtual/cmu_05_06.c3d",
    "virtual/soccer_3.c3d",
)
LONGEST = 500  # frames of each that are glued
NEAR = 60  # frames: 0.5 s
# Whole captures of one thing done: 2.6 to 7.4 s.
SINGLE = (
    "real/02_01.c3d",
    "real/07_01.c3d",
    "virtual/walking_19.c3d",
    "virtual/walking_20.c3d",
    "virtual/jumping_3.c3d",
    "virtual/basketball_2.c3d",
    "virtual/cmu_05_06.c3d",
)


@pytest.fixture(scope="module")
def poses_of(data_dir):
    by_name = {capture.name: capture for capture in captures(data_dir)}

    def found(name):
        poses = body_poses(read_take(data_dir, by_name[name]).xyz)
        return poses.reshape(len(poses), -1)

    return found


def cuts(poses):
    return [part.start for part in Segmentation().cut(poses, RATE)][1:]


@pytest.mark.parametrize(("first", "second"), list(permutations(BEHAVIOURS, 2)))
def test_captures_glued_together_are_cut_at_the_seam_alone(poses_of, first, second):
    before, after = (poses_of(BEHAVIOURS[name])[:LONGEST] for name in (first, second))
    found = cuts(np.concatenate([before, after]))
    assert len(found) == 1
    assert abs(found[0] - len(before)) <= NEAR


def test_most_seams_of_any_two_captures_are_found(poses_of):
    """Not all: a behaviour that is seen for little more than a second, or that is itself varied,
    does not tell what comes next from what it may still do.
    """
    parts = [poses_of(name)[:LONGEST] for name in (*BEHAVIOURS.values(), *OTHERS)]
    pairs = list(permutations(parts, 2))
    found = [
        any(abs(cut - len(first)) <= NEAR for cut in cuts(np.concatenate([first, second])))
        for first, second in pairs
    ]
    assert len(pairs) == 132
    assert np.mean(found) >= 0.7


@pytest.mark.parametrize("name", SINGLE)
def test_no_cut_inside_a_single_behaviour(poses_of, name):
    assert cuts(poses_of(name)) == []
