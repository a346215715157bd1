"""What networks are trained on, against the body frame of the runtime and the world around it."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.body_frame import CONSTRUCTIONS, BodyFrame
from bridge.estimator import ENOUGH
from drivers.marker_set import MARKERS
from training.examples import ExampleOptions, Examples, Poses
from training.mirroring import mirrored
from training.networks import OLDEST

PRINCIPAL = ("LFHD", "RELB", "LUPA", "RSHN", "LTOE", "RTOE")
NOTHING = ExampleOptions(noise=0.0, scale=0.0, pace=0.0)
COUNT = 20_000
SOON = 0.001  # s: no age is less


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


def at_rest(poses):
    """Poses of one real capture, that do not move and are all in one place."""
    count = len(poses)
    return Poses(
        poses=poses,
        velocities=np.zeros_like(poses),
        origin=np.zeros((count, 3)),
        yaw=np.zeros(count),
        capture=np.zeros(count, np.int64),
        seconds=np.arange(count) / 30,
        real=np.ones(count, bool),
    )


def tracked_by(construction):
    return (*PRINCIPAL, *construction.references)


def examples(construction, poses, options=NOTHING, seed=1):
    tracked = tracked_by(construction)
    return Examples(poses, tracked, construction, options, np.random.default_rng(seed))


def turned(yaw):
    """The axes in the world, in columns, of a body that is turned so."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])


class Walk:
    """A capture of a body that goes through the world, turns and changes its shape, all of it
    evenly: between two poses it is halfway in all. Poses are kept at uneven times.
    """

    def __init__(self, construction, random):
        self.first, last = bodies(construction, random, 2).astype(float)
        self.seconds = np.append(0.0, random.choice([1 / 30, 1 / 30, 0.4], 60)).cumsum()
        self.change = (last - self.first) / self.seconds[-1]
        self.start, self.speed = random.normal(0, 3, 3), random.normal(0, 1, 3)
        self.facing, self.turn = random.uniform(-3, 3), random.uniform(-3, 3)
        self.moving, self.gain = random.normal(0, 1, (2, len(MARKERS), 3))

    def at(self, t):
        """All markers in the world, and their velocities there, which are whatever they are."""
        axes = turned(self.facing + self.turn * t)
        body = self.first + self.change * t
        return (
            body @ axes.T + self.start + self.speed * t,
            (self.moving + self.gain * t) @ axes.T,
        )

    def poses(self):
        t = self.seconds[:, None, None]
        yaw = self.facing + self.turn * self.seconds
        return Poses(
            poses=(self.first + self.change * t).astype(np.float32),
            velocities=(self.moving + self.gain * t).astype(np.float32),
            origin=self.start + self.speed * t[:, :, 0],
            yaw=np.arctan2(np.sin(yaw), np.cos(yaw)),
            capture=np.zeros(len(t), np.int64),
            seconds=self.seconds,
            real=np.ones(len(t), bool),
        )


def one_after_the_other(parts):
    joined = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
        for entry in fields(Poses)
    }
    lengths = [len(part.poses) for part in parts]
    return Poses(**joined | {"capture": np.repeat(np.arange(len(parts)), lengths)})


