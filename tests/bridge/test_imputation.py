from __future__ import annotations

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.imputation import ConditionalGaussian
from bridge.model import Model
from drivers.frame import Floats, Layout, MarkerFrame

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


class AtTheNeck:
    """Puts every missing marker into the origin, C7."""

    def reset(self) -> None:
        self.calls = 0

    def fill(self, xyz: Floats, present: np.ndarray, interval: float) -> Floats:
        assert interval == pytest.approx(1 / 120)
        self.calls += 1
        return np.where(present[:, None], xyz, np.float32(0))


def test_the_estimator_uses_the_imputation_it_is_given() -> None:
    """It is asked once a frame, and in place of what the bridge does."""
    model = Model("default")
    info = model.info
    layout = Layout(info.tracked, 120.0)
    ankle = info.tracked.index("LANK")
    frames = random.normal(size=(30, len(info.tracked), 3)).astype(np.float32) * 0.05
    frames[:, info.tracked.index("LSHO"), 0] -= 0.2
    frames[10:, ankle] = np.nan

    def poses(estimator: PoseEstimator) -> Floats:
        steps = (MarkerFrame(n, n / 120, n / 120, layout, xyz) for n, xyz in enumerate(frames))
        return np.array([estimator.step(frame).xyz for frame in steps])

    own = AtTheNeck()
    at_the_neck = poses(PoseEstimator(model, imputation=own))
    assert own.calls == len(frames)
    c7, row = (info.labels.index(label) for label in ("C7", "LANK"))
    np.testing.assert_allclose(at_the_neck[10:, row], at_the_neck[10:, c7], atol=1e-6)
    bridge = poses(PoseEstimator(model))
    np.testing.assert_array_equal(bridge[:10], at_the_neck[:10])
    assert (bridge[10:] != at_the_neck[10:]).any()
