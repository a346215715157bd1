from __future__ import annotations

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.imputation import FADE, ConditionalGaussian, Imputer
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


def moving(frames: int) -> np.ndarray:
    """Markers that stand away from their mean and drift slowly, (frames, COUNT, 3)."""
    start = random.normal(size=(COUNT, 3))
    return (start + np.linspace(0, 0.1, frames)[:, None, None]).astype(np.float32)


@pytest.mark.parametrize("missing", [[0], [1, 3]])
def test_a_marker_that_goes_missing_does_not_jump(missing: list[int]) -> None:
    xyz, present = moving(60), np.ones(COUNT, bool)
    imputer = Imputer(ConditionalGaussian(MEAN, COVARIANCE))
    filled = []
    for frame, markers in enumerate(xyz):
        now = present.copy()
        now[missing] = not 20 <= frame < 50
        filled.append(imputer.fill(np.where(now[:, None], markers, np.nan), now, 1 / 120))
    path = np.array(filled)
    jump = np.linalg.norm(path[20, missing] - path[19, missing], axis=1)
    bare = ConditionalGaussian(MEAN, COVARIANCE).fill(
        np.where(now[:, None], xyz[20], np.nan), np.isin(range(COUNT), missing, invert=True)
    )
    far = np.linalg.norm(bare[missing] - xyz[19, missing], axis=1)
    assert (jump < 0.1 * far).all()
    np.testing.assert_array_equal(path[:20], xyz[:20])
    np.testing.assert_array_equal(path[50:], xyz[50:])


def test_in_time_it_is_the_conditional_mean() -> None:
    gaussian = ConditionalGaussian(MEAN, COVARIANCE)
    imputer, present = Imputer(gaussian), np.ones(COUNT, bool)
    markers = moving(1)[0]
    imputer.fill(markers, present, 1 / 120)
    present[2] = False
    mean = gaussian.fill(markers, present)[2]
    for frame in range(round(8 * FADE * 120)):
        filled = imputer.fill(markers, present, 1 / 120)[2]
        away = np.linalg.norm(filled - mean) / np.linalg.norm(markers[2] - mean)
        assert away == pytest.approx(np.exp(-(frame + 1) / 120 / FADE), rel=1e-3, abs=1e-4)
    assert away < 1e-3


def test_other_markers_dropping_in_and_out_do_not_make_it_drift() -> None:
    """A marker long missing comes to its conditional mean whatever the others do."""
    gaussian = ConditionalGaussian(MEAN, COVARIANCE)
    imputer, markers = Imputer(gaussian), moving(1)[0]
    imputer.fill(markers, np.ones(COUNT, bool), 1 / 120)
    for _ in range(2000):
        present = random.random(COUNT) > 0.05
        present[1] = False
        filled = imputer.fill(markers, present, 1 / 120)
        mean = gaussian.fill(filled, present)
    assert np.linalg.norm(filled[1] - mean[1]) < 0.1 * np.linalg.norm(markers[1] - mean[1])


class AtTheNeck:
    """Puts every missing marker into the origin, C7."""

    def reset(self) -> None:
        self.calls = 0

    def fill(self, xyz: Floats, present: np.ndarray, interval: float) -> Floats:
        assert interval == pytest.approx(1 / 120)
        self.calls += 1
        return np.where(present[:, None], xyz, np.float32(0))


def test_the_estimator_uses_the_imputation_it_is_given() -> None:
    """One's own is asked once a frame; the bridge's own, given, changes no bit of a pose."""
    model = Model("default")
    info = model.info
    layout = Layout(info.tracked, 120.0)
    c7, toe = info.tracked.index("C7"), info.tracked.index("RTOE")
    frames = random.normal(size=(30, len(info.tracked), 3)).astype(np.float32) * 0.05
    frames[:, info.tracked.index("LSHO"), 0] -= 0.2
    frames[10:, toe] = np.nan

    def poses(estimator: PoseEstimator) -> Floats:
        steps = (MarkerFrame(n, n / 120, n / 120, layout, xyz) for n, xyz in enumerate(frames))
        return np.array([estimator.step(frame).xyz for frame in steps])

    own = AtTheNeck()
    at_the_neck = poses(PoseEstimator(model, imputation=own))
    assert own.calls == len(frames)
    np.testing.assert_allclose(
        at_the_neck[10:, info.labels.index("RTOE")], frames[10:, c7], atol=1e-6
    )
    gaussian = ConditionalGaussian(info.mean, info.covariance)
    given = poses(PoseEstimator(model, imputation=Imputer(gaussian)))
    np.testing.assert_array_equal(given, poses(PoseEstimator(model)))
    assert (given[10:] != at_the_neck[10:]).any()
