"""What the 41 markers tell of the body: how its trunk is turned, and where its joints are.

Marker triads and published regressions (docs/decisions/0025 has sources and choices). All in
metres, in the world. Pairs are left, right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bridge.humanoid.rotations import Array, cross, length_of, unit
from drivers.frame import Floats

# Sums of markers; in pairs, `{}` is L and then R.
_SUMS = {
    "waist right": "RFWT+RBWT-LFWT-LBWT",
    "waist forward": "LFWT+RFWT-LBWT-RBWT",
    "pelvis width": "RFWT-LFWT",
    "waist front": "LFWT+RFWT",
    "waist back": "LBWT+RBWT",
    "chest up": "C7+CLAV-T10-STRN",
    "chest forward": "CLAV+STRN-C7-T10",
    "shoulders right": "RSHO-LSHO",
    "chest": "T10+T10+STRN",
    "neck": "C7+C7+CLAV",
    "notch": "CLAV",
    "head right": "RFHD+RBHD-LFHD-LBHD",
    "head forward": "LFHD+RFHD-LBHD-RBHD",
    "head": "LFHD+RFHD+LBHD+RBHD",
    "shoulders": "{}SHO",
    "elbows": "{}ELB",
    "wrists": "{}WRA+{}WRB",
    "thumbs": "{}WRA-{}WRB",
    "fingers": "{}FIN",
    "knees": "{}KNE",
    "ankles": "{}ANK",
    "feet forward": "{}TOE-{}HEE",
    "feet across": "{}MT5-{}TOE",
}
_SHARE = {"waist front": 2, "waist back": 2, "chest": 3, "neck": 3, "head": 4, "wrists": 2}

# Harrington et al. 2007: the hip's centre from the middle of the front of the pelvis, in its frame:
# shares of its width (sideways, up) and depth (forward), and metres.
_HIP = np.array([0.33, -0.24, -0.30])
_HIP_MORE = np.array([0.0073, -0.0099, -0.0109])
_DROP = 0.17  # Rab et al. 2002: the shoulder's centre under the acromion, of the shoulders' breadth
# m: from the jugular notch to where the clavicles begin.
_CLAVICLES = np.array([[-0.025, -0.025, 0.0], [0.025, -0.025, 0.0]])
_LEFT = np.array([-1.0, 1.0, 1.0])  # the other side of the body
_SHOULDERS = 0.5  # of the chest's right: as far as the line of the shoulders tells it


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """axes: (3, 3, 3) of pelvis, chest and head, as their markers lie; columns right, forward, up.
    Joints (2, 3) in pairs, or (3,). elbows, knees, ankles: the markers, on the outside. wrists:
    joints. thumbs: from the little finger's side of the wrist to the thumb's. feet_forward: heel to
    toe; feet_across: outwards. head: (3,), the headband's middle.
    """

    axes: Array
    hips: Array
    waist: Array
    chest: Array
    neck: Array
    clavicles: Array
    shoulders: Array
    elbows: Array
    wrists: Array
    thumbs: Array
    fingers: Array
    knees: Array
    ankles: Array
    feet_forward: Array
    feet_across: Array
    head: Array


class LandmarkFinder:
    """Landmarks of poses whose markers are in the order of `labels`; all 41 are needed."""

    def __init__(self, labels: tuple[str, ...]) -> None:
        rows: list[Array] = []
        self._at: dict[str, slice | int] = {}
        for name, terms in _SUMS.items():
            sides = "LR" if "{}" in terms else " "
            at = len(rows)
            self._at[name] = at if sides == " " else slice(at, at + 2)
            for side in sides:
                weights = _weights(terms.replace("{}", side), labels)
                rows.append(weights / _SHARE.get(name, 1))
        self._sums = np.array(rows)

    def __call__(self, xyz: Floats) -> Landmarks:
        """The landmarks of a pose (41, 3)."""
        sums = self._sums @ xyz
        at = {name: sums[rows] for name, rows in self._at.items()}
        axes = _axes(
            np.array(
                [
                    at["waist right"],
                    unit(cross(at["chest forward"], at["chest up"]))
                    + _SHOULDERS * unit(at["shoulders right"]),
                    at["head right"],
                ]
            ),
            np.array([at["waist forward"], at["chest up"], at["head forward"]]),
        )
        pelvis, chest, _ = axes
        depth = at["waist front"] - at["waist back"]
        width, depth, breadth = length_of(
            np.array([at["pelvis width"], depth, at["shoulders right"]])
        )
        hip = _HIP * [width, depth, width] + _HIP_MORE
        hips = at["waist front"] + np.array([hip * _LEFT, hip]) @ pelvis.T
        return Landmarks(
            axes=axes,
            hips=hips,
            waist=0.4 * at["waist front"] + 0.6 * at["waist back"],
            chest=at["chest"],
            neck=at["neck"],
            clavicles=at["notch"] + _CLAVICLES @ chest.T,
            shoulders=at["shoulders"] - _DROP * breadth * chest[:, 2],
            elbows=at["elbows"],
            wrists=at["wrists"],
            thumbs=at["thumbs"],
            fingers=at["fingers"],
            knees=at["knees"],
            ankles=at["ankles"],
            feet_forward=at["feet forward"],
            feet_across=at["feet across"],
            head=at["head"],
        )


def _weights(terms: str, labels: tuple[str, ...]) -> Array:
    """(M,): how often each marker is in `A+B-C`."""
    weights = np.zeros(len(labels))
    for term in terms.replace("-", "+-").split("+"):
        weights[labels.index(term.removeprefix("-"))] += -1.0 if term.startswith("-") else 1.0
    return weights


def _axes(right: Array, second: Array) -> Array:
    """(3, 3, 3) of pelvis, chest and head: right as told; of pelvis and head forward as near as can
    be, of the chest up.
    """
    x = unit(right)
    normal = unit(cross(x, second))  # pelvis, head: up; chest: back
    third = cross(normal, x)  # pelvis, head: forward; chest: up
    found = np.array([x, third, normal])
    found[1:, 1] = -normal[1], third[1]
    return found.transpose(1, 2, 0)
