"""What a pose shows of a body: how it is turned, where its limbs are, how it is built."""

from __future__ import annotations

import math

import numpy as np

from bridge.compiled import compiled, inlined
from bridge.humanoid.landmarks import Landmarks
from bridge.humanoid.proportions import COUNT, Measuring, Proportions
from bridge.vectors import (
    Array,
    Vector,
    across,
    at,
    axes_at,
    carried,
    cross,
    dot,
    length,
    lowered,
    minus,
    plus,
    put,
    put_axes,
    seen_in,
    times,
    turned,
    unit,
)
from drivers.frame import Floats

_HEAD = (0.0, -0.01, -0.09)  # m: from the headband's middle to the head's joint
_ANKLE = 0.045  # m: from the ankle's middle to its marker
_UPRIGHT = 0.92  # cosine to the vertical: less of pelvis or chest tells nothing of how they stand
_UP = (0.0, 0.0, 1.0)
_ELBOW, _KNEE = 0.042, 0.056  # m: from the joint to its marker
_STRAIGHT = 0.04  # m: a joint nearer its limb's line tells less of the plane than the trunk does
# Cosine of how far the plane may turn from what is natural: a knee never points backwards, while
# an upper arm turns about itself by more than a right angle.
_FARTHEST_ARM, _FARTHEST_LEG = -0.5, 0.1


class Body:
    """What the last pose's landmarks tell of one who is built in some way.

    axes: (3, 3, 3) of pelvis, chest and head, level in one who stands upright; rows right, forward,
    up. centre: (2, 3), the joints of hips and head. limbs: (4, 4, 3) of arms and legs (left and
    right), each where it begins, where its elbow or knee is, where it ends, and which way it bends:
    a unit vector across the line from the first to the last.
    """

    def __init__(self, labels: tuple[str, ...]) -> None:
        self.seen = Landmarks(labels)
        self.axes = np.empty((3, 3, 3))
        self.centre = np.empty((2, 3))
        self.limbs = np.empty((4, 4, 3))
        self._outsides = np.empty((2, 3))
        self._shown = np.empty(COUNT)

    def see(self, xyz: Floats, build: Proportions, news: float = 1.0) -> bool:
        """Takes in a pose (41, 3); False where it lacks a marker.

        news: the share by which what is outside of the feet follows this pose.
        """
        seen = self.seen
        if not seen.find(xyz):
            return False
        _see(
            *(seen.axes, seen.trunk, seen.limbs, seen.feet, build.level, news),
            *(self._outsides, self.axes, self.centre, self.limbs),
        )
        return True

    def shows(self) -> Array:
        """What it shows of the performer's `Proportions.values`; NaN where it shows nothing.
        Overwritten by the next call.
        """
        seen = self.seen
        _show(
            *(seen.axes, seen.trunk, seen.clavicles),
            *(self.axes, self.centre, self.limbs, self._shown),
        )
        return self._shown


def measured(labels: tuple[str, ...], xyz: Floats) -> Proportions:
    """The proportions of the performer of poses (N, 41, 3) without a missing marker."""
    body = Body(labels)
    build = Measuring().mean
    for _ in range(2):  # all else is measured in axes that are level
        shown = np.array([body.shows().copy() for pose in xyz if body.see(pose, build)])
        told = np.isfinite(shown).any(axis=0)
        build.values[told] = np.nanmean(shown[:, told], axis=0)
    return build


@inlined
def _bend(
    toward: Vector, off: Vector, along: Vector, bend: Vector, half: float, side: float, least: float
) -> Vector:
    """Which way an elbow or a knee goes off its limb's line, by the marker on its outside.

    toward: along the limb. off: the marker from the line. along, bend: where the trunk has the limb
    point and bend in the rest pose. half: from the joint to its marker, metres. side: the sign of
    the cross product of where the joint goes and where its marker is. least: a cosine.
    """
    far = length(off)
    sideways = times(1.0 / max(far, 1e-9), off)
    # The marker is half a width from the joint at right angles to the plane, so the joint as far
    # off the line as is left of the marker's distance (the chord function of Davis et al. 1991).
    cosine = min(half, far) / max(far, 1e-9)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    told = minus(times(sine, sideways), times(side * cosine, cross(toward, sideways)))
    # As if the limb had come here from the rest pose by the shortest turn.
    natural = carried(bend, along, toward)
    found = unit(plus(times(far, told), times(_STRAIGHT, natural)))
    return unit(plus(found, times(max(least - dot(found, natural), 0.0), natural)))


