"""Which bone each marker sits on, and the trackers that VR programs know a body by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from bridge.humanoid.skeleton import ROW
from bridge.pose import Pose
from bridge.uncertainty import Caution, Points, ShownPoints

_CENTRE = {
    "Head": "LFHD RFHD LBHD RBHD",
    "Chest": "C7 T10 CLAV STRN RBAC",
    "Hips": "LFWT RFWT LBWT RBWT",
}
_SIDES = {
    "Shoulder": "SHO",
    "UpperArm": "UPA ELB",
    "LowerArm": "FRM WRA WRB",
    "Hand": "FIN",
    "UpperLeg": "THI KNE",
    "LowerLeg": "SHN ANK",
    "Foot": "HEE TOE MT5",
}

# A marker beside a joint is on the bone that it is stuck to: an elbow's on the upper arm.
BONE_OF: dict[str, str] = {
    marker: bone for bone, markers in _CENTRE.items() for marker in markers.split()
} | {
    side[0] + marker: side + bone
    for side in ("Left", "Right")
    for bone, markers in _SIDES.items()
    for marker in markers.split()
}


def bone_rows(labels: tuple[str, ...]) -> list[int]:
    """The rows in BONES of the bones that these markers sit on; an unknown one sits on the hips."""
    return [ROW[BONE_OF.get(label, "Hips")] for label in labels]


class Tracker(NamedTuple):
    """A tracker at a joint (named by the bone that begins there), turned as a bone is."""

    joint: str
    bone: str


# 1 to 8 are SlimeVR's fixed numbers, on which others rely. Knees and elbows are the thighs' and the
# upper arms' ends, and turned as these are, as there. 0, 9 and 10 are ours.
TRACKERS = {
    0: Tracker("Head", "Head"),
    1: Tracker("Hips", "Hips"),
    2: Tracker("LeftFoot", "LeftFoot"),
    3: Tracker("RightFoot", "RightFoot"),
    4: Tracker("LeftLowerLeg", "LeftUpperLeg"),
    5: Tracker("RightLowerLeg", "RightUpperLeg"),
    6: Tracker("Chest", "Chest"),
    7: Tracker("LeftLowerArm", "LeftUpperArm"),
    8: Tracker("RightLowerArm", "RightUpperArm"),
    9: Tracker("LeftHand", "LeftHand"),
    10: Tracker("RightHand", "RightHand"),
}


def parse_trackers(known: Sequence[int]) -> Callable[[str], list[int]]:
    """`1,2,3`: some of the numbers of TRACKERS."""

    def read(text: str) -> list[int]:
        words = [word.strip() for word in text.split(",")]
        numbers = [number for number in known if str(number) in words]
        if len(numbers) != len(words):
            raise ValueError(f"write some of {known[0]} to {known[-1]}, each once: 1,2,3")
        return numbers

    return read


class BodyTrackers:
    """Where trackers are, and how turned, under a policy for what is uncertain."""

    def __init__(self, numbers: Sequence[int], caution: Caution) -> None:
        self._joints = [ROW[TRACKERS[number].joint] for number in numbers]
        self._bones = [ROW[TRACKERS[number].bone] for number in numbers]
        self._points = Points(caution, self._bones)

    def __call__(self, pose: Pose) -> ShownPoints:
        """Those of a pose that has a posture."""
        posture = pose.posture
        assert posture is not None
        return self._points(
            pose.t, posture.joints.take(self._joints, 0), posture.sigma.take(self._bones), posture
        )
