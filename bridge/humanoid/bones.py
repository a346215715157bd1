"""From what a pose shows of a body to its bones: each of the length that it always has.

Trunk and head are turned as they are seen. A limb is two bones, whose end is put where it is seen,
as far as the limb goes; they bend in the plane that is told.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled, inlined
from bridge.humanoid.skeleton import ROW
from bridge.vectors import (
    Array,
    Axes,
    Vector,
    across,
    at,
    axes_at,
    carried,
    cross,
    length,
    lowered,
    minus,
    plus,
    put,
    put_axes,
    put_turn,
    quaternion,
    seen_in,
    times,
    turned,
    unit,
)
from drivers.frame import Floats

_SOLE = 0.08  # m: of the ankle over the floor
_FEET = -0.06  # sine of how far heel to toe, as their markers lie, rises in a foot that stands
_RISE = 1.0 / math.hypot(0.2, 1.0)  # of the neck in the rest pose, which goes forward by a fifth
_REACH = 0.9995  # of its length: no limb is wholly straight, so there is always a plane

_SPINE, _CHEST, _NECK, _HEAD = ROW["Spine"], ROW["Chest"], ROW["Neck"], ROW["Head"]
# Where each side's begin; their other bones follow in order.
_ARMS = ROW["LeftShoulder"], ROW["RightShoulder"]
_LEGS = ROW["LeftUpperLeg"], ROW["RightUpperLeg"]


@compiled("void(f8[::1], f8[:,::1])")
def rest_pose(build: Array, rest: Array) -> None:
    """Writes each joint's place from its parent's in the rest pose (B, 3), metres; the hips' from
    the floor. build: `Proportions.values`.
    """
    upper_arm, forearm, thigh, shank = build[0], build[1], build[2], build[3]
    put(rest, 0, (0.0, 0.0, thigh + shank + _SOLE))
    put(rest, _SPINE, (build[7], build[8], build[9]))
    put(rest, _CHEST, (0.0, 0.0, build[10]))
    put(rest, _NECK, (build[11], build[12], build[13]))
    put(rest, _HEAD, (0.0, 0.2 * _RISE * build[14], _RISE * build[14]))
    for side in range(2):
        out = 2.0 * side - 1.0
        put(rest, _ARMS[side], (out * build[15], build[16], build[17]))
        put(rest, _ARMS[side] + 1, (out * build[18], build[19], build[20]))
        put(rest, _ARMS[side] + 2, (out * upper_arm, 0.0, 0.0))
        put(rest, _ARMS[side] + 3, (out * forearm, 0.0, 0.0))
        put(rest, _LEGS[side], (out * build[4], build[5], build[6]))
        put(rest, _LEGS[side] + 1, (0.0, 0.0, -thigh))
        put(rest, _LEGS[side] + 2, (0.0, 0.0, -shank))


@inlined
def _upright(up: Vector, right: Vector) -> Axes:
    """The rotation whose z is `up` and whose x is near `right`."""
    x = unit(across(right, up))
    return x, cross(up, x), up


@inlined
def _arm(out: float, along: Vector, hinge: Vector) -> Axes:
    """An arm's bone that points along and bends about the hinge, both unit vectors."""
    return times(out, along), cross(along, hinge), times(-out, hinge)


@inlined
def _leg(along: Vector, hinge: Vector) -> Axes:
    """A leg's bone, likewise."""
    return hinge, cross(hinge, along), times(-1.0, along)


@inlined
def _limb(
    root: Vector, end: Vector, bend: Vector, upper: float, lower: float
) -> tuple[Vector, Vector, Vector]:
    """Middle joint, end and hinge of a limb whose bones are so long. An end that cannot be reached
    is approached as far as the limb goes.
    """
    way = minus(end, root)
    distance = length(way)
    toward = times(1.0 / max(distance, 1e-9), way)
    side = unit(across(bend, toward))
    distance = min(max(distance, abs(upper - lower) + 1e-3), _REACH * (upper + lower))
    along = (upper * upper - lower * lower + distance * distance) / (2.0 * distance)
    off = math.sqrt(max(upper * upper - along * along, 0.0))
    middle = plus(root, plus(times(along, toward), times(off, side)))
    return middle, plus(root, times(distance, toward)), cross(toward, side)


@inlined
def _reaching(hips: Vector, pelvis: Axes, rest: Array, limbs: Array) -> Vector:
    """The hips, moved so that both legs reach their feet: an error of millimetres is seen in a foot
    that slides and not in the hips.
    """
    for _ in range(2):
        moved, short = (0.0, 0.0, 0.0), 0
        for side in range(2):
            leg = _LEGS[side]
            root = plus(hips, turned(pelvis, at(rest, leg)))
            way = minus(at(limbs[2 + side], 2), root)
            distance = length(way)
            over = distance + _REACH * (rest[leg + 1, 2] + rest[leg + 2, 2])  # both point down
            if over > 0.0:
                moved = plus(moved, times(over / max(distance, 1e-9), way))
                short += 1
        hips = plus(hips, times(1.0 / max(short, 1), moved))
    return hips


