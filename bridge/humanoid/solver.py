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

from bridge.humanoid.body import Body
from bridge.humanoid.bones import bone_sigma, place, rest_pose
from bridge.humanoid.proportions import Measuring, Proportions
from bridge.humanoid.skeleton import BONES, PARENTS, Posture
from bridge.model import ModelInfo
from bridge.pose import Pose, Provenance

_LAG = 0.1  # s: how late it is seen that a foot turns


class HumanoidSolver:
    """One performer's humanoid. Call `solve` with each pose in turn.

    Their proportions are the model's where it was calibrated, else measured on the first poses.
    """

    def __init__(self, info: ModelInfo) -> None:
        known = info.proportions
        self._measuring = Measuring(None if known is None else Proportions(np.array(known)))
        self._body = Body(info.labels)
        self._told_by = _told_by(info.labels)
        self._t = -math.inf  # of the last pose
        self._lost = bytes([Provenance.LOST]) * len(info.labels)
        self._sigma = np.empty(len(info.labels), np.float32)
        self._joints = np.empty((len(BONES), 3))
        self._turns = np.empty((len(BONES), 3, 3))
        self._rest = np.empty((len(BONES), 3))
        self._adopt_build()

    @property
    def proportions(self) -> Proportions:
        """How the performer is taken to be built now."""
        return self._measuring.mean

    def solve(self, pose: Pose) -> Posture | None:
        """The humanoid of a pose; None where it lacks a marker."""
        body = self._body
        news = 1.0 - math.exp(min(self._t - pose.t, 0.0) / _LAG)
        if not body.see(pose.xyz, self.proportions, news):
            return None
        self._t = pose.t
        # A lost pose stays where it was: it would count as often as it is shown.
        if pose.provenance.tobytes() != self._lost and self._measuring.due():
            self._measuring.add(body.shows())
            self._adopt_build()
        count = len(BONES)
        posture = Posture(
            joints=np.empty((count, 3), np.float32),
            rotations=np.empty((count, 4), np.float32),
            local=np.empty((count, 4), np.float32),
            sigma=np.empty(count, np.float32),
            rest=self._shown_rest,
        )
        seen = body.seen
        place(
            PARENTS,
            *(body.axes, seen.trunk, body.centre, body.limbs, seen.hands, seen.feet),
            *(self._rest, self._joints, self._turns),
            *(posture.joints, posture.rotations, posture.local),
        )
        self._sigma[:] = pose.sigma
        bone_sigma(self._sigma, self._told_by, posture.sigma)
        return posture

    def _adopt_build(self) -> None:
        """Takes over what follows from the proportions alone."""
        rest_pose(self.proportions.values, self._rest)
        self._shown_rest = self._rest.astype(np.float32)


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


def _told_by(labels: tuple[str, ...]) -> npt.NDArray[np.int64]:
    """(B, 4): the rows of the markers that a bone is told by; -1 where they are fewer."""
    rows = np.full((len(BONES), 4), -1, np.int64)
    for row, bone in enumerate(BONES):
        side = bone[0] if bone.startswith(("Left", "Right")) else ""
        markers = _MARKERS[bone.removeprefix("Left").removeprefix("Right")].format(*side * 4)
        found = [labels.index(marker) for marker in markers.split()]
        rows[row, : len(found)] = found
    return rows
