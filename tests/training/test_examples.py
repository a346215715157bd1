import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.body_frame import PAPER_FRAME, SIX_FRAME, BodyFrame
from bridge.estimator import ENOUGH
from drivers.marker_set import MARKERS
from training.examples import ExampleOptions, Examples
from training.mirroring import mirrored

PRINCIPAL = ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")
NOTHING = ExampleOptions(noise=0.0, scale=0.0)
COUNT = 20_000


def bodies(construction, random, count=30, spread=0.08):
    """Poses (count, 41, 3) in the body frame: of one body, the same both ways round, whose markers
    wander. It is wide, as no yaw can be told from markers that are near each other.
    """
    shape = np.random.default_rng(3).normal(0, 0.7, (len(MARKERS), 3))
    shape[MARKERS.index("LSHO")], shape[MARKERS.index("RSHO")] = [-0.4, 0, 0], [0.4, 0, 0]
    shape = (shape + mirrored(shape[None])[0]) / 2
    frame = BodyFrame(MARKERS, construction=construction)
    poses = []
    for wander in random.normal(0, spread, (count, len(MARKERS), 3)):
        world = (shape + wander).astype(np.float32)
        frame.update(world)
        poses.append(frame.to_body(world))
    return np.array(poses)


def examples(construction, poses, options=NOTHING, whole=0.0, seed=1, capture=None):
    tracked = (*PRINCIPAL, *construction.references)
    capture = np.zeros(len(poses), np.int64) if capture is None else capture
    random = np.random.default_rng(seed)
    return Examples(
        poses, capture, np.ones(len(poses), bool), tracked, construction, options, whole, random
    ), tracked


def turned(poses, yaw, shift):
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    return (poses @ turn + shift).astype(np.float32)


@pytest.fixture(scope="module", params=[PAPER_FRAME, SIX_FRAME], ids=lambda frame: frame.name)
def construction(request):
    return request.param


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_examples_are_placed_as_the_runtime_places_bodies(construction, seed):
    """Whatever is missing, wherever the bodies stood: one after the other as all at once."""
    random = np.random.default_rng(seed)
    poses = bodies(construction, random)
    made, tracked = examples(construction, poses)
    at = [MARKERS.index(label) for label in tracked]
    now, known = poses[:15], poses[15:]
    present = random.random((15, len(at))) > random.uniform(0, 0.8)
    # Enough are there, as in every example.
    order = random.random(present.shape).argsort(axis=1)
    present |= order < ENOUGH
    found = made._placed(now, known, present)
    both = np.concatenate([poses, mirrored(poses)])[:, at]
    spread = np.sqrt(both.var(axis=0).mean(axis=1))
    for one, before, there, placed in zip(now, known, present, found, strict=True):
        frame = BodyFrame(tracked, np.zeros((len(at), 3)), spread, construction)
        frame.update(turned(before[at], random.uniform(-3, 3), random.normal(size=3)))
        world = turned(one, random.uniform(-3, 3), random.normal(size=3))
        frame.place(np.where(there[:, None], world[at], np.float32(np.nan)))
        np.testing.assert_allclose(placed, frame.to_body(world), atol=1e-4)


def test_poses_are_those_of_the_corpus_and_their_mirror_images(construction):
    poses = bodies(construction, np.random.default_rng(0), count=4)
    made, tracked = examples(construction, poses, whole=1.0)
    batch = made.draw(COUNT)
    assert batch.present.all()
    originals = np.concatenate([poses, mirrored(poses)])
    distance = np.abs(batch.poses[:, None] - originals).max(axis=(2, 3))
    assert distance.min(axis=1).max() == 0.0
    times = np.bincount(distance.argmin(axis=1), minlength=8)
    np.testing.assert_allclose(times, COUNT / 8, rtol=0.1)
    features = [MARKERS.index(label) for label in construction.features(tracked)]
    np.testing.assert_array_equal(batch.features, batch.poses[:, features])
    assert batch.features.dtype == batch.poses.dtype == batch.present.dtype == np.float32


