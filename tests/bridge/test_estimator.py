from __future__ import annotations

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose, Provenance
from drivers.c3d_file import read_c3d
from drivers.frame import Layout, MarkerFrame

MODEL = Model("default")
TRACKED = MODEL.info.tracked
AT = [MODEL.info.labels.index(label) for label in TRACKED]


def steps(xyz: np.ndarray, layout: Layout | None = None) -> list[Pose]:
    layout = layout or Layout(TRACKED, 120.0)
    estimator = PoseEstimator(MODEL)
    return [
        estimator.step(MarkerFrame(i, i / 120, i / 120, layout, frame))
        for i, frame in enumerate(xyz)
    ]


@pytest.fixture(scope="module")
def walk(data_dir) -> np.ndarray:
    return read_c3d(data_dir / "real/16_57.c3d", TRACKED).xyz


def test_measured_markers_go_out_to_the_last_bit(walk) -> None:
    for pose, frame in zip(steps(walk), walk, strict=True):
        np.testing.assert_array_equal(pose.xyz[AT], frame)
        assert (pose.provenance[AT] == Provenance.MEASURED).all()
        assert (np.delete(pose.provenance, AT) == Provenance.ESTIMATED).all()
        assert pose.xyz.dtype == pose.sigma.dtype == np.float32


def test_markers_are_found_by_label_and_others_are_ignored(walk, data_dir) -> None:
    everything = read_c3d(data_dir / "real/16_57.c3d")
    order = np.random.default_rng(1).permutation(41)
    shuffled = Layout(tuple(everything.layout.labels[i] for i in order), 120.0)
    for one, two in zip(steps(walk), steps(everything.xyz[:, order], shuffled), strict=True):
        np.testing.assert_array_equal(one.xyz, two.xyz)


def test_a_missing_marker_is_imputed_and_says_so_with_a_larger_sigma(walk) -> None:
    holed = walk.copy()
    holed[40:80, TRACKED.index("RTOE")] = np.nan
    whole, poses = steps(walk), steps(holed)
    toe = MODEL.info.labels.index("RTOE")
    for i, pose in enumerate(poses):
        assert pose.provenance[toe] == (Provenance.IMPUTED if 40 <= i < 80 else Provenance.MEASURED)
        assert np.isfinite(pose.xyz).all()
    assert (poses[60].sigma >= whole[60].sigma).all()
    assert poses[60].sigma[toe] > 0.02 > whole[60].sigma[toe]
    error = [np.linalg.norm(p.xyz[toe] - q.xyz[toe]) for p, q in zip(poses, whole, strict=True)]
    assert max(error[40:80]) < 0.8
    assert max(error[:40] + error[80:]) == 0.0


@pytest.mark.parametrize("label", TRACKED)
def test_any_tracked_marker_may_be_missing_from_the_first_frame(walk, label: str) -> None:
    holed = walk.copy()
    holed[:, TRACKED.index(label)] = np.nan
    for pose, truth in zip(steps(holed), steps(walk), strict=True):
        assert np.isfinite(pose.xyz).all()
        rms = 1000 * np.sqrt(((pose.xyz - truth.xyz) ** 2).sum(axis=1).mean())
        assert rms < 400  # a body, at the right place


def test_with_no_marker_the_last_pose_holds_and_is_lost(walk) -> None:
    holed = walk.copy()
    holed[50:60] = np.nan
    poses = steps(holed)
    for pose in poses[50:60]:
        np.testing.assert_array_equal(pose.xyz, poses[49].xyz)
        assert (pose.provenance == Provenance.LOST).all()
        assert np.isinf(pose.sigma).all()
    assert (poses[60].provenance != Provenance.LOST).all()


def test_before_any_marker_there_is_no_pose() -> None:
    (pose,) = steps(np.full((1, len(TRACKED), 3), np.nan, np.float32))
    assert np.isnan(pose.xyz).all()
    assert (pose.provenance == Provenance.LOST).all()


def test_standing_elsewhere_and_facing_elsewhere_changes_nothing(walk) -> None:
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    shift = np.array([4, -3, 0.5], np.float32)
    for one, two in zip(steps(walk), steps(walk @ turn.T + shift), strict=True):
        np.testing.assert_allclose(one.xyz @ turn.T + shift, two.xyz, atol=1e-3)


def test_the_history_is_a_time_not_a_number_of_frames(walk) -> None:
    estimator = PoseEstimator(MODEL)
    for rate, rows in ((120.0, 1.0), (60.0, 0.5), (240.0, 2.0)):
        estimator.step(MarkerFrame(0, 0.0, 0.0, Layout(TRACKED, rate), walk[0]))
        assert len(estimator._history) == round(rows * MODEL.info.history)


def test_reset_forgets_the_performer(walk) -> None:
    estimator = PoseEstimator(MODEL)
    frames = [MarkerFrame(i, 0.0, 0.0, Layout(TRACKED, 120.0), xyz) for i, xyz in enumerate(walk)]
    first = [estimator.step(frame).xyz for frame in frames[:50]]
    estimator.reset()
    for one, two in zip(first, [estimator.step(frame).xyz for frame in frames[:50]], strict=True):
        np.testing.assert_array_equal(one, two)
