import shutil
from dataclasses import fields, replace

import numpy as np
import pytest

from bridge.body_frame import CONSTRUCTIONS
from drivers.c3d_file import read_c3d, write_c3d
from drivers.errors import MarkerbridgeError
from training.corpus import Corpus, read_corpus, work_of
from training.dataset import captures, load_training, training_captures
from training.moments import moments_of
from training.poses import moving_poses
from training.recipe import RECIPES, Recipe
from training.workers import workers

RECIPE = RECIPES["local"]
PER_POSE = ("segment", "time", "poses", "velocities", "origin", "yaw")


def read(folder, recipe=RECIPE, warn=pytest.fail):
    done = []
    with workers(None):
        corpus = read_corpus(
            folder, training_captures(folder), recipe, lambda _, units: done.append(units), warn
        )
    assert sum(done) == pytest.approx(work_of(folder, training_captures(folder)))
    return corpus


@pytest.fixture(scope="module")
def corpus(small_dir):
    return read(small_dir)


def test_it_holds_every_segment_of_every_capture(corpus, small_dir):
    takes = load_training(small_dir, pytest.fail)
    assert [one.name for one in corpus.captures] == [take.name for take in takes]
    assert corpus.frames_read.tolist() == [len(take.xyz) for take in takes]
    row = 0
    for number, take in enumerate(takes):
        moving = moving_poses(take.xyz, take.rate, CONSTRUCTIONS[RECIPE.body_frame])
        poses = moving.poses
        assert corpus.frames_used[number] == len(poses)
        for part in RECIPE.segmentation.cut(poses.reshape(len(poses), -1), take.rate):
            assert corpus.capture[row] == number
            assert corpus.start[row] == part.start
            assert corpus.frames[row] == part.stop - part.start
            assert corpus.seconds[row] == corpus.frames[row] / take.rate
            np.testing.assert_array_equal(corpus.moments[row], moments_of(poses[part]))
            kept = corpus.segment == row
            np.testing.assert_array_equal(corpus.time[kept], moving.frame[part][::4] / take.rate)
            for name in PER_POSE[2:]:
                expected = getattr(moving, name)[part][::4]
                np.testing.assert_array_equal(getattr(corpus, name)[kept], expected)
            row += 1
    assert row == len(corpus.frames) == len(corpus.moments)


def test_poses_are_kept_within_the_limit_from_all_segments(small_dir, corpus):
    few = read(small_dir, Recipe(pose_rows=100))
    assert 40 < len(few.poses) < 110  # by the files' size, which may hold more than 41 markers
    assert set(few.segment) == set(range(len(few.frames)))
    np.testing.assert_array_equal(few.moments, corpus.moments)


def test_poses_are_kept_when_they_were_whatever_the_capture_lacks(small_dir, tmp_path):
    """Times go on through frames that lack a marker, of a capture of any rate."""
    clip = read_c3d(small_dir / "real/02_01.c3d")
    xyz = clip.xyz.copy()
    xyz[40:100, 7] = np.nan
    write_c3d(tmp_path / "holed.c3d", replace(clip.layout, rate=60.0), xyz)
    corpus = read(tmp_path)
    frames = corpus.time * 60
    assert frames.max() > len(xyz) - 5
    assert not ((frames >= 40) & (frames < 100)).any()
    moving = moving_poses(xyz, 60.0, CONSTRUCTIONS[RECIPE.body_frame])
    rows = np.searchsorted(moving.frame, frames.round())
    np.testing.assert_allclose(frames, moving.frame[rows], atol=1e-9)
    np.testing.assert_array_equal(corpus.velocities, moving.velocities[rows])


def test_of_begun_captures_the_real_ones_lack_their_ends(corpus):
    begun = corpus.begun(0.6)
    capture, kept = corpus.capture[corpus.segment], begun.capture[begun.segment]
    for number, one in enumerate(corpus.captures):
        count = (capture == number).sum()
        first = np.ceil(0.6 * count) if one.real else count
        assert (kept == number).sum() == first
        for name in PER_POSE:
            own, rest = getattr(corpus, name)[capture == number], getattr(begun, name)
            np.testing.assert_array_equal(rest[kept == number], own[: int(first)])
    for entry in fields(Corpus):
        if entry.name not in PER_POSE:
            assert getattr(begun, entry.name) is getattr(corpus, entry.name)
    assert {one.real for one in corpus.captures} == {True, False}


def test_the_order_of_work_changes_nothing(small_dir, corpus):
    again = read_corpus(  # without workers: one after the other
        small_dir, training_captures(small_dir), RECIPE, lambda *_: None, pytest.fail
    )
    for name in ("moments", *PER_POSE):
        np.testing.assert_array_equal(getattr(again, name), getattr(corpus, name))


def test_segments_without_some_captures(corpus):
    rest = corpus.without(frozenset({"real/02_01.c3d", "no such file"}))
    names = {corpus.captures[row].name for row in corpus.capture[rest]}
    assert names == {one.name for one in corpus.captures} - {"real/02_01.c3d"}
    assert len(corpus.without(frozenset(one.name for one in corpus.captures))) == 0


def test_what_cannot_be_used_is_told_and_left_out(small_dir, tmp_path):
    whole = read_c3d(small_dir / "real/02_01.c3d")
    shutil.copy(small_dir / "real/02_01.c3d", tmp_path / "02_01.c3d")
    (tmp_path / "text.c3d").write_text("no capture")
    blind = whole.xyz.copy()
    blind[5:, 3] = np.nan
    write_c3d(tmp_path / "blind.c3d", whole.layout, blind)
    told = []
    corpus = read(tmp_path, warn=told.append)
    assert [one.name for one in corpus.captures] == ["02_01.c3d"]
    assert [one.subject for one in captures(tmp_path)] == ["02", "unknown", "unknown"]
    assert len(told) == 2
    assert "blind.c3d: fewer than 10 frames" in told[0]
    assert "text.c3d" in told[1]


def test_nothing_to_train_on_is_an_error(tmp_path):
    (tmp_path / "text.c3d").write_text("no capture")
    with pytest.raises(MarkerbridgeError, match="no capture has enough frames"):
        read(tmp_path, warn=lambda _: None)