def test_bodies_are_larger_and_smaller_and_measured_with_noise(construction):
    poses = bodies(construction, np.random.default_rng(0), count=1)
    options = ExampleOptions(noise=0.02, scale=0.1)
    made, tracked = examples(construction, poses, options, whole=1.0)
    batch = made.draw(COUNT)
    sizes, rests = [], []
    for original in (poses[0], mirrored(poses)[0]):
        size = (batch.poses * original).sum(axis=(1, 2)) / (original**2).sum()
        sizes.append(size)
        rests.append(np.abs(batch.poses - size[:, None, None] * original).max(axis=(1, 2)))
    # The whole body is scaled, all its markers alike.
    assert np.min(rests, axis=0).max() < 1e-5
    size = np.where(rests[0] < rests[1], *sizes)
    assert size.mean() == pytest.approx(1.0, abs=0.005)
    assert size.std() == pytest.approx(0.1, rel=0.05)
    features = [MARKERS.index(label) for label in construction.features(tracked)]
    noise = batch.features - batch.poses[:, features]
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.001)


def test_every_marker_is_missing_as_often_and_enough_are_there(construction):
    poses = bodies(construction, np.random.default_rng(0))
    made, tracked = examples(construction, poses, whole=0.25)
    batch = made.draw(COUNT)
    missing = batch.present == 0
    assert set(np.unique(batch.present)) == {0.0, 1.0}
    assert missing.shape == (COUNT, len(tracked))
    shares = missing.mean(axis=0)
    assert 0.1 < shares.mean() < 0.4
    np.testing.assert_allclose(shares, shares.mean(), atol=0.015)
    count = missing.sum(axis=1)
    assert count.max() == len(tracked) - ENOUGH
    # A quarter lacks nothing in any case, some of the others by chance.
    assert 0.25 < (count == 0).mean() < 0.5


def test_what_is_missing_is_zero_and_wanted(construction):
    poses = bodies(construction, np.random.default_rng(0))
    made, tracked = examples(construction, poses, ExampleOptions(), whole=0.2)
    batch = made.draw(500)
    features = construction.features(tracked)
    there = batch.present[:, [tracked.index(label) for label in features]]
    assert (batch.features[there == 0] == 0).all()
    assert (batch.features[there == 1] != 0).any(axis=1).all()
    for row, label in enumerate(MARKERS):
        lacks = 1 - batch.present[:, tracked.index(label)] if label in tracked else np.ones(500)
        np.testing.assert_array_equal(batch.wanted[:, row], lacks)


def test_features_are_measured_in_the_frame_that_is_estimated_in(construction):
    """Where references are missing the whole pose moves with the frame."""
    poses = bodies(construction, np.random.default_rng(0), count=600)
    made, tracked = examples(construction, poses)
    batch = made.draw(2000)
    features = construction.features(tracked)
    there = batch.present[:, [tracked.index(label) for label in features]] == 1
    shown = batch.poses[:, [MARKERS.index(label) for label in features]]
    np.testing.assert_array_equal(batch.features[there], shown[there])
    references = batch.present[:, [tracked.index(one) for one in construction.references]]
    settled = references.all(axis=1)
    # How far the pose's own body frame is from the one it is told in.
    origin = batch.poses[:, [MARKERS.index(one) for one in construction.origin]].mean(axis=1)
    left, right = (batch.poses[:, MARKERS.index(one)] for one in construction.axis)
    off = np.abs(np.column_stack([origin, (right - left)[:, 1]])).max(axis=1)
    assert off[settled].max() < 1e-6
    assert (off[~settled] > 1e-3).mean() > 0.9


def test_the_frame_was_known_from_the_same_capture(construction):
    """Of captures that hold still every frame is exact, whenever it was known last."""
    random = np.random.default_rng(0)
    stills = np.concatenate([bodies(construction, random, count=1) for _ in range(6)])
    capture = np.repeat(np.arange(6), 5)
    made, _ = examples(construction, stills[capture], capture=capture)
    batch = made.draw(3000)
    originals = np.concatenate([stills, mirrored(stills)])
    moved = np.abs(batch.poses[:, None] - originals).max(axis=(2, 3)).min(axis=1)
    assert (batch.present == 0).any()
    assert moved.max() < 1e-5


def test_the_same_seed_draws_the_same(construction):
    poses = bodies(construction, np.random.default_rng(0))
    one, two, other = (
        examples(construction, poses, ExampleOptions(), 0.1, seed)[0].draw(64) for seed in (5, 5, 6)
    )
    for name in ("features", "present", "poses", "wanted"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert (one.features != other.features).any()
