"""What an engine is shown of what nobody is sure of: as it is, faded, hidden, or held.

Sure is what has a sigma (of a bone, a marker, a tracker) up to the threshold. What comes into doubt
fades, or is held, over 0.3 s of the poses' own time, and comes back likewise; it comes back only
when its sigma is well below the threshold, so nothing flickers there. The hips, on which all the
rest hangs, never fade: they are held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled, inlined
from bridge.humanoid.skeleton import BONES, PARENTS, Posture
from bridge.vectors import (
    Array,
    Quaternion,
    Vector,
    after,
    at,
    blended,
    minus,
    opposite,
    plus,
    put,
    put_turn,
    spun,
    times,
    turn_at,
)
from drivers.frame import Floats

BLEND = 0.3  # s from shown as it is to wholly faded or held, and back
CERTAIN = 0.8  # of the threshold: what is in doubt is sure again below that

Mask = npt.NDArray[np.bool_]

_REST = (0.0, 0.0, 0.0, 1.0)  # no rotation
_UNTURNED = np.array([_REST], np.float32)


class Policy(StrEnum):
    """What becomes of what is in doubt."""

    SHOW = "show"
    FADE = "fade"  # to the rest pose
    HIDE = "hide"
    HOLD = "hold"  # as it was when it was sure


@dataclass(frozen=True, slots=True)
class Caution:
    """A policy, and the sigma in metres above which it holds."""

    policy: Policy = Policy.SHOW
    threshold: float = 0.08

    @property
    def moves(self) -> bool:
        """Whether what is in doubt is shown elsewhere: then even a lost pose can be shown."""
        return self.policy in (Policy.FADE, Policy.HOLD)


class Doubt:
    """How far each of some things is in doubt, from 0 to 1. `doubted`: which of them are."""

    def __init__(self, threshold: float, count: int) -> None:
        self._threshold = threshold
        self._t = math.inf
        self._share = np.full(count, np.nan)
        self.doubted: Mask = np.zeros(count, bool)

    def step(self, t: float, sigma: Floats) -> Array:
        """The shares (N,) at a pose's time; what is in doubt at the first is so wholly.
        Overwritten by the next call.
        """
        step = max(0.0, t - self._t) / BLEND
        self._t = t
        _step(sigma, self._threshold, step, self._share, self.doubted)
        return self._share


class ShownBones(NamedTuple):
    """hips: (3,) metres, world. local: (B, 4), as a Posture's. shown: (B,)."""

    hips: Floats
    local: Floats
    shown: Mask


class Bones:
    """The humanoid's bones under a policy: they fade to no rotation against their parent."""

    def __init__(self, caution: Caution) -> None:
        self._policy = caution.policy
        self._doubt = Doubt(caution.threshold, len(BONES))
        self._all = np.ones(len(BONES), bool)
        self._hips = np.full((1, 3), np.nan, np.float32)  # as they last were surely
        self._kept = np.tile(_UNTURNED, (len(BONES), 1))  # what doubt leads to

    def __call__(self, t: float, posture: Posture) -> ShownBones:
        if self._policy is Policy.SHOW:
            return ShownBones(posture.joints[0], posture.local, self._all)
        hips, local = np.empty_like(posture.joints[:1]), np.empty_like(posture.local)
        _lead(
            self._policy is Policy.HOLD,
            *(posture.joints, posture.local, self._doubt.step(t, posture.sigma)),
            *(self._hips, self._kept, hips, local),
        )
        shown = self._all
        if self._policy is Policy.HIDE:
            local[1:] = posture.local[1:]
            shown = ~self._doubt.doubted
            shown[0] = True
        return ShownBones(hips[0], local, shown)


class ShownPoints(NamedTuple):
    """xyz: (N, 3) metres, world. turns: (N, 4), world; without a posture none. shown: (N,)."""

    xyz: Floats
    turns: Floats
    shown: Mask


class Points:
    """Markers or trackers under a policy. Each sits on a bone and turns with it.

    What fades goes to its place in the rest pose, with the hips as they are now: on its bone it is
    where it last was surely. What is held stays where it last was surely against the hips; what was
    never sure is where it would fade to.
    """

    def __init__(self, caution: Caution, bones: list[int]) -> None:
        count = len(bones)
        self._policy = caution.policy
        self._moves = caution.moves
        self._bones = np.array(bones, np.int64)
        self._doubt = Doubt(caution.threshold, count)
        self._doubt_of_hips = Doubt(caution.threshold, 1)
        self._all = np.ones(count, bool)
        self._unturned = np.tile(_UNTURNED, (count, 1))
        # As they last were surely: the hips; on their bones; in the hips' axes, and turned so.
        self._hips = np.full((1, 3), np.nan, np.float32)
        self._turn = _UNTURNED.copy()
        self._on_bone = np.full((count, 3), np.nan, np.float32)
        self._places = np.full((count, 3), np.nan, np.float32)
        self._turns = self._unturned.copy()
        self._joints = np.zeros((len(BONES), 3), np.float32)  # from the hips in the rest pose

    def __call__(
        self, t: float, xyz: Floats, sigma: Floats, posture: Posture | None
    ) -> ShownPoints:
        turns = self._unturned if posture is None else posture.rotations.take(self._bones, 0)
        if self._policy is Policy.HIDE:
            self._doubt.step(t, sigma)
            return ShownPoints(xyz, turns, ~self._doubt.doubted)
        if posture is None or not self._moves:
            return ShownPoints(xyz, turns, self._all)
        shown_xyz, shown_turns = np.empty(xyz.shape, np.float32), np.empty_like(turns)
        _move(
            self._policy is Policy.HOLD,
            PARENTS,
            *(xyz, turns, self._bones, posture.joints, posture.rotations, posture.rest),
            *(self._doubt_of_hips.step(t, posture.sigma[:1]), self._doubt.step(t, sigma)),
            *(self._hips, self._turn, self._on_bone, self._places, self._turns, self._joints),
            *(shown_xyz, shown_turns),
        )
        return ShownPoints(shown_xyz, shown_turns, self._all)


