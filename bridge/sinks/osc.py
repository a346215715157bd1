"""Our own pose stream over OSC: `osc://127.0.0.1:9200` (docs/wires.md).

A message a frame, and the layout first and once a second; metres and our axes, unless the address
says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bridge.pose import Pose
from bridge.sinks.engine import Profile
from bridge.sinks.markers import MarkerSink
from bridge.sinks.pose_message import PoseMessages
from bridge.sinks.sink import SinkContext
from drivers.coordinates import OURS
from drivers.url import Url

LAYOUT_EVERY = 1.0  # s


class OscSink(MarkerSink):
    """All markers of each pose with provenance and sigma, one message a frame."""

    profile = Profile(9200, 0.0, OURS)
    one_body = False

    def __init__(self, url: Url, context: SinkContext) -> None:
        super().__init__(url, context)
        self._context = context
        unit = self._convention.frame.unit
        self._messages = PoseMessages(self._layout, unit, context.performer)
        self._layout_due = -np.inf

    def _datagrams(self, pose: Pose) -> Iterator[bytes]:
        if pose.t >= self._layout_due:
            yield self._messages.layout(self._context.rate)
            self._layout_due = pose.t + LAYOUT_EVERY
        yield self._messages.pose(pose, self._seconds(pose), self._xyz(pose))
