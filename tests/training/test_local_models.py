import numpy as np
import pytest

from training.local_models import NormalEquations, affine, least_squares, ridge, shrunk


@pytest.fixture
def frames():
    random = np.random.default_rng(0)
    x = random.normal(size=(500, 6))
    z = x @ random.normal(size=(6, 4)) + 2.0 + random.normal(scale=0.1, size=(500, 4))
    return x, z


def test_plain_map_is_least_squares(frames):
    x, z = frames
    expected = np.linalg.lstsq(x, z)[0].T
    np.testing.assert_allclose(least_squares(NormalEquations.of(x, z)), expected, atol=1e-9)


def test_plain_map_is_the_formula_of_the_paper(frames):
    x, z = (part.T for part in frames)
    expected = z @ x.T @ np.linalg.inv(x @ x.T)
    np.testing.assert_allclose(least_squares(NormalEquations.of(x.T, z.T)), expected, atol=1e-9)


def test_affine_map_without_ridge_is_least_squares_with_a_constant(frames):
    x, z = frames
    expected = np.linalg.lstsq(np.hstack([x, np.ones((500, 1))]), z)[0].T
    np.testing.assert_allclose(ridge(NormalEquations.of(affine(x), z), 0.0), expected, atol=1e-9)


def test_ridge_is_least_squares_on_noisy_inputs(frames):
    """The penalty is what adding that much noise to x does, on average."""
    x, z = frames
    random = np.random.default_rng(1)
    many = np.tile(x, (400, 1))
    noisy = many + random.normal(scale=0.5, size=many.shape)
    expected = np.linalg.lstsq(affine(noisy), np.tile(z, (400, 1)))[0].T
    np.testing.assert_allclose(ridge(NormalEquations.of(affine(x), z), 0.5), expected, atol=0.02)


def test_moments_add_up(frames):
    x, z = frames
    whole = NormalEquations.of(x, z)
    parts = NormalEquations.of(x[:200], z[:200]) + NormalEquations.of(x[200:], z[200:])
    np.testing.assert_allclose(parts.xx, whole.xx)
    np.testing.assert_allclose(parts.zx, whole.zx)
    assert parts.weight == whole.weight == 500


def test_a_leaf_follows_the_global_map_where_it_has_seen_nothing(frames):
    x, z = frames
    everything = NormalEquations.of(affine(x), z)
    still = np.tile(x[:1], (50, 1))  # a leaf that never moves
    leaf = NormalEquations.of(affine(still), np.tile(z[:1] + 1.0, (50, 1)))
    found = shrunk(leaf, everything, share=1e-4, noise=0.0)
    overall = ridge(everything, 0.0)
    np.testing.assert_allclose(affine(still[:1]) @ found.T, z[:1] + 1.0, atol=1e-2)
    # Along a direction at right angles to all it has seen, the slope is the global one.
    across = np.linalg.svd(np.vstack([affine(still[:1])]))[2][-1, :-1]
    across -= still[0] * (across @ still[0]) / (still[0] @ still[0])
    np.testing.assert_allclose(found[:, :-1] @ across, overall[:, :-1] @ across, atol=0.1)


def test_shrinking_fades_with_its_share(frames):
    x, z = frames
    everything = NormalEquations.of(affine(x), z)
    own = NormalEquations.of(affine(x[:100]), -z[:100])
    alone, overall = ridge(own, 0.0), ridge(everything, 0.0)
    apart = [
        np.linalg.norm(shrunk(own, everything, share, 0.0) - overall) for share in (0.01, 1.0, 100)
    ]
    assert apart[0] > apart[1] > apart[2]
    np.testing.assert_allclose(shrunk(own, everything, 1e-9, 0.0), alone, atol=1e-6)