@compiled("void(f4[:], f8, f8, f8[::1], b1[::1])")
def _step(sigma: Floats, threshold: float, step: float, share: Array, doubted: Mask) -> None:
    for i in range(len(share)):
        bound = CERTAIN * threshold if doubted[i] else threshold
        doubted[i] = not sigma[i] <= bound  # a NaN is in doubt
        if math.isnan(share[i]):
            share[i] = 1.0 if doubted[i] else 0.0
        elif doubted[i]:
            share[i] = min(share[i] + step, 1.0)
        else:
            share[i] = max(share[i] - step, 0.0)


@inlined
def _held(
    joints: Floats, rotations: Floats, share: float, hips: Floats, turn: Floats
) -> tuple[Vector, Quaternion]:
    """Place and rotation of the hips, held while they are in doubt. hips, turn: as they last were
    surely, in the first row.
    """
    if share == 0.0 or math.isnan(hips[0, 0]):
        hips[0] = joints[0]
        turn[0] = rotations[0]
    now = at(joints, 0)
    place = plus(now, times(share, minus(at(hips, 0), now)))
    return place, blended(turn_at(rotations, 0), turn_at(turn, 0), share)


@compiled("void(b1, f4[:,::1], f4[:,::1], f8[::1], f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1])")
def _lead(
    holds: bool,
    joints: Floats,
    local: Floats,
    share: Array,
    hips: Floats,
    kept: Floats,
    shown_hips: Floats,
    shown_local: Floats,
) -> None:
    """Bones on their way to where doubt leads them; the hips are always held."""
    place, turn = _held(joints, local, share[0], hips, kept)
    put(shown_hips, 0, place)
    put_turn(shown_local, 0, turn)
    for bone in range(1, len(local)):
        now = turn_at(local, bone)
        if holds and share[bone] == 0.0:
            put_turn(kept, bone, now)
        put_turn(shown_local, bone, blended(now, turn_at(kept, bone), share[bone]))


@compiled(
    "void(b1, i8[::1], f4[:,:], f4[:,::1], i8[::1], f4[:,::1], f4[:,::1], f4[:,::1], f8[::1],"
    "f8[::1], f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1], f4[:,::1],"
    "f4[:,::1])"
)
def _move(
    holds: bool,
    parents: npt.NDArray[np.int64],
    xyz: Floats,
    turns: Floats,
    bones: npt.NDArray[np.int64],
    joints: Floats,
    rotations: Floats,
    rest: Floats,
    share_of_hips: Array,
    share: Array,
    hips: Floats,
    turn_of_hips: Floats,
    on_bone: Floats,
    places: Floats,
    kept_turns: Floats,
    from_hips: Floats,
    shown_xyz: Floats,
    shown_turns: Floats,
) -> None:
    """Points on their way to where doubt leads them; what is sure is taken in."""
    origin, turn = _held(joints, rotations, share_of_hips[0], hips, turn_of_hips)
    for bone in range(1, len(rest)):
        put(from_hips, bone, plus(at(from_hips, parents[bone]), at(rest, bone)))
    for i in range(len(xyz)):
        bone, place, now = bones[i], at(xyz, i), turn_at(turns, i)
        sure = share[i] == 0.0
        if sure or math.isnan(on_bone[i, 0]):
            back = opposite(turn_at(rotations, bone))
            put(on_bone, i, spun(back, minus(place, at(joints, bone))))
        goal, goal_turn = plus(at(from_hips, bone), at(on_bone, i)), _REST
        if holds:
            if sure:
                put(places, i, spun(opposite(turn), minus(place, origin)))
                put_turn(kept_turns, i, after(opposite(turn), now))
            if not math.isnan(places[i, 0]):
                goal = at(places, i)
            goal_turn = turn_at(kept_turns, i)
        way = minus(plus(origin, spun(turn, goal)), place)
        put(shown_xyz, i, plus(place, times(share[i], way)))
        put_turn(shown_turns, i, blended(now, after(turn, goal_turn), share[i]))
