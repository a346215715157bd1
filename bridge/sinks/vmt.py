"""SteamVR through Virtual Motion Tracker: `vmt://127.0.0.1:39570`.

    /VMT/Room/Unity  i index, i 1 (a tracker) or 0 (off), f time offset (0), f f f metres,
                     f f f f quaternion x, y, z, w; in Unity's space, in SteamVR's room

As on gpsnmeajp.github.io/VirtualMotionTrackerDocument/api. The indices are VRChat's numbers, 0 the
head, 9 and 10 the hands. Trackers are switched off when there is no pose, and at the end.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

import numpy as np

from bridge.pose import Pose
from bridge.sinks.bundles import Selection, Template, template
from bridge.sinks.engine import EngineSink, Placing, Profile
from bridge.sinks.sink import SinkContext
from bridge.sinks.trackers import TRACKERS, BodyTrackers, parse_trackers
from drivers.coordinates import FRAMES
from drivers.url import Url

LAST = 57  # VMT's last index
_NUMBERS = list(TRACKERS)


class VmtSink(EngineSink):
    """Eleven trackers. Options: `trackers` (some of them), `index` (of number 0)."""

    profile = Profile(39570, 250.0, FRAMES["unity"])
    wants_posture = True

    def __init__(self, url: Url, context: SinkContext) -> None:
        numbers = url.take("trackers", _NUMBERS, parse_trackers(_NUMBERS))
        first = url.take("index", 0, _parse_index)
        super().__init__(url, context)
        self._trackers = BodyTrackers(numbers, self.caution)
        on, off = ([_message(first + number, enable) for number in numbers] for enable in (1, 0))
        self._packets = Selection([], on, self._out.limit, hidden=off)
        self._placing = Placing(self.profile.frame)
        self._none = np.zeros(len(numbers), bool)
        self._is_on = False

    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        if not self._is_known(pose):
            return self._switched_off()
        xyz, turns, shown = self._trackers(pose)
        self._placing.write(xyz, turns, self._packets.rows)
        self._is_on = True
        return self._packets.filled(shown)

    def _switched_off(self) -> Iterable[bytes | bytearray]:
        """Nothing before the first pose: a tracker that SteamVR never saw stays unknown."""
        return self._packets.filled(self._none) if self._is_on else ()

    def close(self) -> None:
        with suppress(OSError):  # nobody is there to be told
            for datagram in self._switched_off():
                self._out.send(datagram)
        self._is_on = False
        super().close()


def _message(index: int, enable: int) -> Template:
    return template("/VMT/Room/Unity", ("i", index), ("i", enable), ("f", 0.0), floats=7)


def _parse_index(text: str) -> int:
    most = LAST - _NUMBERS[-1]
    if not (text.isdecimal() and int(text) <= most):
        raise ValueError(f"a whole number from 0 to {most}: VMT has {LAST + 1} trackers")
    return int(text)