@pytest.fixture(scope="module", params=CONSTRUCTIONS.values(), ids=lambda frame: frame.name)
def construction(request):
    return request.param


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_a_sighting_is_what_the_runtime_would_remember(construction, seed):
    """Of every example: whose it was and when is told by where the markers were then; all else is
    made anew in the world, and told by a body frame that was there then and is there now.
    """
    random = np.random.default_rng(seed)
    walks = [Walk(construction, random) for _ in range(2)]
    corpus = one_after_the_other([walk.poses() for walk in walks])
    made = examples(construction, corpus, ExampleOptions(noise=0.0, pace=0.0), seed)
    missing, true = made.missing(120)
    tracked = tracked_by(construction)
    at = [MARKERS.index(label) for label in tracked]
    both = np.concatenate([corpus.poses, mirrored(corpus.poses)])[:, at]
    spread = np.sqrt(both.var(axis=0).mean(axis=1))
    # Somebody's markers are size * (first + t * change).
    sides = [(walk, side) for walk in walks for side in (lambda xyz: xyz, mirrored)]
    lines = [
        np.column_stack([side(part[None])[0, at].ravel() for part in (walk.first, walk.change)])
        for walk, side in sides
    ]
    compared = between = 0
    for row, then in enumerate(missing.then):
        fits = [np.linalg.lstsq(line, then.ravel()) for line in lines]
        best = int(np.argmin([fit[1][0] for fit in fits]))
        if fits[best][1][0] > 1e-8 or missing.age[row] < 1.01 * SOON:
            continue  # never seen, or all but now
        compared += 1
        walk, side = sides[best]
        (size, moved), *_ = fits[best]
        before = moved / size
        between += np.abs(walk.seconds - before).min() > 1e-3
        now = before + float(missing.age[row])
        assert -1e-3 < before < now < walk.seconds[-1] + 1e-3
        there = missing.present[row] == 1
        (then_world, pace), (world, _) = (
            [size * side(part[None])[0, at] for part in walk.at(t)] for t in (before, now)
        )
        frame = BodyFrame(tracked, np.zeros((len(at), 3)), spread, construction)
        frame.update(then_world)
        np.testing.assert_allclose(then, frame.to_body(then_world), atol=1e-4)
        frame.place(np.where(there[:, None], world, np.nan))
        np.testing.assert_allclose(true[row], frame.to_body(world), atol=1e-3)
        np.testing.assert_allclose(missing.left[row], frame.to_body(then_world), atol=2e-3)
        np.testing.assert_allclose(missing.pace[row], pace @ frame.rotation, atol=5e-3)
    assert compared > 80
    assert between > 20  # not at a pose that was kept


def test_whole_poses_are_those_of_the_corpus_and_their_mirror_images(construction):
    random = np.random.default_rng(0)
    poses = bodies(construction, random, count=4)
    corpus = at_rest(poses)
    corpus.velocities[:] = random.normal(0, 1, poses.shape)
    batch = examples(construction, corpus).whole(COUNT)
    originals = np.concatenate([poses, mirrored(poses)])
    distance = np.abs(batch.poses[:, None] - originals).max(axis=(2, 3))
    assert distance.min(axis=1).max() == 0.0
    drawn = distance.argmin(axis=1)
    np.testing.assert_allclose(np.bincount(drawn, minlength=8), COUNT / 8, rtol=0.1)
    at = [MARKERS.index(label) for label in tracked_by(construction)]
    np.testing.assert_array_equal(batch.tracked, batch.poses[:, at])
    # Velocities are those of the pose, against the origin's.
    moving = np.concatenate([corpus.velocities, mirrored(corpus.velocities)])[drawn]
    origin = [MARKERS.index(label) for label in construction.origin]
    moving -= moving[:, origin].mean(axis=1, keepdims=True)
    np.testing.assert_allclose(batch.velocities, moving, atol=1e-5)
    assert batch.tracked.dtype == batch.poses.dtype == batch.velocities.dtype == np.float32


def test_bodies_are_larger_and_smaller_and_measured_with_noise(construction):
    corpus = at_rest(bodies(construction, np.random.default_rng(0), count=1))
    (pose,) = corpus.poses
    corpus.velocities[:] = pose  # it grows: speeds are told by sizes
    tracked = tracked_by(construction)
    batch = examples(construction, corpus, ExampleOptions(noise=0.02, scale=0.1)).whole(COUNT)
    sizes, rests = [], []
    for original in (pose, mirrored(pose[None])[0]):
        size = (batch.poses * original).sum(axis=(1, 2)) / (original**2).sum()
        sizes.append(size)
        rests.append(np.abs(batch.poses - size[:, None, None] * original).max(axis=(1, 2)))
    # The whole body is scaled, all its markers alike, and with it how it moves.
    assert np.min(rests, axis=0).max() < 1e-5
    size = np.where(rests[0] < rests[1], *sizes)
    assert size.mean() == pytest.approx(1.0, abs=0.005)
    assert size.std() == pytest.approx(0.1, rel=0.05)
    np.testing.assert_allclose(batch.velocities, batch.poses, atol=1e-5)
    noise = batch.tracked - batch.poses[:, [MARKERS.index(label) for label in tracked]]
    features = [tracked.index(label) for label in construction.features(tracked)]
    np.testing.assert_allclose(noise[:, features].std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.001)
    assert not np.delete(noise, features, axis=1).any()  # a lone origin is where it is


