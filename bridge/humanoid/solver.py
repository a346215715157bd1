"""From the 41 markers of a pose to the humanoid's joints and rotations (docs/decisions/0025).

Trunk and head are turned as their markers are. Limbs are two bones of constant length each, whose
ends are put where the markers have them: so hands and feet are where they were seen, whatever the
lengths. Which way knees and elbows point is told by their markers and, where a limb is straight, by
the trunk, so that no joint bends backwards.
"""

from __future__ import annotations

import numpy as np

from bridge.humanoid.landmarks import LandmarkFinder, Landmarks
from bridge.humanoid.limbs import ALONG, REACH, bending, oriented, placed
from bridge.humanoid.proportions import Measuring, Proportions
from bridge.humanoid.rotations import Array, carried, cross, dot, quaternions, unit
from bridge.humanoid.skeleton import BONES, PARENTS, ROW, Posture
from bridge.model import ModelInfo
from bridge.pose import Pose
from drivers.frame import Floats

_HEAD = np.array([0.0, -0.01, -0.09])  # m: from the headband's middle to the head's joint
_NECK = np.array([0.0, 0.2, 1.0]) / np.hypot(0.2, 1.0)  # where the neck points in the rest pose
_ANKLE = 0.045  # m: from the ankle's middle to its marker
_SOLE = 0.08  # m: of the ankle over the floor
_FEET = -0.06  # sine of how far heel to toe, as their markers lie, rises in a foot that stands
_UPRIGHT = 0.92  # cosine to the vertical: less of pelvis or chest tells nothing of how they stand
_OUT = np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])  # x outwards, of the left and the right side
_SIDES = np.array([[-1.0], [1.0]])
_UP = np.array([0.0, 0.0, 1.0])
_TRUNKS = [1, 1, 0, 0]  # of pelvis, chest, head: what arms and legs hang on


def _rows(*names: str) -> list[int]:
    return [ROW[name] for name in names]


_CLAVICLES = _rows("LeftShoulder", "RightShoulder")
_UPPER = _rows("LeftUpperArm", "RightUpperArm", "LeftUpperLeg", "RightUpperLeg")
_LOWER = _rows("LeftLowerArm", "RightLowerArm", "LeftLowerLeg", "RightLowerLeg")
_ENDS = _rows("LeftHand", "RightHand", "LeftFoot", "RightFoot")


class HumanoidSolver:
    """One performer's humanoid. Call `solve` with each pose in turn.

    proportions: the performer's, where they are known; else they are measured on the first poses.
    """

    def __init__(self, info: ModelInfo, proportions: Proportions | None = None) -> None:
        self._find = LandmarkFinder(info.labels)
        self._told_by = _told_by(info.labels)
        self._measuring = Measuring(proportions)

    @property
    def proportions(self) -> Proportions:
        """What the performer is taken to be built like now."""
        return self._measuring.mean

    def solve(self, pose: Pose) -> Posture | None:
        """The humanoid of a pose; None where it lacks a marker."""
        if np.isnan(pose.xyz).any():
            return None
        seen = self._find(pose.xyz)
        axes = seen.axes @ _lowered(self.proportions.level)
        skull = seen.head + axes[2] @ _HEAD
        roots = np.concatenate([seen.shoulders, seen.hips])
        middles = np.concatenate([seen.elbows, seen.knees])
        ends = np.concatenate([seen.wrists, seen.ankles])
        bends, middles = bending(axes[_TRUNKS], roots, middles, ends)
        # By the feet, since a foot that stands still must not move when the knee does.
        ends[2:] -= _ANKLE * unit(cross(seen.feet_forward, _UP)) * _SIDES
        lengths = np.stack([_length(middles - roots), _length(ends - middles)], axis=1)
        self._measuring.add(_shown(seen, axes, skull, lengths))

        joints = np.empty((len(BONES), 3))
        turns = np.empty((len(BONES), 3, 3))
        self._place_trunk(joints, turns, axes, seen, skull, ends)
        lengths = np.repeat(self.proportions.limbs, 2, axis=0)
        joints[_LOWER], joints[_ENDS], turns[_UPPER], turns[_LOWER] = placed(
            joints[_UPPER], ends, bends, lengths
        )
        _turn_hands(joints, turns, seen)
        _turn_feet(turns, seen)
        return self._posture(joints, turns, pose)

    def _place_trunk(
        self, joints: Array, turns: Array, axes: Array, seen: Landmarks, skull: Array, ends: Array
    ) -> None:
        """Joints and rotations from the hips to the head, the shoulders and the hips' own; and the
        joints that arms and legs begin at.
        """
        build = self.proportions
        pelvis, chest, head = axes
        hips = seen.hips.mean(axis=0)
        legs = (_OUT * build.hip) @ pelvis.T
        hips = hips + _lacking(hips + legs, ends[2:], build.limbs[1].sum())
        joints[0], turns[0] = hips, pelvis
        joints[1] = hips + pelvis @ build.waist
        toward = unit(seen.chest - joints[1])
        turns[1] = _upright(toward, pelvis[:, 0] + chest[:, 0])
        joints[2], turns[2] = joints[1] + build.spine * toward, chest
        joints[3] = joints[2] + chest @ build.neck
        toward = unit(skull - joints[3])
        turns[3] = _upright(toward, chest[:, 0] + head[:, 0]) @ _NECK_TURN
        joints[4], turns[4] = joints[3] + build.skull * toward, head
        joints[_CLAVICLES] = joints[2] + (_OUT * build.collar) @ chest.T
        length = _length(build.clavicle)
        toward = unit(seen.shoulders - joints[_CLAVICLES])
        usual = (_OUT * build.clavicle) @ chest.T / length
        columns = carried(chest.T, usual[:, None], toward[:, None])
        turns[_CLAVICLES] = np.swapaxes(columns, 1, 2)
        joints[_UPPER[:2]] = joints[_CLAVICLES] + length * toward
        joints[_UPPER[2:]] = hips + legs

    def _posture(self, joints: Array, turns: Array, pose: Pose) -> Posture:
        local = turns.copy()
        local[1:] = np.swapaxes(turns[PARENTS[1:]], 1, 2) @ turns[1:]
        rotations = quaternions(np.stack([turns, local])).astype(np.float32)
        return Posture(
            joints=joints.astype(np.float32),
            rotations=rotations[0],
            local=rotations[1],
            sigma=np.sqrt(self._told_by @ pose.sigma**2).astype(np.float32),
            rest=rest_pose(self._measuring.mean),
        )


