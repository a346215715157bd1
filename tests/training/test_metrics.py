import numpy as np
import pytest

from training.metrics import frame_rms, jerk, rms, roughness


def still(frames, markers=2):
    return np.zeros((frames, markers, 3), np.float32)


def test_frame_rms_is_the_root_of_the_mean_square_over_markers():
    estimate = still(2)
    estimate[0, 0] = (0.003, 0.004, 0.0)  # 5 mm off, the other marker 0
    estimate[1, :, 2] = 0.010
    assert frame_rms(estimate, still(2)) == pytest.approx([5 / np.sqrt(2), 10.0])
    assert rms(estimate, still(2)) == pytest.approx((5 / np.sqrt(2) + 10.0) / 2)


def test_missing_truth_is_left_out():
    truth, estimate = still(3), still(3)
    estimate[:, 0, 0] = 0.001
    estimate[:, 1, 0] = 0.003
    truth[0, 1] = np.nan
    truth[1] = np.nan
    assert frame_rms(estimate, truth) == pytest.approx([1.0, np.nan, np.sqrt(5)], nan_ok=True)
    assert rms(estimate, truth) == pytest.approx((1 + np.sqrt(5)) / 2)


def test_jerk_is_the_mean_norm_of_the_velocity_error_per_120th_of_a_second():
    truth = still(3)
    truth[:, 0, 0] = (0.0, 0.010, 0.020)
    estimate = still(3)
    estimate[:, 0] = [(0.5, 0, 0), (0.513, 0.004, 0), (0.523, 0.004, 0)]  # off by (3, 4), then 0
    assert jerk(estimate, truth, 120.0) == pytest.approx(5 / 4, rel=1e-4)
    assert jerk(estimate, truth, 60.0) == pytest.approx(5 / 8, rel=1e-4)


def test_jerk_needs_both_samples():
    truth, estimate = still(4, 1), still(4, 1)
    estimate[:, 0, 0] = (0.0, 0.001, 0.003, 0.006)
    truth[1] = np.nan
    assert jerk(estimate, truth, 120.0) == pytest.approx(3.0)


def test_roughness_is_the_ratio_of_third_differences():
    cubic = np.arange(6.0) ** 3 / 1000  # third difference 6 mm
    truth, estimate = still(6, 1), still(6, 1)
    truth[:, 0, 0] = cubic
    estimate[:, 0, 1] = 1.5 * cubic
    assert roughness(estimate, truth) == pytest.approx(1.5, rel=1e-4)


def test_nothing_to_score_is_none():
    nothing = np.full((5, 2, 3), np.nan, np.float32)
    assert rms(still(5), nothing) is None
    assert jerk(still(5), nothing, 120.0) is None
    assert roughness(still(5), nothing) is None
    assert jerk(still(1), still(1), 120.0) is None
    assert roughness(still(5), still(5)) is None  # a truth at rest
