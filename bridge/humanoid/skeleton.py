"""The humanoid: which bones there are, how long they are, and how they stand at one moment.

Bones are named as UnityEngine.HumanBodyBones names them, and are only those that 41 markers tell.
A bone begins at its joint. In the rest pose, a T (arms level to the sides, palms down, feet
forward), every bone's rotation is the identity: x to the right, y forward, z up, as in our world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.frame import Floats

_PARENTS = {
    "Hips": "",
    "Spine": "Hips",
    "Chest": "Spine",
    "Neck": "Chest",
    "Head": "Neck",
    "LeftShoulder": "Chest",
    "LeftUpperArm": "LeftShoulder",
    "LeftLowerArm": "LeftUpperArm",
    "LeftHand": "LeftLowerArm",
    "RightShoulder": "Chest",
    "RightUpperArm": "RightShoulder",
    "RightLowerArm": "RightUpperArm",
    "RightHand": "RightLowerArm",
    "LeftUpperLeg": "Hips",
    "LeftLowerLeg": "LeftUpperLeg",
    "LeftFoot": "LeftLowerLeg",
    "RightUpperLeg": "Hips",
    "RightLowerLeg": "RightUpperLeg",
    "RightFoot": "RightLowerLeg",
}

BONES: tuple[str, ...] = tuple(_PARENTS)  # a parent comes before its children
ROW = {name: row for row, name in enumerate(BONES)}
PARENTS: npt.NDArray[np.intp] = np.array(
    [ROW.get(parent, -1) for parent in _PARENTS.values()], np.intp
)


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """The humanoid at one moment, in BONES' order.

    joints: (B, 3) float32, metres, world. rotations: (B, 4) float32 unit quaternions x, y, z, w
    that turn the rest pose's bones in the world; local: the same against the parent's (the hips':
    the world's). sigma: (B,) float32, standard deviation of the error per coordinate of what a
    bone is told by, metres. rest: (B, 3) float32, each joint from its parent's in the rest pose,
    metres; the hips' from the floor.
    """

    joints: Floats
    rotations: Floats
    local: Floats
    sigma: Floats
    rest: Floats
