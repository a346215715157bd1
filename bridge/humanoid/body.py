"""What a pose shows of a body: how it is turned, where its limbs are, how it is built."""

from __future__ import annotations

import numpy as np

from bridge.humanoid.landmarks import LandmarkFinder, Landmarks
from bridge.humanoid.limbs import bending
from bridge.humanoid.proportions import Measuring, Proportions
from bridge.humanoid.rotations import Array, cross, length_of, unit
from drivers.frame import Floats

_HEAD = np.array([0.0, -0.01, -0.09])  # m: from the headband's middle to the head's joint
_ANKLE = 0.045  # m: from the ankle's middle to its marker
_UPRIGHT = 0.92  # cosine to the vertical: less of pelvis or chest tells nothing of how they stand
_TRUNKS = np.array([1, 1, 0, 0])  # of pelvis, chest, head: what arms and legs hang on
# x outwards, of the left and the right side.
OUT = np.array([[-1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
SIDES = OUT[:, :1]
UP = np.array([0.0, 0.0, 1.0])


class Body:
    """What a pose's landmarks tell of one who is built like this: axes (3, 3, 3) of pelvis, chest
    and head, level in one who stands upright; and of the limbs (4, 3) where they begin, which way
    they bend, where elbows and knees are, and where they end. outsides: (2, 3), of the feet.
    """

    def __init__(self, seen: Landmarks, build: Proportions, outsides: Array) -> None:
        self.seen = seen
        self.axes = seen.axes @ lowered(build.level)
        self.hips = seen.hips.mean(axis=0)
        self.skull = seen.head + self.axes[2] @ _HEAD
        self.roots = np.concatenate([seen.shoulders, seen.hips])
        self.ends = np.concatenate([seen.wrists, seen.ankles])
        self.bends, self.middles = bending(
            self.axes[_TRUNKS], self.roots, np.concatenate([seen.elbows, seen.knees]), self.ends
        )
        # Not across the plane of the knee: a foot that stands still must not move when that does.
        self.ends[2:] -= _ANKLE * outsides

    def shows(self) -> Array:
        """What it shows of the performer's `Proportions.values`; NaN where it shows nothing."""
        seen = self.seen
        pelvis, chest, _ = self.axes
        bones = length_of(np.array([self.middles - self.roots, self.ends - self.middles]))
        trunk = length_of(np.array([seen.hips[1] - seen.hips[0], seen.chest - seen.waist]))
        return np.concatenate(
            [
                bones.reshape(2, 2, 2).mean(axis=2).T.ravel(),
                [trunk[0] / 2, 0.0, 0.0],
                _sagittal((seen.waist - self.hips) @ pelvis),
                trunk[1:],
                _sagittal((seen.neck - seen.chest) @ chest),
                length_of(self.skull - seen.neck)[None],
                _outwards(seen.clavicles - seen.chest, chest),
                _outwards(seen.shoulders - seen.clavicles, chest),
                _level(seen.axes),
            ]
        )


def measured(labels: tuple[str, ...], xyz: Floats) -> Proportions:
    """The proportions of the performer of poses (N, 41, 3) without a missing marker."""
    find = LandmarkFinder(labels)
    landmarks = [find(pose) for pose in xyz]
    build = Measuring().mean
    for _ in range(2):  # all else is measured in axes that are level
        shown = np.array([Body(seen, build, outside(seen)).shows() for seen in landmarks])
        told = np.isfinite(shown).any(axis=0)
        build.values[told] = np.nanmean(shown[:, told], axis=0)
    return build


def outside(seen: Landmarks) -> Array:
    """(2, 3): what is outside of the feet, level."""
    return SIDES * unit(cross(seen.feet_forward, UP))


def lowered(rises: Array) -> Array:
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


def _sagittal(vector: Array) -> Array:
    """(3,) without what goes sideways."""
    return vector * [0.0, 1.0, 1.0]


def _outwards(pair: Array, axes: Array) -> Array:
    """(3,): the mean of vectors (2, 3) to the left and to the right, in these axes, x outwards."""
    found: Array = ((pair @ axes) * OUT).mean(axis=0)
    return found
