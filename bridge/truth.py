"""The true pose, where a simulator sends it: for meter and view, never for the estimator."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from drivers.frame import Floats, Source

AT_ONCE = 64  # frames taken in per frame estimated: a flood must not hold the session up
KEPT = 1024  # poses: as long as any sink may lag behind


class Truth:
    """True poses by frame index, in the model's marker order, NaN where the capture has none."""

    def __init__(self, source: Source, labels: tuple[str, ...]) -> None:
        self.source = source
        self._labels = labels
        self._poses: OrderedDict[int, Floats] = OrderedDict()

    def receive(self) -> None:
        """Takes in what has come. The simulator sends a truth before its frame."""
        for _ in range(AT_ONCE):
            frame = self.source.read(0.0)
            if frame is None:
                return
            self._poses[frame.index] = frame.ordered(self._labels)
            if len(self._poses) > KEPT:
                self._poses.popitem(last=False)

    def at(self, index: int) -> Floats | None:
        """The true pose (M, 3) of a frame, or None."""
        return self._poses.get(index)


def rms_mm(xyz: Floats, truth: Floats) -> float:
    """Root mean squared distance over the markers (..., 3) whose truth is there, mm; else NaN."""
    squared = ((xyz - truth) ** 2).sum(axis=-1)
    there = ~np.isnan(squared)
    return float(1000 * np.sqrt(squared[there].mean())) if there.any() else float("nan")