def test_real_captures_are_drawn_so_much_more_often(construction):
    parts = [at_rest(bodies(construction, np.random.default_rng(seed), 5)) for seed in (0, 1)]
    parts[1].real[:] = False
    made = examples(construction, one_after_the_other(parts), ExampleOptions(4.0, 0.0, scale=0.0))
    own = np.concatenate([parts[0].poses, mirrored(parts[0].poses)])
    found = made.whole(COUNT // 4).poses
    real = (np.abs(found[:, None] - own).max(axis=(2, 3)) == 0.0).any(axis=1)
    assert real.mean() == pytest.approx(4 / 5, abs=0.02)


def test_some_are_missing_all_as_often_and_enough_are_there(construction):
    made = examples(construction, at_rest(bodies(construction, np.random.default_rng(0))))
    missing, true = made.missing(COUNT)
    lacks = missing.present == 0
    assert set(np.unique(missing.present)) == {0.0, 1.0}
    assert lacks.shape == (COUNT, len(tracked_by(construction)))
    shares = lacks.mean(axis=0)
    assert 0.1 < shares.mean() < 0.4
    np.testing.assert_allclose(shares, shares.mean(), atol=0.015)
    count = lacks.sum(axis=1)
    assert count.min() == 1
    assert count.max() == lacks.shape[1] - ENOUGH
    assert 0.5 < (count == 1).mean() < 0.8
    np.testing.assert_array_equal(missing.tracked, np.where(lacks[:, :, None], 0.0, true))
    for entry in fields(missing):
        assert getattr(missing, entry.name).dtype == np.float32


def test_ages_are_of_all_kinds_and_never_of_another_capture(construction):
    random = np.random.default_rng(0)
    walks = [Walk(construction, random) for _ in range(3)]
    made = examples(construction, one_after_the_other([walk.poses() for walk in walks]))
    missing, _ = made.missing(COUNT)
    never = (missing.then == made.mean).all(axis=(1, 2))
    assert never.mean() == pytest.approx(0.05, abs=0.01)
    np.testing.assert_array_equal(missing.left[never], missing.then[never])
    assert not missing.pace[never].any()
    assert (missing.age[never] == OLDEST).all()
    age = missing.age[~never]
    longest = max(walk.seconds[-1] for walk in walks)
    assert np.float32(SOON) <= age.min() < 0.01
    assert 0.8 * longest < age.max() < longest + 1e-6
    # A quarter and more is of a gap that is over soon, some is older than is told apart.
    assert (age < 0.45).mean() > 0.25
    assert (age > OLDEST).mean() > 0.05


def test_markers_sit_elsewhere_on_everybody_and_stay_there(construction):
    """Of a body at rest: what is off is as far off now as it was then."""
    corpus = at_rest(bodies(construction, np.random.default_rng(0), count=1).repeat(5, axis=0))
    options = ExampleOptions(noise=0.02, scale=0.0, pace=0.3)
    made = examples(construction, corpus, options)
    missing, true = made.missing(COUNT)
    tracked = tracked_by(construction)
    references = missing.present[:, [tracked.index(one) for one in construction.references]]
    seen = references.all(axis=1) & (missing.age < OLDEST)
    assert seen.mean() > 0.2
    np.testing.assert_array_equal(missing.then[seen], true[seen])
    np.testing.assert_allclose(missing.left[seen], true[seen], atol=1e-6)
    np.testing.assert_allclose(missing.pace[seen].std(axis=0), 0.3, rtol=0.1)
    at = [MARKERS.index(label) for label in tracked]
    features = [tracked.index(label) for label in construction.features(tracked)]
    both = [corpus.poses[0, at], mirrored(corpus.poses[:1])[0, at]]
    offs = np.array([true[seen] - one for one in both])
    nearer = np.abs(offs).mean(axis=(2, 3)).argmin(axis=0)
    off = offs[nearer, np.arange(len(nearer))]
    np.testing.assert_allclose(off[:, features].std(axis=0), 0.02, rtol=0.1)
    assert not np.delete(off, features, axis=1).any()


def test_the_same_seed_draws_the_same(construction):
    corpus = Walk(construction, np.random.default_rng(0)).poses()
    one, two, other = (
        examples(construction, corpus, ExampleOptions(), seed).missing(64) for seed in (5, 5, 6)
    )
    for entry in fields(one[0]):
        first, second = getattr(one[0], entry.name), getattr(two[0], entry.name)
        np.testing.assert_array_equal(first, second)
    assert (one[0].then != other[0].then).any()
