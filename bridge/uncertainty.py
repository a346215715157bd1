"""What an engine is shown of what nobody is sure of: as it is, faded, hidden, or held.

Sure is what has a sigma (of a bone, a marker, a tracker) up to the threshold. What comes into doubt
fades, or is held, over 0.3 s of the poses' own time, and comes back likewise; it comes back only
when its sigma is well below the threshold, so nothing flickers there. The hips, on which all the
rest hangs, never fade: they are held.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.humanoid.rotations import Array, dot, matrices, unit
from bridge.humanoid.skeleton import BONES, PARENTS, Posture
from drivers.frame import Floats

BLEND = 0.3  # s from shown as it is to wholly faded or held, and back
CERTAIN = 0.8  # of the threshold: what is in doubt is sure again below that

Mask = npt.NDArray[np.bool_]

_REST = np.array([0.0, 0.0, 0.0, 1.0])  # no rotation


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

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._t = 0.0
        self._share: Array | None = None
        self.doubted: Mask = np.zeros(0, bool)

    def step(self, t: float, sigma: Floats) -> Array:
        """The shares (N,) at a pose's time; what is in doubt at the first is so wholly."""
        if self._share is None:
            self.doubted = ~(sigma <= self._threshold)
            self._share = self.doubted.astype(float)
        else:
            bound = np.where(self.doubted, CERTAIN * self._threshold, self._threshold)
            self.doubted = ~(sigma <= bound)  # a NaN is in doubt
            step = max(0.0, t - self._t) / BLEND
            self._share = np.clip(self._share + np.where(self.doubted, step, -step), 0.0, 1.0)
        self._t = t
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
        self._hips = _Hips(caution.threshold)
        self._doubt = Doubt(caution.threshold)
        self._kept = np.tile(_REST, (len(BONES), 1))
        self._all = np.ones(len(BONES), bool)

    def __call__(self, t: float, posture: Posture) -> ShownBones:
        if self._policy is Policy.SHOW:
            return ShownBones(posture.joints[0], posture.local, self._all)
        hips, turn = self._hips(t, posture)
        share = self._doubt.step(t, posture.sigma)
        local, shown = posture.local.astype(float), self._all
        if self._policy is Policy.HIDE:
            shown = ~self._doubt.doubted
            shown[0] = True
        elif self._policy is Policy.FADE:
            local = _blended(local, _REST, share[:, None])
        else:
            self._kept[share == 0] = local[share == 0]
            local = _blended(local, self._kept, share[:, None])
        local[0] = turn
        return ShownBones(hips.astype(np.float32), local.astype(np.float32), shown)


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
        self._policy = caution.policy
        self._moves = caution.moves
        self._bones = bones
        self._hips = _Hips(caution.threshold)
        self._doubt = Doubt(caution.threshold)
        self._all = np.ones(len(bones), bool)
        self._unturned = np.tile(_REST.astype(np.float32), (len(bones), 1))
        # As they last were surely: on their bones, and in the hips' axes.
        self._on_bone: Array | None = None
        self._place = np.full((len(bones), 3), np.nan)
        self._turn = np.tile(_REST, (len(bones), 1))

    def __call__(
        self, t: float, xyz: Floats, sigma: Floats, posture: Posture | None
    ) -> ShownPoints:
        turns = self._unturned if posture is None else posture.rotations[self._bones]
        if self._policy is Policy.HIDE:
            self._doubt.step(t, sigma)
            return ShownPoints(xyz, turns, ~self._doubt.doubted)
        if posture is None or not self._moves:
            return ShownPoints(xyz, turns, self._all)
        hips, turn = self._hips(t, posture)
        share = self._doubt.step(t, sigma)[:, None]
        places, rotations = self._kept(xyz, turns, share[:, 0] == 0, posture, hips, turn)
        xyz = (xyz + share * (hips + places @ matrices(turn).T - xyz)).astype(np.float32)
        turned = _blended(turns.astype(float), _product(turn, rotations), share)
        return ShownPoints(xyz, turned.astype(np.float32), self._all)

    def _kept(
        self,
        xyz: Floats,
        turns: Floats,
        sure: Mask,
        posture: Posture,
        hips: Array,
        turn: Array,
    ) -> tuple[Array, Array]:
        """Where they are to go, in the hips' axes, and how turned; takes in what is sure now."""
        axes = matrices(posture.rotations.astype(float))[self._bones]
        on_bone = np.einsum("nji,nj->ni", axes, xyz - posture.joints[self._bones])
        if self._on_bone is None:
            self._on_bone = on_bone
        self._on_bone[sure] = on_bone[sure]
        rest = (_FROM_HIPS @ posture.rest)[self._bones] + self._on_bone
        if self._policy is Policy.FADE:
            return rest, np.broadcast_to(_REST, turns.shape)
        self._place[sure] = ((xyz - hips) @ matrices(turn))[sure]
        self._turn[sure] = _product(turn * [-1, -1, -1, 1], turns.astype(float))[sure]
        return np.where(np.isnan(self._place), rest, self._place), self._turn


class _Hips:
    """Place (3,) and rotation (4,) of the hips, held while they are in doubt."""

    def __init__(self, threshold: float) -> None:
        self._doubt = Doubt(threshold)
        self._kept: tuple[Array, Array] | None = None

    def __call__(self, t: float, posture: Posture) -> tuple[Array, Array]:
        share = self._doubt.step(t, posture.sigma[:1])
        now = posture.joints[0].astype(float), posture.rotations[0].astype(float)
        if self._kept is None or share[0] == 0:
            self._kept = now
        place, turn = self._kept
        return now[0] + share * (place - now[0]), _blended(now[1], turn, share)


def _blended(start: Array, end: Array, share: Array) -> Array:
    """Unit quaternions (..., 4) a share of the way to others, the shorter way round."""
    same = dot(start, end) >= 0
    return unit(start + share * (np.where(same, end, -end) - start))


def _product(first: Array, second: Array) -> Array:
    """The rotation (4,) applied after the rotations (..., 4)."""
    x, y, z, w = first
    left = np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])
    found: Array = second @ left.T
    return found


def _from_hips() -> Array:
    """(B, B): which bones' `rest` lead from the hips to each joint."""
    paths = np.zeros((len(BONES), len(BONES)))
    for row in range(1, len(BONES)):
        paths[row] = paths[PARENTS[row]]
        paths[row, row] = 1.0
    return paths


_FROM_HIPS = _from_hips()
