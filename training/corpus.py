"""What training keeps of captures: the moments of every segment, and some of its poses.

The captures are read one after the other and not kept, so memory grows by 62 kB a segment and
1,000 bytes a pose kept, not with the frames.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from joblib import Parallel, delayed

from bridge.body_frame import CONSTRUCTIONS
from drivers.errors import MarkerbridgeError
from drivers.frame import Floats, SourceError
from drivers.marker_set import MARKERS
from training.dataset import Capture, Warn, read_take, why_not
from training.moments import COORDINATES, PACKED, moments_of
from training.poses import moving_poses
from training.progress import Advance
from training.recipe import Recipe

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

MIN_FRAMES = 10  # a covariance of fewer says nothing
_FRAME_BYTES = 16 * len(MARKERS)  # of a C3D file, about: tells the work that a file is


@dataclass(frozen=True, slots=True, eq=False)
class Corpus:
    """The segments of all captures, in order, and poses of theirs in the body frame.

    captures: those that are in use, with how many frames they have and how many of them all
    markers. Per segment (S,): capture (its row), start (its first among the capture's complete
    frames), frames, seconds, and moments (S, PACKED). Per pose (P,): segment (its row); time,
    seconds from the capture's start; poses and velocities (P, 41, 3), origin (P, 3) and yaw (P,),
    see `training.poses.MovingPoses`.
    """

    captures: tuple[Capture, ...]
    frames_read: Indices
    frames_used: Indices
    capture: Indices
    start: Indices
    frames: Indices
    seconds: Array
    moments: Array
    segment: Indices
    time: Array
    poses: Floats
    velocities: Floats
    origin: Array
    yaw: Array

    def begun(self, share: float) -> Corpus:
        """The same with the poses of each real capture's first part alone, so large a share of
        them; its segments stay as they are.
        """
        capture = self.capture[self.segment]
        counts = np.bincount(capture, minlength=len(self.captures))
        number = np.arange(len(capture)) - (np.cumsum(counts) - counts)[capture]
        real = np.array([one.real for one in self.captures])
        kept = ~real[capture] | (number < share * counts[capture])
        return replace(
            self,
            segment=self.segment[kept],
            time=self.time[kept],
            poses=self.poses[kept],
            velocities=self.velocities[kept],
            origin=self.origin[kept],
            yaw=self.yaw[kept],
        )

    def without(self, names: frozenset[str]) -> Indices:
        """The segments of all captures but these."""
        kept = np.array([capture.name not in names for capture in self.captures])
        return np.flatnonzero(kept[self.capture])


@dataclass(frozen=True, slots=True, eq=False)
class _Cut:
    """What is kept of one capture."""

    read: int
    used: int
    rate: float
    parts: list[slice]
    segment: Indices
    time: Array
    poses: Floats
    velocities: Floats
    origin: Array
    yaw: Array


def work_of(folder: Path, captures: Sequence[Capture]) -> float:
    """About how many frames the files have."""
    return sum(_work(folder, capture) for capture in captures)


def read_corpus(
    folder: Path, captures: Sequence[Capture], recipe: Recipe, advance: Advance, warn: Warn
) -> Corpus:
    """Reads the captures and cuts them into segments. `work_of` them is the units of progress.

    Captures that cannot be used are left out, and `warn` is told. Raises MarkerbridgeError where
    none can.
    """
    used: list[Capture] = []
    cuts: list[_Cut] = []
    blocks: deque[Array] = deque()
    work = [_work(folder, capture) for capture in captures]
    sparse = math.ceil(sum(work) / recipe.pose_rows)
    found = Parallel(return_as="generator")(
        delayed(_cut)(folder, capture, recipe, sparse) for capture in captures
    )
    for capture, frames_of_it, result in zip(captures, work, found, strict=True):
        if isinstance(result, str):
            warn(f"left out: {result}")
        else:
            used.append(capture)
            cuts.append(result[0])
            blocks.append(result[1])
        advance(f"segments of {capture.name}", frames_of_it)
    if not cuts:
        raise MarkerbridgeError(f"{folder}: no capture has enough frames with all 41 markers")
    counts = [len(cut.parts) for cut in cuts]
    first = np.cumsum([0, *counts[:-1]])
    capture_row = np.repeat(np.arange(len(cuts)), counts)
    parts = [part for cut in cuts for part in cut.parts]
    frames = np.array([part.stop - part.start for part in parts])
    moments = np.empty((len(parts), PACKED))
    for row in first:
        one = blocks.popleft()  # freed as it is copied: they are never there twice
        moments[row : row + len(one)] = one
    return Corpus(
        captures=tuple(used),
        frames_read=np.array([cut.read for cut in cuts]),
        frames_used=np.array([cut.used for cut in cuts]),
        capture=capture_row,
        start=np.array([part.start for part in parts]),
        frames=frames,
        seconds=frames / np.array([cut.rate for cut in cuts])[capture_row],
        moments=moments,
        segment=np.concatenate([row + cut.segment for row, cut in zip(first, cuts, strict=True)]),
        time=np.concatenate([cut.time for cut in cuts]),
        poses=np.concatenate([cut.poses for cut in cuts]),
        velocities=np.concatenate([cut.velocities for cut in cuts]),
        origin=np.concatenate([cut.origin for cut in cuts]),
        yaw=np.concatenate([cut.yaw for cut in cuts]),
    )


def _cut(folder: Path, capture: Capture, recipe: Recipe, sparse: int) -> tuple[_Cut, Array] | str:
    """The segments of one capture and their moments (s, PACKED), or why it has none. Of `sparse`
    poses at most one is kept.
    """
    try:
        take = read_take(folder, capture)
    except SourceError as error:
        return why_not(folder, capture, error)
    moving = moving_poses(take.xyz, take.rate, CONSTRUCTIONS[recipe.body_frame])
    poses = moving.poses
    if len(poses) < MIN_FRAMES:
        return f"{capture.name}: fewer than {MIN_FRAMES} frames have all 41 markers"
    parts = recipe.segmentation.cut(poses.reshape(-1, COORDINATES), take.rate)
    step = max(sparse, round(recipe.pose_step * take.rate))
    kept = [np.arange(len(poses))[part][::step] for part in parts]
    rows = np.concatenate(kept)
    cut = _Cut(
        read=len(take.xyz),
        used=len(poses),
        rate=take.rate,
        parts=parts,
        segment=np.repeat(np.arange(len(parts)), [len(part) for part in kept]),
        time=moving.frame[rows] / take.rate,
        poses=poses[rows],
        velocities=moving.velocities[rows],
        origin=moving.origin[rows],
        yaw=moving.yaw[rows],
    )
    return cut, np.array([moments_of(poses[part]) for part in parts])


def _work(folder: Path, capture: Capture) -> float:
    path = folder / capture.name
    return path.stat().st_size / _FRAME_BYTES if path.is_file() else 0.0
