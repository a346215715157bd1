"""From the 41 markers of a pose to the humanoid's joints and rotations (docs/decisions/0025).

Trunk and head are turned as their markers are. Limbs are two bones of constant length each, whose
ends are put where the markers have them: so hands and feet are where they were seen, whatever the
lengths. Which way knees and elbows point is told by their markers and, where a limb is straight, by
the trunk, so that no joint bends backwards.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.humanoid.body import OUT, SIDES, UP, Body, lowered, outside
from bridge.humanoid.landmarks import LandmarkFinder, Landmarks
from bridge.humanoid.limbs import ALONG, REACH, oriented, placed
from bridge.humanoid.proportions import Measuring, Proportions
from bridge.humanoid.rotations import Array, carried, cross, dot, length_of, quaternions, unit
from bridge.humanoid.skeleton import BONES, PARENTS, ROW, Posture
from bridge.model import ModelInfo
from bridge.pose import Pose, Provenance
from drivers.frame import Floats

_NECK = np.array([0.0, 0.2, 1.0]) / np.hypot(0.2, 1.0)  # where the neck points in the rest pose
_LAG = 0.1  # s: how late it is seen that a foot turns
_SOLE = 0.08  # m: of the ankle over the floor
_FEET = -0.06  # sine of how far heel to toe, as their markers lie, rises in a foot that stands
_UNKNOWN = 1e6  # m: an infinite sigma as a number that can be averaged


def _rows(*names: str) -> npt.NDArray[np.intp]:
    return np.array([ROW[name] for name in names], np.intp)


_PARENTS = PARENTS[1:]
_CLAVICLES = _rows("LeftShoulder", "RightShoulder")
_UPPER = _rows("LeftUpperArm", "RightUpperArm", "LeftUpperLeg", "RightUpperLeg")
_LOWER = _rows("LeftLowerArm", "RightLowerArm", "LeftLowerLeg", "RightLowerLeg")
_ENDS = _rows("LeftHand", "RightHand", "LeftFoot", "RightFoot")


class HumanoidSolver:
    """One performer's humanoid. Call `solve` with each pose in turn.

    Their proportions are the model's where it was calibrated, else measured on the first poses.
    """

    def __init__(self, info: ModelInfo) -> None:
        known = info.proportions
        self._find = LandmarkFinder(info.labels)
        self._told_by = _told_by(info.labels)
        self._measuring = Measuring(None if known is None else Proportions(np.array(known)))
        self._adopt_build()
        self._last: tuple[float, Array] | None = None  # when, and what was outside of the feet

    @property
    def proportions(self) -> Proportions:
        """How the performer is taken to be built now."""
        return self._measuring.mean

    def solve(self, pose: Pose) -> Posture | None:
        """The humanoid of a pose; None where it lacks a marker."""
        if np.isnan(pose.xyz).any():
            return None
        seen = self._find(pose.xyz)
        body = Body(seen, self.proportions, self._outside(seen, pose.t))
        # A lost pose stays where it was: it would count as often as it is shown.
        if not (pose.provenance == Provenance.LOST).all() and self._measuring.due():
            self._measuring.add(body.shows())
            self._adopt_build()
        joints = np.empty((len(BONES), 3))
        turns = np.empty((len(BONES), 3, 3))
        self._place_trunk(joints, turns, body)
        joints[_LOWER], joints[_ENDS], turns[_UPPER], turns[_LOWER] = placed(
            joints[_UPPER], body.ends, body.bends, self._lengths
        )
        _turn_hands(joints, turns, seen)
        _turn_feet(turns, seen)
        return self._posture(joints, turns, pose)

    def _adopt_build(self) -> None:
        """Takes over what follows from the proportions alone."""
        self._rest = rest_pose(self.proportions)
        self._shown_rest = self._rest.astype(np.float32)
        self._lengths = np.repeat(self.proportions.limbs, 2, axis=0)

    def _outside(self, seen: Landmarks, t: float) -> Array:
        """What is outside of the feet, a little late: a foot that stands still must not move when
        its heel and toe seem to.
        """
        found = outside(seen)
        if self._last is not None:
            before, last = self._last
            found = last + (1.0 - math.exp(-max(t - before, 0.0) / _LAG)) * (found - last)
        self._last = t, found
        return found

    def _place_trunk(self, joints: Array, turns: Array, body: Body) -> None:
        """Joints and rotations from the hips to the head and the clavicles, and the joints where
        arms and legs begin.
        """
        build, seen, rest = self.proportions, body.seen, self._rest
        pelvis, chest, head = body.axes
        legs = rest[_UPPER[2:]] @ pelvis.T
        hips = body.hips + _lacking(body.hips + legs, body.ends[2:], self._lengths[-1].sum())
        joints[0], turns[0] = hips, pelvis
        joints[1] = hips + pelvis @ build.waist
        spine = unit(seen.chest - joints[1])
        joints[2], turns[2] = joints[1] + build.spine * spine, chest
        joints[3] = joints[2] + chest @ build.neck
        neck = unit(body.skull - joints[3])
        joints[4], turns[4] = joints[3] + build.skull * neck, head
        rights = body.axes[:2, :, 0] + body.axes[1:, :, 0]
        turns[1:4:2] = _upright(np.array([spine, neck]), rights) @ _TO_UPRIGHT
        clavicles = joints[2] + rest[_CLAVICLES] @ chest.T
        length = length_of(build.clavicle)
        toward = unit(seen.shoulders - clavicles)
        usual = rest[_UPPER[:2]] @ chest.T / length
        columns = carried(chest.T, usual[:, None], toward[:, None])
        turns[_CLAVICLES] = np.swapaxes(columns, 1, 2)
        joints[_CLAVICLES] = clavicles
        joints[_UPPER[:2]] = clavicles + length * toward
        joints[_UPPER[2:]] = hips + legs

    def _posture(self, joints: Array, turns: Array, pose: Pose) -> Posture:
        both = np.array([turns, turns])
        both[1, 1:] = turns[_PARENTS].transpose(0, 2, 1) @ turns[1:]
        rotations = quaternions(both).astype(np.float32)
        return Posture(
            joints=joints.astype(np.float32),
            rotations=rotations[0],
            local=rotations[1],
            sigma=self._sigma(pose.sigma),
            rest=self._shown_rest,
        )

    def _sigma(self, sigma: Floats) -> Floats:
        """(B,): of the bones, from that of the markers (M,); infinite where one of theirs is."""
        variance = self._told_by @ np.minimum(sigma, _UNKNOWN).astype(float) ** 2
        found = np.where(variance > _UNKNOWN, np.inf, np.sqrt(variance))
        return found.astype(np.float32)


def _lacking(roots: Array, ends: Array, length: float) -> Array:
    """(3,): how far the hips are to go so that both legs, which are not longer than that, reach
    their feet: an error of millimetres is seen in a foot that slides and not in the hips.
    """
    moved = np.zeros(3)
    for _ in range(2):
        way = ends - roots - moved
        distance = length_of(way)
        over = np.maximum(distance - REACH * length, 0.0)
        if not over.any():
            break
        share = over / np.maximum(distance, 1e-9)
        moved = moved + share @ way / max(1, int(np.count_nonzero(over)))
    return moved


def _turn_hands(joints: Array, turns: Array, seen: Landmarks) -> None:
    """Forearms and hands are turned by the wrist's two markers, palms down in the rest pose."""
    forearms = joints[_ENDS[:2]] - joints[_LOWER[:2]]
    along = unit(np.array([forearms, seen.fingers - seen.wrists]))
    hinges = unit(cross(np.array([seen.thumbs, seen.thumbs]), along))
    turns[_LOWER[:2]], turns[_ENDS[:2]] = map(oriented, along, hinges)