@compiled(
    "void(f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[::1], f8,"
    "f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1])"
)
def _see(
    as_they_lie: Array,
    trunk: Array,
    seen: Array,
    feet: Array,
    level: Array,
    news: float,
    outsides: Array,
    axes: Array,
    centre: Array,
    limbs: Array,
) -> None:
    pelvis = lowered(axes_at(as_they_lie[0]), level[0])
    chest = lowered(axes_at(as_they_lie[1]), level[1])
    head = lowered(axes_at(as_they_lie[2]), level[2])
    put_axes(axes[0], pelvis)
    put_axes(axes[1], chest)
    put_axes(axes[2], head)
    put(centre, 0, times(0.5, plus(at(seen[2], 0), at(seen[3], 0))))
    put(centre, 1, plus(at(trunk, 3), turned(head, _HEAD)))
    for limb in range(4):
        is_arm = limb < 2
        out = 2.0 * (limb % 2) - 1.0
        root, marker, end = at(seen[limb], 0), at(seen[limb], 1), at(seen[limb], 2)
        toward = unit(minus(end, root))
        off = across(minus(marker, root), toward)
        if is_arm:
            along, bend, side = times(out, chest[0]), times(-1.0, chest[1]), -out
            half, least = _ELBOW, _FARTHEST_ARM
        else:
            along, bend, side = times(-1.0, pelvis[2]), pelvis[1], out
            half, least = _KNEE, _FARTHEST_LEG
        bends = _bend(toward, off, along, bend, half, side, least)
        put(limbs[limb], 0, root)
        put(limbs[limb], 1, minus(marker, times(half * side, cross(toward, bends))))
        if not is_arm:
            # A foot that stands still must not move when its heel and toe seem to, so it is a
            # little late; nor when the knee does, so it is not across the knee's plane.
            foot = limb - 2
            outside = times(out, unit(cross(at(feet[foot], 0), _UP)))
            if news < 1.0:
                last = at(outsides, foot)
                outside = plus(last, times(news, minus(outside, last)))
            put(outsides, foot, outside)
            end = minus(end, times(_ANKLE, outside))
        put(limbs[limb], 2, end)
        put(limbs[limb], 3, bends)


@compiled("void(f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8[::1])")
def _show(
    as_they_lie: Array,
    trunk: Array,
    clavicles: Array,
    axes: Array,
    centre: Array,
    limbs: Array,
    shown: Array,
) -> None:
    """Writes them in the order of `Proportions`."""
    pelvis, chest = axes_at(axes[0]), axes_at(axes[1])
    waist, thorax, neck = at(trunk, 0), at(trunk, 1), at(trunk, 2)
    hips, skull = at(centre, 0), at(centre, 1)
    shown[:] = 0.0
    for limb in range(4):
        root, middle, end = at(limbs[limb], 0), at(limbs[limb], 1), at(limbs[limb], 2)
        shown[limb // 2 * 2] += 0.5 * length(minus(middle, root))
        shown[limb // 2 * 2 + 1] += 0.5 * length(minus(end, middle))
    shown[4] = 0.5 * length(minus(at(limbs[3], 0), at(limbs[2], 0)))
    _, shown[8], shown[9] = seen_in(pelvis, minus(waist, hips))
    shown[10] = length(minus(thorax, waist))
    _, shown[12], shown[13] = seen_in(chest, minus(neck, thorax))
    shown[14] = length(minus(skull, neck))
    for side in range(2):
        clavicle = at(clavicles, side)
        collar = seen_in(chest, minus(clavicle, thorax))
        arm = seen_in(chest, minus(at(limbs[side], 0), clavicle))
        for axis in range(3):
            share = 0.5
            if axis == 0 and side == 0:  # outwards, to the left
                share = -0.5
            shown[15 + axis] += share * collar[axis]
            shown[18 + axis] += share * arm[axis]
    # How far the forward axes rise, of one who stands upright. The chest's is not asked: how
    # somebody holds it is their posture.
    upright = min(as_they_lie[0, 2, 2], as_they_lie[1, 2, 2]) >= _UPRIGHT
    shown[21] = as_they_lie[0, 1, 2] if upright else math.nan
    shown[22] = math.nan
    shown[23] = as_they_lie[2, 1, 2] if upright else math.nan
