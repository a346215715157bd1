import numpy as np
import pytest
from sklearn.decomposition import PCA

from training.ppca import Ppca, Sums, components_for


@pytest.fixture
def frames():
    """400 frames of 12 coordinates: three free directions, and noise."""
    random = np.random.default_rng(0)
    axes = np.linalg.qr(random.normal(size=(12, 12)))[0][:3]
    scores = random.normal(size=(400, 3)) * [0.5, 0.3, 0.2]
    return 1.0 + scores @ axes + random.normal(scale=0.01, size=(400, 12))


@pytest.fixture
def fitted(frames):
    return Ppca.of(Sums.of(frames), 0.95)


def scikit_learns(frames, free):
    model = PCA(n_components=free, svd_solver="full").fit(frames)
    # It divides by N - 1, maximum likelihood by N.
    model.explained_variance_ *= (len(frames) - 1) / len(frames)
    model.noise_variance_ *= (len(frames) - 1) / len(frames)
    return model


def test_the_free_directions_hold_the_share_asked_for(frames, fitted):
    assert fitted.free == 3
    values = PCA(svd_solver="full").fit(frames).explained_variance_ratio_
    for share in (0.5, 0.9, 0.95, 0.999):
        model = Ppca.of(Sums.of(frames), share)
        assert values[: model.free].sum() >= share > values[: model.free - 1].sum()


def test_its_likelihood_is_that_of_scikit_learn(frames, fitted):
    new = frames[::3] + np.random.default_rng(1).normal(scale=0.02, size=frames[::3].shape)
    for rows in (frames, new):
        # Of a Gaussian: the log of its normalisation, and half the squared distance.
        logarithm = np.log(2 * np.pi * fitted.variances).sum()
        distance = len(fitted.mean) * fitted.distance(Sums.of(rows))
        expected = scikit_learns(frames, fitted.free).score(rows)
        assert -0.5 * (logarithm + distance) == pytest.approx(expected, rel=1e-9)


def test_its_reconstruction_is_that_of_scikit_learn(frames, fitted):
    model = scikit_learns(frames, fitted.free)
    expected = model.inverse_transform(model.transform(frames))
    axes = fitted.axes[:, : fitted.free]
    found = fitted.mean + (frames - fitted.mean) @ axes @ axes.T
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_frames_of_the_same_gaussian_are_at_distance_one(frames, fitted):
    assert fitted.distance(Sums.of(frames)) == pytest.approx(1.0, rel=1e-9)


def test_no_variance_is_below_the_floor(frames):
    still = np.tile(frames[:1], (50, 1))
    assert Ppca.of(Sums.of(still), 0.95, floor=0.003).variances.min() == 0.003**2
    assert Ppca.of(Sums.of(frames), 0.95, floor=10.0).variances.max() == 100.0


def test_sums_add_up_and_take_apart(frames):
    whole, first, rest = (Sums.of(part) for part in (frames, frames[:150], frames[150:]))
    for found, expected in ((first + rest, whole), (whole - first, rest)):
        assert found.count == expected.count
        np.testing.assert_allclose(found.first, expected.first)
        np.testing.assert_allclose(found.second, expected.second, atol=1e-9)


def test_components_are_counted():
    variances = np.array([8.0, 1.0, 0.5, 0.5, 0.0])
    assert [components_for(variances, share) for share in (0.5, 0.9, 0.95, 1.0)] == [1, 2, 3, 4]
    assert components_for(np.zeros(4), 0.95) == 1