def _turn_feet(turns: Array, seen: Landmarks) -> None:
    """Forward from heel to toe; from side to side as the foot's markers and the shank have it, half
    each.
    """
    forward = unit(seen.feet_forward)
    across = seen.feet_across * SIDES
    right = unit(across - dot(across, forward) * forward) + turns[_LOWER[2:], :, 0]
    right = unit(right - dot(right, forward) * forward)
    columns = np.array([right, forward, cross(right, forward)])
    turns[_ENDS[2:]] = columns.transpose(1, 2, 0) @ _FOOT_TURN


def rest_pose(build: Proportions) -> Array:
    """(B, 3): each joint from its parent's in the rest pose, metres; the hips' from the floor."""
    rest = np.zeros((len(BONES), 3))
    rest[0] = (build.limbs[1].sum() + _SOLE) * UP
    rest[1] = build.waist
    rest[2] = build.spine * UP
    rest[3] = build.neck
    rest[4] = build.skull * _NECK
    rest[_CLAVICLES] = OUT * build.collar
    rest[_UPPER] = np.concatenate([OUT * build.clavicle, OUT * build.hip])
    lengths = np.repeat(build.limbs, 2, axis=0)
    rest[_LOWER] = lengths[:, :1] * ALONG
    rest[_ENDS] = lengths[:, 1:] * ALONG
    return rest


def _upright(up: Array, right: Array) -> Array:
    """(n, 3, 3): the rotations whose z is `up` (n, 3) and whose x is near `right` (n, 3)."""
    x = unit(right - dot(right, up) * up)
    return np.array([x, cross(up, x), up]).transpose(1, 2, 0)


# What brings spine and neck from where they point in the rest pose to upright.
_TO_UPRIGHT = np.array([np.eye(3), lowered(-_NECK[1:2])[0]])
_FOOT_TURN = lowered(np.array([_FEET]))[0]

# The markers that tell how a bone is turned, without their side.
_MARKERS = {
    "Hips": "LFWT RFWT LBWT RBWT",
    "Spine": "LBWT RBWT T10 STRN",
    "Chest": "C7 T10 CLAV STRN",
    "Neck": "C7 CLAV LBHD RBHD",
    "Head": "LFHD RFHD LBHD RBHD",
    "Shoulder": "CLAV {}SHO",
    "UpperArm": "{}SHO {}ELB",
    "LowerArm": "{}ELB {}WRA {}WRB",
    "Hand": "{}WRA {}WRB {}FIN",
    "UpperLeg": "{}FWT {}BWT {}KNE",
    "LowerLeg": "{}KNE {}ANK",
    "Foot": "{}ANK {}HEE {}TOE {}MT5",
}


def _told_by(labels: tuple[str, ...]) -> Array:
    """(B, M): the share of each marker in what a bone is told by."""
    shares = np.zeros((len(BONES), len(labels)))
    for row, bone in enumerate(BONES):
        side = bone[0] if bone.startswith(("Left", "Right")) else ""
        markers = _MARKERS[bone.removeprefix("Left").removeprefix("Right")].format(*side * 4)
        for marker in markers.split():
            shares[row, labels.index(marker)] = 1.0 / len(markers.split())
    return shares