def _shown(seen: Landmarks, axes: Array, skull: Array, lengths: Array) -> Proportions:
    """What one pose shows of the performer's proportions. lengths: (4, 2), of the limbs' bones."""
    pelvis, chest, _ = axes
    hips = seen.hips.mean(axis=0)
    return Proportions(
        limbs=lengths.reshape(2, 2, 2).mean(axis=1),
        hip=np.array([_length(seen.hips[1] - seen.hips[0]) / 2, 0.0, 0.0]),
        waist=_sagittal((seen.waist - hips) @ pelvis),
        spine=_length(seen.chest - seen.waist)[None],
        neck=_sagittal((seen.neck - seen.chest) @ chest),
        skull=_length(skull - seen.neck)[None],
        collar=_outwards(seen.clavicles - seen.chest, chest),
        clavicle=_outwards(seen.shoulders - seen.clavicles, chest),
        level=_level(seen.axes),
    )


def _lacking(roots: Array, ends: Array, length: float) -> Array:
    """(3,): how far the hips are to go so that both legs, which are not longer than that, reach
    their feet: an error of millimetres is seen in a foot that slides and not in the hips.
    """
    moved = np.zeros(3)
    for _ in range(2):
        way = ends - roots - moved
        distance = _length(way)
        over = np.maximum(distance - REACH * length, 0.0)
        moved = moved + (over / distance) @ way / max(1, int(np.count_nonzero(over)))
    return moved


def _turn_hands(joints: Array, turns: Array, seen: Landmarks) -> None:
    """Forearms and hands are turned by the wrist's two markers, palms down in the rest pose."""
    toward = unit(joints[_ENDS[:2]] - joints[_LOWER[:2]])
    turns[_LOWER[:2]] = oriented(toward, unit(cross(seen.thumbs, toward)))
    toward = unit(seen.fingers - seen.wrists)
    turns[_ENDS[:2]] = oriented(toward, unit(cross(seen.thumbs, toward)))


def _turn_feet(turns: Array, seen: Landmarks) -> None:
    """Forward from heel to toe; from side to side as the foot's markers and the shank have it, half
    each.
    """
    forward = unit(seen.feet_forward)
    across = seen.feet_across * _SIDES
    right = unit(across - dot(across, forward) * forward) + turns[_LOWER[2:], :, 0]
    right = unit(right - dot(right, forward) * forward)
    turns[_ENDS[2:]] = np.stack([right, forward, cross(right, forward)], axis=-1) @ _FOOT_TURN


def rest_pose(build: Proportions) -> Floats:
    """(B, 3): each joint from its parent's in the rest pose, metres; the hips' from the floor."""
    rest = np.zeros((len(BONES), 3))
    rest[0] = (build.limbs[1].sum() + _SOLE) * _UP
    rest[1] = build.waist
    rest[2] = build.spine * _UP
    rest[3] = build.neck
    rest[4] = build.skull * _NECK
    rest[_CLAVICLES] = _OUT * build.collar
    rest[_UPPER] = np.concatenate([_OUT * build.clavicle, _OUT * build.hip])
    lengths = np.repeat(build.limbs, 2, axis=0)
    rest[_LOWER] = lengths[:, :1] * ALONG
    rest[_ENDS] = lengths[:, 1:] * ALONG
    return rest.astype(np.float32)


def _lowered(rises: Array) -> Array:
    """(n, 3, 3): turns about x that bring forward axes which rise so far (sines) to the level."""
    turns = np.zeros((len(rises), 3, 3))
    turns[:, 0, 0] = 1.0
    turns[:, 1, 1] = turns[:, 2, 2] = np.sqrt(1.0 - rises**2)
    turns[:, 1, 2], turns[:, 2, 1] = rises, -rises
    return turns


def _level(axes: Array) -> Array:
    """(3,): how far the forward axes rise; NaN unless pelvis and chest stand upright. The chest's
    is not asked: how somebody holds it is their posture.
    """
    if axes[0, 2, 2] < _UPRIGHT or axes[1, 2, 2] < _UPRIGHT:
        return np.full(3, np.nan)
    return np.where([True, False, True], axes[:, 2, 1], np.nan)


def _upright(up: Array, right: Array) -> Array:
    """(3, 3): the rotation whose z is `up` and whose x is near `right`."""
    x = unit(right - (right @ up) * up)
    return np.stack([x, cross(up, x), up], axis=-1)


def _length(vectors: Array) -> Array:
    found: Array = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    return found


def _sagittal(vector: Array) -> Array:
    """(3,) without what goes sideways."""
    return vector * [0.0, 1.0, 1.0]


def _outwards(pair: Array, axes: Array) -> Array:
    """(3,): the mean of vectors (2, 3) to the left and to the right, in these axes, x outwards."""
    found: Array = ((pair @ axes) * _OUT).mean(axis=0)
    return found


_NECK_TURN = _lowered(-_NECK[1:2])[0]
_FOOT_TURN = _lowered(np.array([_FEET]))[0]

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
