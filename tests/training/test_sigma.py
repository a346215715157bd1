import numpy as np
import pytest
from scipy import stats

from drivers.marker_set import MARKERS
from training.network import Network
from training.networks import (
    FADES,
    POSE,
    Missing,
    Networks,
    PoseNetwork,
    RecallNetwork,
    VelocityNetwork,
)
from training.sigma import EDGES, FEWEST, counted, sigma_factors

COUNT = 40_000


def errors(random, law, count=COUNT):
    """(count, 1, 3): of one marker."""
    return law.rvs((count, 1, 3), random_state=random)


def share(error, sigma):
    return (np.abs(error) < sigma).mean()


@pytest.mark.parametrize("true", [0.5, 1.0, 2.2])
def test_of_gaussian_errors_the_factor_is_their_deviation(true):
    random = np.random.default_rng(0)
    sigma = random.uniform(0.005, 0.05, (COUNT, 1))
    error = errors(random, stats.norm(scale=true)) * sigma[..., None]
    assert sigma_factors([counted(error, sigma)]) == pytest.approx([true], rel=0.03)


@pytest.mark.parametrize("law", [stats.t(5), stats.laplace(), stats.uniform(-1, 2)])
def test_of_other_errors_as_many_are_within_it_as_of_gaussian_ones(law):
    random = np.random.default_rng(0)
    error = errors(random, law)
    (factor,) = sigma_factors([counted(error, np.ones((COUNT, 1)))])
    assert factor == pytest.approx(law.ppf(0.5 + 0.6827 / 2), rel=0.03)


def test_captures_count_alike_however_long():
    random = np.random.default_rng(0)
    short, long = random.normal(size=(2000, 1, 3)), 3 * random.normal(size=(COUNT, 1, 3))
    counts = [counted(error, np.ones((len(error), 1))) for error in (short, long)]
    (factor,) = sigma_factors(counts)
    both = np.mean([share(short, factor), share(long, factor)])
    assert both == pytest.approx(0.6827, abs=0.01)


def test_of_errors_with_heavy_tails_both_shares_are_near():
    error = errors(np.random.default_rng(0), stats.t(5))
    (factor,) = sigma_factors([counted(error, np.ones((COUNT, 1)))])
    assert share(error, factor) == pytest.approx(0.68, abs=0.05)
    assert share(error, 2 * factor) == pytest.approx(0.95, abs=0.05)


def test_each_marker_has_its_own_and_sequences_count_together():
    random = np.random.default_rng(0)
    true = np.array([0.7, 1.0, 3.0])
    error = random.normal(size=(COUNT, 3, 3)) * true[:, None]
    sigma = np.ones((COUNT, 3))
    parts = [counted(error[at : at + 5000], sigma[at : at + 5000]) for at in range(0, COUNT, 5000)]
    np.testing.assert_array_equal(np.sum(parts, axis=0), counted(error, sigma))
    np.testing.assert_allclose(sigma_factors(parts), true, rtol=0.03)


def test_where_too_little_is_known_sigma_stays():
    random = np.random.default_rng(0)
    error = 5 * random.normal(size=(FEWEST, 2, 3))
    error[FEWEST // 3 - 1 :, 0] = np.nan  # under FEWEST coordinates are left
    factors = sigma_factors([counted(error, np.ones((FEWEST, 2)))])
    assert factors[0] == 1.0
    assert factors[1] == pytest.approx(5.0, rel=0.2)


def test_errors_are_counted_by_how_often_sigma_they_are():
    width = EDGES[1]
    error = np.array([[0.5 * width, -1.5 * width, np.nan], [1e3, -1e3, 0.0]])[:, None]
    counts = counted(error, np.ones((2, 1)))
    assert counts.shape == (1, len(EDGES) - 1)
    assert counts[0, :2].tolist() == [2, 1]
    assert counts[0, -1] == 2  # all that is beyond
    assert counts.sum() == 5
    # Half the error in half the sigma is as much.
    np.testing.assert_array_equal(counts, counted(error / 2, np.full((2, 1), 0.5)))


def test_a_sigma_of_zero_is_always_too_small():
    error = np.array([[[0.1, -0.1, 0.0]]])
    counts = counted(error, np.zeros((1, 1)))
    assert counts.sum() == counts[0, -1] == 2  # nothing can be said of no error


def test_networks_take_the_factors_and_say_the_same():
    random = np.random.default_rng(0)
    markers, told = 4, 16 * 4 + 4
    mean = np.zeros(3 * markers, np.float32)

    def prior(*shape):
        return random.normal(size=shape).astype(np.float32)

    def network(*sizes):
        return Network.random(sizes, random)

    networks = Networks(
        PoseNetwork(mean, prior(13, POSE), network(12, 5, POSE + len(MARKERS))),
        VelocityNetwork(mean, prior(12, POSE), network(24, 6, POSE)),
        RecallNetwork(mean, prior(len(FADES) * (told + 1), 12), network(told, 7, 12 + markers)),
    )
    factors = random.uniform(0.5, 2.0, len(MARKERS))
    lacking = random.uniform(0.5, 2.0, markers)
    changed = networks.with_sigma(factors, lacking)
    assert changed.velocity is networks.velocity
    tracked = prior(6, markers, 3)
    age, ones = np.full(6, 0.2, np.float32), np.ones((6, markers), np.float32)
    missing = Missing(tracked, ones, tracked + 0.1, tracked, tracked, age)
    for (found, sigma), (same, scaled), factor in (
        (networks.pose.estimate(tracked), changed.pose.estimate(tracked), factors),
        (networks.recall.estimate(missing), changed.recall.estimate(missing), lacking),
    ):
        np.testing.assert_array_equal(same, found)
        np.testing.assert_allclose(scaled, sigma * factor, rtol=1e-5)
