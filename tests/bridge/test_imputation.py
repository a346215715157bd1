from __future__ import annotations

import numpy as np
import pytest

from bridge.imputation import ConditionalGaussian

random = np.random.default_rng(5)
COUNT = 4
MIX = random.normal(size=(3 * COUNT, 3 * COUNT)) * 0.1
MEAN = random.normal(size=(COUNT, 3))
COVARIANCE = MIX @ MIX.T


def test_nothing_missing_is_nothing_changed() -> None:
    xyz = random.normal(size=(COUNT, 3)).astype(np.float32)
    assert ConditionalGaussian(MEAN, COVARIANCE).fill(xyz, np.ones(COUNT, bool)) is xyz


@pytest.mark.parametrize("missing", [[0], [2], [1, 3], [0, 1, 2]])
def test_the_fill_is_the_regression_on_what_is_there(missing: list[int]) -> None:
    """Against least squares on a large sample of the same Gaussian: no formula shared."""
    sample = MEAN.ravel() + random.normal(size=(200_000, 3 * COUNT)) @ MIX.T
    present = np.ones(COUNT, bool)
    present[missing] = False
    known = np.repeat(present, 3)
    with_one = np.column_stack([sample[:, known], np.ones(len(sample))])
    coefficients, *_ = np.linalg.lstsq(with_one, sample[:, ~known], rcond=None)
    residual = sample[:, ~known] - with_one @ coefficients
    gaussian = ConditionalGaussian(MEAN, COVARIANCE)
    case = sample[7].reshape(-1, 3).astype(np.float32)
    case[missing] = np.nan
    filled = gaussian.fill(case, present)
    np.testing.assert_allclose(filled.ravel()[~known], with_one[7] @ coefficients, atol=0.02)
    np.testing.assert_array_equal(filled[present], case[present])
    covariance = gaussian.uncertainty(present)
    np.testing.assert_allclose(
        covariance[np.ix_(~known, ~known)], residual.T @ residual / len(sample), atol=0.003
    )
    assert not covariance[known].any()


def test_with_nothing_there_it_is_the_mean() -> None:
    gaussian = ConditionalGaussian(MEAN, COVARIANCE)
    filled = gaussian.fill(np.full((COUNT, 3), np.nan, np.float32), np.zeros(COUNT, bool))
    np.testing.assert_allclose(filled, MEAN, atol=1e-6)
