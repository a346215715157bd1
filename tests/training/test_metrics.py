import numpy as np
import pytest

from training.metrics import (
    frame_rms,
    mean_known,
    rms,
    roughness,
    row_mean,
    transitions,
    velocity_error,
)


def jerk(estimate, truth, rate):
    return mean_known(velocity_error(estimate, truth, rate))


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


def test_velocity_errors_are_those_of_each_marker_since_the_frame_before():
    truth, estimate = still(3), still(3)
    truth[:, 0, 2] = (0.0, 0.010, 0.030)
    estimate[:, 1, 0] = (0.0, 0.003, 0.003)
    truth[2, 1] = np.nan
    expected = [[np.nan, np.nan], [10.0, 3.0], [20.0, np.nan]]
    assert velocity_error(estimate, truth, 120.0) == pytest.approx(
        np.array(expected), rel=1e-5, nan_ok=True
    )
    assert np.isnan(velocity_error(still(1), still(1), 120.0)).all()


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


def test_the_mean_of_a_row_leaves_out_what_is_not_known():
    rows = np.array([[1.0, np.nan, 4.0], [np.nan] * 3, [2.0, 2.0, 2.0]])
    assert row_mean(rows) == pytest.approx([2.5, np.nan, 2.0], nan_ok=True)


def test_transitions_are_changes_of_leaf_and_the_window_after_them():
    leaves = np.array([4, 4, 4, 7, 7, 7, 7, 7, 2, 7, 7, 7, 7])
    for window, frames in (
        (0, [3, 8, 9]),
        (1, [3, 4, 8, 9, 10]),
        (3, [3, 4, 5, 6, 8, 9, 10, 11, 12]),
        (50, [3, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
    ):
        assert np.flatnonzero(transitions(leaves, window)).tolist() == frames
    assert not transitions(np.array([3, 3, 3]), 2).any()
    assert transitions(np.array([3]), 2).tolist() == [False]
