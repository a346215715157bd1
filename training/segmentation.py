"""Cuts a capture where its behaviour changes: probabilistic PCA (paper 3.2.2, Barbic 2004).

A Gaussian with few free directions is fitted to the frames since the last cut. While the behaviour
lasts, the frames just ahead lie well inside it, the better the more has been seen of it; their
mean Mahalanobis distance H falls. Where the behaviour changes, H climbs to a peak: there is a cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from training.ppca import Ppca, Sums


@dataclass(frozen=True, slots=True)
class Segmentation:
    """How to cut. Times in seconds.

    first: frames that a behaviour is first fitted to. ahead: frames that are judged by it. step: by
    how much the fit grows. variance: share of the variance that the free directions hold. rise: by
    what factor H must climb from its valley to its peak for a cut. floor: metres, below which
    variance across the free directions is measurement noise.
    """

    first: float = 1.0
    ahead: float = 0.75
    step: float = 1 / 12
    variance: float = 0.95
    rise: float = 3.0
    floor: float = 0.003

    def cut(self, poses: npt.NDArray[np.floating], rate: float) -> list[slice]:
        """The segments of one sequence (N, D), in order and without gaps."""
        frames = max(1, round(self.step * rate))
        blocks = _Blocks(poses, frames)
        first, ahead = (max(1, round(t * rate / frames)) for t in (self.first, self.ahead))
        cuts = [0]
        while (cut := self._next_cut(blocks, cuts[-1], first, ahead)) is not None:
            cuts.append(cut)
        edges = [cut * frames for cut in cuts] + [len(poses)]
        return [slice(a, b) for a, b in pairwise(edges)]

    def _next_cut(self, blocks: _Blocks, start: int, first: int, ahead: int) -> int | None:
        """The block where the behaviour that starts at block `start` ends; None: it does not."""
        valley, peak, at = np.inf, 0.0, 0
        now = start + first
        if now + ahead > len(blocks):
            return None
        fitted, coming = blocks.between(start, now), blocks.between(now, now + ahead)
        while True:
            distance = Ppca.of(fitted, self.variance, self.floor).distance(coming)
            if distance > peak and distance > self.rise * valley:
                peak, at = distance, now
            elif peak:
                # Past the peak. What comes next must be long enough to be fitted itself.
                return at if len(blocks) - at >= first else None
            valley = min(valley, distance)
            if now + ahead == len(blocks):
                return None
            # The window moves on by a block: no pass over all frames so far.
            passed = blocks.between(now, now + 1)
            fitted += passed
            coming += blocks.between(now + ahead, now + ahead + 1) - passed
            now += 1


class _Blocks:
    """A sequence (N, D) in blocks of some frames; what is left over at its end is left out."""

    def __init__(self, poses: npt.NDArray[np.floating], frames: int) -> None:
        self._poses, self._frames = poses, frames

    def __len__(self) -> int:
        return len(self._poses) // self._frames

    def between(self, start: int, end: int) -> Sums:
        return Sums.of(self._poses[start * self._frames : end * self._frames])
