"""How near the humanoid of an estimated pose is to that of the true 41 markers.

    python -m tests.benchmarks.humanoid [--split test] [--gaps]

Per bone: how far its direction is off, and how far it is turned about it (twist), degrees. Per
capture: how far feet that stand slide, beside the markers of the same estimated feet; how much the
longest-changing bone changes after the first second; the least bend of knees and elbows.
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bridge.estimator import PoseEstimator
from bridge.humanoid.rotations import matrices
from bridge.humanoid.skeleton import BONES, PARENTS, ROW, Posture
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import Model
from bridge.pose import Pose
from drivers.c3d_file import read_c3d
from drivers.frame import Floats, MarkerFrame
from simulators.corruption import Corruption, Faults, parse_gaps
from tests.bridge.humanoid_reference import carried

STANDS = 0.25  # m/s: an ankle that is slower, and
LOW = 0.03  # m: no higher over its lowest, belongs to a foot that stands
FIRST = 1.0  # s, in which the proportions are measured


def along(bone: str) -> tuple[float, float, float]:
    """Where a bone points in the rest pose."""
    if bone.endswith("Leg"):
        return (0, 0, -1)
    if bone.endswith("Foot"):
        return (0, 1, 0)
    if bone.startswith(("Left", "Right")):
        return (-1 if bone.startswith("Left") else 1, 0, 0)
    return (0, 0, 1)


ALONG = np.array([along(bone) for bone in BONES], float)


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """A capture: its true markers (N, 41, 3), the estimated poses, and the humanoids of both in the
    frames (n,) where both are known.
    """

    truth: Floats
    poses: list[Pose]
    estimated: list[Posture]
    true: list[Posture]
    frames: list[int]

    def joints(self, which: list[Posture]) -> Floats:
        return np.array([posture.joints for posture in which])

    def rotations(self, which: list[Posture]) -> np.ndarray:
        return matrices(np.array([posture.rotations for posture in which], float))


def play(model: Model, path: Path, gaps: str | None = None) -> Played:
    """Estimates a capture frame by frame, as `run` does."""
    info, clip = model.info, read_c3d(path)
    rows = [clip.layout.labels.index(label) for label in info.labels]
    layout = replace(clip.layout, labels=info.labels)
    truth = clip.xyz[:, rows]
    seen = truth.copy()
    if gaps:
        corruption = Corruption(Faults(gaps=parse_gaps(gaps)), truth.shape[1])
        seen = np.array([corruption.apply(frame) for frame in truth])
    estimator = PoseEstimator(model)
    solve, solve_true = HumanoidSolver(info), HumanoidSolver(info)
    poses, estimated, true, frames = [], [], [], []
    for index, (frame, given) in enumerate(zip(truth, seen, strict=True)):
        t = index / layout.rate
        pose = estimator.step(MarkerFrame(index, t, t, layout, given))
        poses.append(pose)
        of_pose, of_truth = solve.solve(pose), solve_true.solve(replace(pose, xyz=frame))
        if of_pose and of_truth:
            estimated.append(of_pose)
            true.append(of_truth)
            frames.append(index)
    return Played(truth, poses, estimated, true, frames)


def off(played: Played) -> tuple[np.ndarray, np.ndarray]:
    """Directions and twists (n, B) of the estimate's bones against the truth's, degrees."""
    turns, true = played.rotations(played.estimated), played.rotations(played.true)
    points, truly = turns @ ALONG[:, :, None], true @ ALONG[:, :, None]
    points, truly = points[..., 0], truly[..., 0]
    direction = np.degrees(np.arccos(np.clip((points * truly).sum(axis=-1), -1, 1)))
    columns = carried(np.swapaxes(turns, -1, -2), points[..., None, :], truly[..., None, :])
    traces = np.einsum("nbji,nbij->nb", columns, true)
    return direction, np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def slides(played: Played, labels: tuple[str, ...], rate: float) -> tuple[float, float]:
    """mm/s that standing feet go over the floor: the mean of their estimated markers, and the
    humanoid's.
    """
    found = []
    joints = played.joints(played.estimated)
    xyz = np.array([played.poses[i].xyz for i in played.frames])
    for side, foot in (("L", "LeftFoot"), ("R", "RightFoot")):
        ankle = played.truth[played.frames, labels.index(f"{side}ANK")]
        speed = np.linalg.norm(np.diff(ankle, axis=0), axis=1) * rate
        stands = (speed < STANDS) & (ankle[1:, 2] < np.quantile(ankle[:, 2], 0.05) + LOW)
        markers = [labels.index(side + name) for name in ("ANK", "HEE", "TOE", "MT5")]
        ways = [*xyz[:, markers].swapaxes(0, 1), joints[:, ROW[foot]]]
        gone = [np.linalg.norm(np.diff(way[:, :2], axis=0), axis=1)[stands] for way in ways]
        found.append([1000 * rate * np.concatenate(gone[:4]).mean(), 1000 * rate * gone[4].mean()])
    markers, humanoid = np.mean(found, axis=0)
    return float(markers), float(humanoid)


def changes(played: Played, rate: float) -> float:
    """By how much of its length the bone that changes most changes after the first second."""
    joints = played.joints(played.estimated)[round(FIRST * rate) :]
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    return float((np.ptp(lengths, axis=0) / np.median(lengths, axis=0)).max())


def least_bends(played: Played) -> dict[str, float]:
    """The least angle, degrees, by which each knee and elbow is bent; negative: backwards.

    By the joints alone: which side of the line from the limb's root to its end the middle one is
    on, seen along the axis across the upper bone.
    """
    joints, turns = played.joints(played.estimated), played.rotations(played.estimated)
    found = {}
    for side in ("Left", "Right"):
        for upper, lower, end, forward in (
            ("UpperLeg", "LowerLeg", "Foot", 1.0),
            ("UpperArm", "LowerArm", "Hand", -1.0),
        ):
            root, middle, tip = (joints[:, ROW[side + name]] for name in (upper, lower, end))
            a, b = middle - root, tip - middle
            front = forward * turns[:, ROW[side + upper], :, 1]  # to where the middle goes
            angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
            sign = np.sign(-(b * front).sum(axis=1))
            found[side + lower] = float(np.degrees((sign * angle).min()))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--split", default="test")
    parser.add_argument("--gaps", default=None, metavar="20%%:10-100")
    options = parser.parse_args()
    folder = Path(os.environ["MARKERBRIDGE_DATA"])
    with (folder / "manifest.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["split"] == options.split]
    names = [row["file"] for row in rows if row["kind"] == "real"]
    model = Model("default")
    directions, twists = [], []
    for name in names:
        played = play(model, folder / name, options.gaps)
        direction, twist = off(played)
        directions.append(direction)
        twists.append(twist)
        markers, humanoid = slides(played, model.info.labels, 120.0)
        bends = ", ".join(f"{bend:.1f}" for bend in least_bends(played).values())
        print(
            f"{name:26}feet that stand slide: markers {markers:.0f}, humanoid {humanoid:.0f} mm/s; "
            f"bones change {100 * changes(played, 120.0):.1f} %; least bends {bends}"
        )
    print(f"\n{'':15}direction: median, p95   twist: median, p95   direction by capture")
    every, every_twist = np.concatenate(directions), np.concatenate(twists)
    for row, bone in enumerate(BONES):
        by_capture = " ".join(f"{np.median(found[:, row]):5.1f}" for found in directions)
        print(
            f"{bone:15}{np.median(every[:, row]):14.1f}{np.quantile(every[:, row], 0.95):7.1f}"
            f"{np.median(every_twist[:, row]):16.1f}{np.quantile(every_twist[:, row], 0.95):6.1f}"
            f"   {by_capture}"
        )
    solver = HumanoidSolver(model.info)
    began = time.process_time()
    for pose in played.poses:
        solver.solve(pose)
    print(f"\n{1e6 * (time.process_time() - began) / len(played.poses):.0f} us of CPU a pose")


if __name__ == "__main__":
    main()
