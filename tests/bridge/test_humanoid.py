"""The humanoid by what a body can and cannot do, on real captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.humanoid.body import measured
from bridge.humanoid.proportions import SETTLED
from bridge.humanoid.rotations import matrices
from bridge.humanoid.skeleton import BONES, PARENTS, ROW, Posture
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import Model, ModelInfo
from bridge.pose import Pose, Provenance
from drivers.c3d_file import read_c3d
from drivers.frame import Floats
from simulators.performer import load_performer
from tests.benchmarks.humanoid import Played, changes, least_bends, off, play, slides
from tests.bridge.humanoid_reference import Reference

MODEL = Model("default")
INFO = MODEL.info
AT = {label: row for row, label in enumerate(INFO.labels)}
WALKER = load_performer("walk")
TRUNK_AND_LIMBS = [
    *("Spine", "LeftUpperArm", "LeftLowerArm", "RightUpperArm", "RightLowerArm"),
    *("LeftUpperLeg", "LeftLowerLeg", "RightUpperLeg", "RightLowerLeg"),
]


def pose(xyz: Floats, index: int = 0) -> Pose:
    measured_all = np.full(len(xyz), Provenance.MEASURED, np.uint8)
    return Pose(index, index / 120, xyz, measured_all, np.full(len(xyz), 0.01, np.float32))


def solved(xyz: Floats, info: ModelInfo = INFO) -> list[Posture]:
    """The humanoids of poses (N, 41, 3)."""
    solver = HumanoidSolver(info)
    return [found for i, frame in enumerate(xyz) if (found := solver.solve(pose(frame, i)))]


def capture(path: Path) -> Floats:
    clip = read_c3d(path)
    return clip.xyz[:, [clip.layout.labels.index(label) for label in INFO.labels]]


def walk(count: int = 60) -> Floats:
    return np.array([WALKER.pose(i) for i in range(count)])


def turned(vector: tuple[float, float, float], posture: Posture, bone: str) -> np.ndarray:
    """Where a vector of the rest pose points now, in the axes of the hips."""
    rotations = matrices(posture.rotations.astype(float))
    return rotations[0].T @ rotations[ROW[bone]] @ vector


def test_joints_rotations_and_rest_pose_are_one_body() -> None:
    for found in solved(walk()):
        turns, local = (matrices(q.astype(float)) for q in (found.rotations, found.local))
        for row in range(1, len(BONES)):
            above = PARENTS[row]
            at = found.joints[above] + turns[above] @ found.rest[row]
            np.testing.assert_allclose(found.joints[row], at, atol=2e-5)
            np.testing.assert_allclose(turns[row], turns[above] @ local[row], atol=1e-5)
        np.testing.assert_allclose(turns[0], local[0], atol=1e-6)


def same_as_reference(poses: list[Pose]) -> None:
    solver, reference = HumanoidSolver(INFO), Reference(INFO.labels)
    for each in poses:
        found = solver.solve(each)
        assert found is not None
        joints, rotations, local = reference.solve(each)
        np.testing.assert_allclose(found.joints, joints, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.rotations, rotations, atol=1e-6)
        np.testing.assert_allclose(found.local, local, atol=1e-6)
        expected = reference.measuring.mean.values
        np.testing.assert_allclose(solver.proportions.values, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("name", "first"), [("02_03", 0), ("85_12", 2400)])
def test_what_is_compiled_is_what_plain_numpy_makes(data_dir, name: str, first: int) -> None:
    """A run and a breakdance; and the same lying down, far away."""
    xyz = capture(data_dir / "real" / f"{name}.c3d")[first : first + 150]
    xyz = xyz[~np.isnan(xyz).any(axis=(1, 2))]
    lying = xyz[:40, :, [0, 2, 1]] * np.float32([1, -1, 1]) + np.float32([1e4, -1e4, 0])
    same_as_reference([pose(each, i) for i, each in enumerate([*xyz, *lying])])


def test_a_pose_may_be_in_arrays_of_any_kind() -> None:
    usual = pose(WALKER.pose(0))
    strided = np.repeat(usual.xyz.astype(float), 2, axis=0)[::2]
    strided.flags.writeable = False
    other = replace(usual, xyz=strided, sigma=usual.sigma.astype(float))
    found, expected = (HumanoidSolver(INFO).solve(each) for each in (other, usual))
    assert found is not None
    assert expected is not None
    np.testing.assert_array_equal(found.joints, expected.joints)
    np.testing.assert_array_equal(found.sigma, expected.sigma)


def test_nonsense_too_is_what_plain_numpy_makes() -> None:
    random = np.random.default_rng(0)
    here = np.zeros((41, 3), np.float32)
    nonsense = [here, here + np.float32([1, -2, 0.5]), WALKER.pose(0) * 0]
    nonsense += [random.normal(scale=s, size=(41, 3)).astype(np.float32) for s in (0.01, 1, 1e4)]
    for each in nonsense:
        same_as_reference([pose(each, 0), pose(WALKER.pose(1), 1)])


def test_somebody_who_stands_with_arms_out_is_in_the_rest_pose(data_dir) -> None:
    xyz = capture(data_dir / "real" / "HDM_mm_01-02_03.c3d")[3613:3914]  # ends in a T
    found = solved(xyz)[-1]
    for bone, along in (
        ("LeftLowerArm", (-1, 0, 0)),
        ("RightLowerArm", (1, 0, 0)),
        ("LeftUpperLeg", (0, 0, -1)),
        ("RightLowerLeg", (0, 0, -1)),
        ("LeftFoot", (0, 1, 0)),
        ("Head", (1, 0, 0)),
        ("Chest", (0, 0, 1)),
        ("LeftHand", (0, 0, 1)),  # its back is up
        ("RightHand", (0, 0, 1)),
    ):
        assert turned(along, found, bone) @ along > np.cos(np.radians(30)), bone
    for side in ("Left", "Right"):
        assert found.joints[ROW[f"{side}Foot"], 2] == pytest.approx(0.09, abs=0.04)
    assert found.rest[0, 2] == pytest.approx(found.joints[0, 2], abs=0.04)


def test_a_raised_left_arm_is_the_left_arm_raised(data_dir) -> None:
    xyz = capture(data_dir / "real" / "85_12.c3d")[2486:2507]
    assert xyz[-1, AT["LFIN"], 2] > xyz[-1, AT["RFIN"], 2] + 1.0
    found = solved(xyz)[-1]
    hand, other = found.joints[ROW["LeftHand"]], found.joints[ROW["RightHand"]]
    assert hand[2] > other[2] + 0.8
    assert np.linalg.norm(hand - xyz[-1, AT["LWRA"]]) < 0.12


@settings(max_examples=10, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-3, 3), st.floats(-3, 3))
def test_where_in_the_world_somebody_is_changes_nothing_else(yaw, x, y) -> None:
    xyz = walk(5)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    moved = (xyz @ turn.T + [x, y, 0]).astype(np.float32)
    for here, there in zip(solved(xyz), solved(moved), strict=True):
        np.testing.assert_allclose(there.joints, here.joints @ turn.T + [x, y, 0], atol=1e-4)
        np.testing.assert_allclose(there.local[1:], here.local[1:], atol=1e-4)


def test_a_mirrored_body_has_the_mirrored_posture() -> None:
    xyz = walk(20)
    other = {"L": "R", "R": "L"}
    across = [AT.get(other.get(label[0], "?") + label[1:], AT[label]) for label in INFO.labels]
    mirrored = xyz[:, across] * np.float32([-1, 1, 1])
    sides = [
        ROW[bone.replace("Left", "?").replace("Right", "Left").replace("?", "Right")]
        for bone in BONES
    ]
    for here, there in zip(solved(xyz), solved(mirrored), strict=True):
        np.testing.assert_allclose(there.joints[sides], here.joints * [-1, 1, 1], atol=1e-4)
        as_seen = here.local * [1, -1, -1, 1]
        alike = np.abs((there.local[sides] * as_seen).sum(axis=1))
        np.testing.assert_allclose(alike, 1.0, atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0, 3))
def test_whatever_the_markers_are_it_stays_a_body(seed: int, spread: float) -> None:
    """Nonsense, too: no NaN, bones of constant length, knees that bend their way."""
    random = np.random.default_rng(seed)
    solver = HumanoidSolver(INFO)
    for index in range(3):
        noise = random.normal(scale=spread, size=(41, 3))
        found = solver.solve(pose((WALKER.pose(index) + noise).astype(np.float32), index))
        assert found is not None
        for values in (found.joints, found.rotations, found.local, found.rest, found.sigma):
            assert np.isfinite(values).all()
        np.testing.assert_allclose(np.linalg.norm(found.local, axis=1), 1.0, atol=1e-5)
        lengths = np.linalg.norm(found.joints[1:] - found.joints[PARENTS[1:]], axis=1)
        np.testing.assert_allclose(lengths, np.linalg.norm(found.rest[1:], axis=1), atol=1e-4)
        for knee in ("LeftLowerLeg", "RightLowerLeg"):
            x, y, z, _ = found.local[ROW[knee]]
            assert x < 0  # a hinge, that bends the shank backwards
            assert np.hypot(y, z) < 1e-3


def test_markers_all_in_one_place_are_survived() -> None:
    found = HumanoidSolver(INFO).solve(pose(np.zeros((41, 3), np.float32)))
    assert found is not None
    assert np.isfinite(found.joints).all()
    np.testing.assert_allclose(np.linalg.norm(found.local, axis=1), 1.0, atol=1e-5)


def test_without_all_markers_there_is_no_humanoid() -> None:
    solver = HumanoidSolver(INFO)
    for nowhere in (np.nan, np.inf):
        xyz = WALKER.pose(0).copy()
        xyz[3] = nowhere
        assert solver.solve(pose(xyz)) is None
    assert solver.solve(pose(WALKER.pose(0))) is not None


def test_sigma_is_that_of_the_markers_that_tell_a_bone() -> None:
    each = pose(WALKER.pose(0))
    sigma = np.full(41, 0.01, np.float32)
    sigma[AT["LELB"]] = np.inf
    found = HumanoidSolver(INFO).solve(replace(each, sigma=sigma))
    assert found is not None
    unsure = {bone for bone, value in zip(BONES, found.sigma, strict=True) if np.isinf(value)}
    assert unsure == {"LeftUpperArm", "LeftLowerArm"}
    np.testing.assert_allclose(found.sigma[ROW["Head"]], 0.01, rtol=1e-5)


def test_proportions_settle_in_a_second() -> None:
    solver = HumanoidSolver(INFO)
    rests = []
    for index in range(SETTLED + 600):
        found = solver.solve(pose(WALKER.pose(index), index))
        assert found is not None
        rests.append(found.rest)
    lengths = np.linalg.norm(rests, axis=2)
    assert np.ptp(lengths[SETTLED:], axis=0).max() < 0.003
    true = measured(INFO.labels, np.array([WALKER.pose(i) for i in range(120)]))
    np.testing.assert_allclose(solver.proportions.limbs, true.limbs, atol=0.015)


def test_a_pose_that_is_lost_tells_nothing_of_proportions() -> None:
    solver = HumanoidSolver(INFO)
    for index in range(SETTLED):
        solver.solve(pose(WALKER.pose(index), index))
    before = solver.proportions.values.copy()
    gone = replace(pose(WALKER.pose(0) * 2), provenance=np.full(41, Provenance.LOST, np.uint8))
    for _ in range(100):
        solver.solve(gone)
    np.testing.assert_array_equal(solver.proportions.values, before)


def test_a_calibrated_model_knows_the_proportions_from_the_first_pose_on(data_dir) -> None:
    xyz = capture(data_dir / "real" / "02_01.c3d")
    known = measured(INFO.labels, xyz[::10])
    info = replace(INFO, proportions=known.values.tolist())
    assert ModelInfo.from_json(info.to_json()) == info
    lengths = [np.linalg.norm(found.rest, axis=1) for found in solved(xyz[:200], info)]
    assert np.ptp(lengths, axis=0).max() == 0.0
    np.testing.assert_allclose(lengths[0][ROW["LeftFoot"]], known.limbs[1, 1], rtol=1e-6)


@pytest.fixture(scope="module", params=["02_02", "02_03"])
def played(request: pytest.FixtureRequest, data_dir: Path) -> Played:
    """A walk and a run of the test split, estimated."""
    return play(MODEL, data_dir / "real" / f"{request.param}.c3d")


def test_bones_point_where_those_of_the_true_markers_do(played: Played) -> None:
    direction, _ = off(played)
    medians = dict(zip(BONES, np.median(direction, axis=0), strict=True))
    assert max(medians[bone] for bone in TRUNK_AND_LIMBS) < 10.0


def test_feet_slide_no_more_than_their_markers(played: Played) -> None:
    markers, humanoid = slides(played, INFO.labels, 120.0)
    assert humanoid < markers


def test_bones_keep_their_lengths_and_no_joint_bends_backwards(played: Played) -> None:
    assert changes(played, 120.0) < 0.01
    assert min(least_bends(played).values()) > 0.0


def test_a_hidden_marker_makes_no_bone_jump(data_dir) -> None:
    path = data_dir / "real" / "02_02.c3d"

    def fastest(gaps: str | None) -> np.ndarray:
        turns = np.array([posture.rotations for posture in play(MODEL, path, gaps).estimated])
        alike = np.abs((turns[1:] * turns[:-1]).sum(axis=2))
        return np.degrees(2 * np.arccos(np.clip(alike, 0, 1))).max(axis=0)

    # Degrees from one frame to the next: with a fifth of all samples missing, beside none.
    limbs = [ROW[bone] for bone in ("Hips", *TRUNK_AND_LIMBS)]
    assert (fastest("20%:10-60")[limbs] < fastest(None)[limbs] + 6.0).all()
