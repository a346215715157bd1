import numpy as np
import pytest
from sklearn.decomposition import PCA

from training.poses import body_poses
from training.segmentation import Segmentation, _Moments

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


def test_real_captures_glued_together_are_cut_at_the_seam(train_takes):
    takes = {take.name: take for take in train_takes}
    walk = body_poses(takes["real/07_01.c3d"].xyz)
    punch = body_poses(takes["real/02_05.c3d"].xyz)[:600]
    both = np.concatenate([walk, punch])
    starts = [part.start for part in Segmentation().cut(both.reshape(len(both), -1), RATE)]
    assert min(abs(start - len(walk)) for start in starts) <= 30
    assert len(Segmentation().cut(walk.reshape(len(walk), -1), RATE)) == 1


def test_moments_of_any_run_are_those_of_its_frames():
    poses = np.random.default_rng(2).normal(size=(105, 4))
    mean, second = _Moments(poses, 10).between(3, 7)
    np.testing.assert_allclose(mean, poses[30:70].mean(axis=0))
    np.testing.assert_allclose(second, poses[30:70].T @ poses[30:70] / 40)


def test_the_distance_is_that_of_scikit_learns_probabilistic_pca():
    random = np.random.default_rng(3)
    axes = np.linalg.qr(random.normal(size=(12, 12)))[0][:3]
    seen, ahead = (behaviour(random, 400, axes, 0.5) for _ in range(2))
    segmentation = Segmentation(floor=0.0)
    fitted, coming = (_Moments(part, 1).between(0, 400) for part in (seen, ahead))
    model = PCA(n_components=0.95, svd_solver="full").fit(seen)
    # scikit-learn divides by N - 1 where the segmentation divides by N.
    precision = model.get_precision() * 400 / 399
    away = ahead - seen.mean(axis=0)
    expected = np.einsum("ni,ij,nj->n", away, precision, away).mean() / 12
    assert segmentation.distance(fitted, coming) == pytest.approx(expected, rel=1e-6)