@compiled(
    "void(i8[::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1],"
    "f8[:,::1], f8[:,::1], f8[:,:,::1], f4[:,::1], f4[:,::1], f4[:,::1])"
)
def place(
    parents: npt.NDArray[np.int64],
    axes: Array,
    trunk: Array,
    centre: Array,
    limbs: Array,
    hands: Array,
    feet: Array,
    rest: Array,
    joints: Array,
    turns: Array,
    shown_joints: Floats,
    rotations: Floats,
    local: Floats,
) -> None:
    """Writes the three of a `Posture` that have these names.

    parents: the skeleton's PARENTS, which a cache would not see change if it were not given. axes,
    centre, limbs: a `Body`'s. trunk, hands, feet: its `Landmarks`'. rest: by `rest_pose`.
    joints: (B, 3) and turns: (B, 3, 3), axes as rows, are to work with.
    """
    pelvis, chest, head = axes_at(axes[0]), axes_at(axes[1]), axes_at(axes[2])
    hips = _reaching(at(centre, 0), pelvis, rest, limbs)
    waist = plus(hips, turned(pelvis, at(rest, _SPINE)))
    spine = unit(minus(at(trunk, 1), waist))
    thorax = plus(waist, times(rest[_CHEST, 2], spine))
    throat = plus(thorax, turned(chest, at(rest, _NECK)))
    neck = unit(minus(at(centre, 1), throat))
    put(joints, 0, hips)
    put(joints, _SPINE, waist)
    put(joints, _CHEST, thorax)
    put(joints, _NECK, throat)
    put(joints, _HEAD, plus(throat, times(length(at(rest, _HEAD)), neck)))
    put_axes(turns[0], pelvis)
    put_axes(turns[_SPINE], _upright(spine, plus(pelvis[0], chest[0])))
    put_axes(turns[_CHEST], chest)
    # It leans forward in the rest pose.
    put_axes(turns[_NECK], lowered(_upright(neck, plus(chest[0], head[0])), -0.2 * _RISE))
    put_axes(turns[_HEAD], head)

    for side in range(2):
        out = 2.0 * side - 1.0
        bone = _ARMS[side]
        clavicle = plus(thorax, turned(chest, at(rest, bone)))
        usual, far = turned(chest, at(rest, bone + 1)), length(at(rest, bone + 1))
        toward = unit(minus(at(limbs[side], 0), clavicle))
        start = times(1.0 / far, usual)
        root = plus(clavicle, times(far, toward))
        upper, lower = abs(rest[bone + 2, 0]), abs(rest[bone + 3, 0])
        elbow, wrist, hinge = _limb(root, at(limbs[side], 2), at(limbs[side], 3), upper, lower)
        put(joints, bone, clavicle)
        put(joints, bone + 1, root)
        put(joints, bone + 2, elbow)
        put(joints, bone + 3, wrist)
        for axis in range(3):
            put(turns[bone], axis, carried(chest[axis], start, toward))
        put_axes(turns[bone + 1], _arm(out, times(1.0 / upper, minus(elbow, root)), hinge))
        # Forearms and hands are turned by the wrist's two markers, palms down in the rest pose.
        thumb = at(hands[side], 0)
        forearm, hand = unit(minus(wrist, elbow)), unit(at(hands[side], 1))
        put_axes(turns[bone + 2], _arm(out, forearm, unit(cross(thumb, forearm))))
        put_axes(turns[bone + 3], _arm(out, hand, unit(cross(thumb, hand))))

    for side in range(2):
        bone, limb = _LEGS[side], limbs[2 + side]
        root = plus(hips, turned(pelvis, at(rest, bone)))
        upper, lower = -rest[bone + 1, 2], -rest[bone + 2, 2]
        knee, ankle, hinge = _limb(root, at(limb, 2), at(limb, 3), upper, lower)
        put(joints, bone, root)
        put(joints, bone + 1, knee)
        put(joints, bone + 2, ankle)
        shank = _leg(times(1.0 / lower, minus(ankle, knee)), hinge)
        put_axes(turns[bone], _leg(times(1.0 / upper, minus(knee, root)), hinge))
        put_axes(turns[bone + 1], shank)
        # A foot points from heel to toe; from side to side it is turned as its markers and the
        # shank have it, half each.
        forward = unit(at(feet[side], 0))
        right = unit(across(times(2.0 * side - 1.0, at(feet[side], 1)), forward))
        right = unit(across(plus(right, shank[0]), forward))
        put_axes(turns[bone + 2], lowered((right, forward, cross(right, forward)), _FEET))

    for bone in range(len(joints)):
        turn, parent = axes_at(turns[bone]), parents[bone]
        put_turn(rotations, bone, quaternion(turn))
        if parent >= 0:
            above = axes_at(turns[parent])
            turn = seen_in(above, turn[0]), seen_in(above, turn[1]), seen_in(above, turn[2])
        put_turn(local, bone, quaternion(turn))
        put(shown_joints, bone, at(joints, bone))


@compiled("void(f4[::1], i8[:,::1], f4[::1])")
def bone_sigma(markers: Floats, told_by: npt.NDArray[np.int64], sigma: Floats) -> None:
    """Writes the sigma of bones (B,) from that of the markers (M,) that tell them: the rows
    `told_by` (B, 4), of which negative ones are none.
    """
    for bone in range(len(told_by)):
        total, count = 0.0, 0
        for marker in told_by[bone]:
            if marker >= 0:
                total += float(markers[marker]) ** 2
                count += 1
        sigma[bone] = math.sqrt(total / count)
