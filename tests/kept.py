"""A sink that keeps all poses, for tests to look at."""

from __future__ import annotations

from bridge.pose import Pose
from bridge.sinks.sink import Sink


class Keep(Sink):
    """Keeps every pose it is given."""

    name = "keep"
    waiting = None

    def __init__(self) -> None:
        self.poses: list[Pose] = []

    def __call__(self, pose: Pose) -> None:
        self.poses.append(pose)

    def close(self) -> None:
        pass
