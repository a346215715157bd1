"""A frame that is taken through for nothing, shortly before the next is due."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bridge.estimator import PoseEstimator
from bridge.model import Model
from drivers.frame import MarkerFrame

if TYPE_CHECKING:
    from bridge.humanoid.solver import HumanoidSolver

LEAD = 0.001  # s before the next frame is due; a rehearsal is over in half of that
SHORTEST = 0.003  # s between frames: what comes faster needs none


class Rehearsal:
    """Takes frames through an estimator and a humanoid of its own, and leaves no trace.

    Between two frames a thread sleeps for milliseconds, and the core's caches go to whatever else
    runs there: then code and weights come from memory, and a frame takes six times as long as in a
    loop (docs/decisions/0031-rehearsal.md).
    """

    def __init__(self, model: Model, humanoid: HumanoidSolver | None) -> None:
        self._estimator = PoseEstimator(model)
        self._humanoid = humanoid
        self._index = 0

    def __call__(self, frame: MarkerFrame) -> None:
        """Once through, with a frame that looks like the next."""
        self._index += 1
        pose = self._estimator.step(replace(frame, index=self._index))
        if self._humanoid:
            self._humanoid.solve(pose)
