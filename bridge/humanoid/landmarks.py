"""What the 41 markers tell of the body: how its trunk is turned, and where its joints are.

Marker triads and published regressions (docs/decisions/0025 has sources and choices). All in
metres, in the world. Pairs are left, right.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled, inlined
from bridge.vectors import (
    Array,
    Axes,
    Vector,
    at,
    cross,
    length,
    minus,
    plus,
    put,
    put_axes,
    times,
    turned,
    unit,
)
from drivers.frame import Floats

_CENTRE = "LFWT RFWT LBWT RBWT C7 CLAV T10 STRN LFHD RFHD LBHD RBHD"
_SIDES = "SHO ELB WRA WRB FIN KNE ANK HEE TOE MT5"
_PELVIS, _CHEST, _HEAD, _SIDE = 0, 4, 8, 12  # where these begin, and the left side's
_IN_SIDE = 10  # the right side's begin so much later

# Harrington et al. 2007: the hip's centre from the middle of the front of the pelvis, in its frame:
# shares of its width (sideways, up) and depth (forward), and metres.
_HIP = (0.33, -0.24, -0.30)
_HIP_MORE = (0.0073, -0.0099, -0.0109)
_DROP = 0.17  # Rab et al. 2002: the shoulder's centre under the acromion, of the shoulders' breadth
_CLAVICLE = (0.025, -0.025)  # m: outwards and forward from the jugular notch to where it begins
_SHOULDERS = 0.5  # of the chest's right: as far as the line of the shoulders tells it


class Landmarks:
    """Those of one pose at a time whose markers are in the order of `labels`: of the last `find`.

    axes: (3, 3, 3) of pelvis, chest and head, as their markers lie; rows right, forward, up. trunk:
    (4, 3), the joints of waist, chest and neck, and the headband's middle. clavicles: (2, 3), where
    they begin. limbs: (4, 3, 3) of arms and legs, each the joint where it begins, the marker on the
    outside of elbow or knee, and the wrist's joint or the ankle's marker. hands: (2, 2, 3), each
    from the little finger's side of the wrist to the thumb's, and from the wrist to the fingers.
    feet: (2, 2, 3), each from heel to toe, and outwards.
    """

    def __init__(self, labels: tuple[str, ...]) -> None:
        sides = [side + name for side in "LR" for name in _SIDES.split()]
        wanted = _CENTRE.split() + sides
        self._rows = np.array([labels.index(label) for label in wanted], np.int64)
        self._markers = np.empty((len(labels), 3))
        self.axes = np.empty((3, 3, 3))
        self.trunk = np.empty((4, 3))
        self.clavicles = np.empty((2, 3))
        self.limbs = np.empty((4, 3, 3))
        self.hands = np.empty((2, 2, 3))
        self.feet = np.empty((2, 2, 3))

    def find(self, xyz: Floats) -> bool:
        """Takes in a pose (41, 3); False where it lacks a marker."""
        self._markers[:] = xyz
        return _find(
            *(self._markers, self._rows, self.axes, self.trunk),
            *(self.clavicles, self.limbs, self.hands, self.feet),
        )


@inlined
def _middle(a: Vector, b: Vector) -> Vector:
    return times(0.5, plus(a, b))


@inlined
def _level(right: Vector, forward: Vector) -> Axes:
    """Right as told, forward as near as can be."""
    x = unit(right)
    up = unit(cross(x, forward))
    return x, cross(up, x), up


@inlined
def _upright(right: Vector, up: Vector) -> Axes:
    """Right as told, up as near as can be."""
    x = unit(right)
    forward = unit(cross(up, x))
    return x, forward, cross(x, forward)


@compiled(
    "b1(f8[:,::1], i8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1],"
    "f8[:,:,::1])"
)
def _find(
    markers: Array,
    rows: npt.NDArray[np.int64],
    axes: Array,
    trunk: Array,
    clavicles: Array,
    limbs: Array,
    hands: Array,
    feet: Array,
) -> bool:
    for marker in range(len(markers)):
        if not math.isfinite(markers[marker, 0] + markers[marker, 1] + markers[marker, 2]):
            return False

    left, right = at(markers, rows[_PELVIS]), at(markers, rows[_PELVIS + 1])
    left_back, right_back = at(markers, rows[_PELVIS + 2]), at(markers, rows[_PELVIS + 3])
    front, back = _middle(left, right), _middle(left_back, right_back)
    depth, width = minus(front, back), minus(right, left)
    pelvis = _level(plus(width, minus(right_back, left_back)), depth)
    wide = length(width)
    hip = (
        _HIP[0] * wide + _HIP_MORE[0],
        _HIP[1] * length(depth) + _HIP_MORE[1],
        _HIP[2] * wide + _HIP_MORE[2],
    )
    put_axes(axes[0], pelvis)
    put(trunk, 0, plus(times(0.4, front), times(0.6, back)))

    c7, clav = at(markers, rows[_CHEST]), at(markers, rows[_CHEST + 1])
    t10, strn = at(markers, rows[_CHEST + 2]), at(markers, rows[_CHEST + 3])
    up = minus(plus(c7, clav), plus(t10, strn))
    forward = minus(plus(clav, strn), plus(c7, t10))
    breadth = minus(at(markers, rows[_SIDE + _IN_SIDE]), at(markers, rows[_SIDE]))
    across = plus(unit(cross(forward, up)), times(_SHOULDERS, unit(breadth)))
    chest = _upright(across, up)
    put_axes(axes[1], chest)
    put(trunk, 1, times(1.0 / 3.0, plus(plus(t10, t10), strn)))
    put(trunk, 2, times(1.0 / 3.0, plus(plus(c7, c7), clav)))

    left, right = at(markers, rows[_HEAD]), at(markers, rows[_HEAD + 1])
    left_back, right_back = at(markers, rows[_HEAD + 2]), at(markers, rows[_HEAD + 3])
    head_front, head_back = _middle(left, right), _middle(left_back, right_back)
    head_right = plus(minus(right, left), minus(right_back, left_back))
    put_axes(axes[2], _level(head_right, minus(head_front, head_back)))
    put(trunk, 3, _middle(head_front, head_back))

    for side in range(2):
        out = 2.0 * side - 1.0
        first = _SIDE + _IN_SIDE * side
        put(clavicles, side, plus(clav, turned(chest, (out * _CLAVICLE[0], _CLAVICLE[1], 0.0))))

        arm, leg = limbs[side], limbs[2 + side]
        drop = times(_DROP * length(breadth), chest[2])
        put(arm, 0, minus(at(markers, rows[first]), drop))
        put(arm, 1, at(markers, rows[first + 1]))
        thumb, little = at(markers, rows[first + 2]), at(markers, rows[first + 3])
        wrist = _middle(thumb, little)
        put(arm, 2, wrist)
        put(hands[side], 0, minus(thumb, little))
        put(hands[side], 1, minus(at(markers, rows[first + 4]), wrist))

        put(leg, 0, plus(front, turned(pelvis, (out * hip[0], hip[1], hip[2]))))
        put(leg, 1, at(markers, rows[first + 5]))
        put(leg, 2, at(markers, rows[first + 6]))
        heel, toe = at(markers, rows[first + 7]), at(markers, rows[first + 8])
        put(feet[side], 0, minus(toe, heel))
        put(feet[side], 1, minus(at(markers, rows[first + 9]), toe))
    return True
