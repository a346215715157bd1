"""VRChat's OSC trackers: `vrchat://127.0.0.1:9000`, in Unity's space.

    /tracking/trackers/<1 to 8>/position, /rotation  f f f metres; f f f degrees
    /tracking/trackers/head/position, /rotation      f f f where the head's bone begins; f f f of
                                                     which VRChat takes the second, the yaw

As on docs.vrchat.com/docs/osc-trackers: Euler angles are applied in Unity's order, z, x, y; a metre
is a metre of the real room, so nothing is scaled here. VRChat shifts our room so that the head is
where its own is, and turns it slowly to where its own looks; no rotation is looking forward.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from bridge.compiled import compiled
from bridge.pose import Pose
from bridge.sinks.bundles import Selection, template
from bridge.sinks.engine import EngineSink, Placing, Profile, one_of
from bridge.sinks.sink import SinkContext
from bridge.sinks.trackers import BodyTrackers, parse_trackers
from drivers.coordinates import FRAMES
from drivers.frame import Floats
from drivers.url import Url

_HEAD = 0
_NUMBERS = list(range(1, 9))
_OF_HEAD = {"yes": 2, "position": 1, "no": 0}  # messages
_FLAT = 0.999999  # sine of a pitch from which yaw and roll are one turn


class VrchatSink(EngineSink):
    """Eight trackers under SlimeVR's numbers, and the head. Options: `trackers` (some of them, as
    VRChat may do better with hip and feet alone), `head` (yes, position or no).
    """

    profile = Profile(9000, 250.0, FRAMES["unity"])
    wants_posture = True

    def __init__(self, url: Url, context: SinkContext) -> None:
        numbers = url.take("trackers", _NUMBERS, parse_trackers(_NUMBERS))
        head = url.take("head", "yes", one_of(*_OF_HEAD))
        super().__init__(url, context)
        self._trackers = BodyTrackers([*numbers, _HEAD], self.caution)
        messages = [
            template(f"/tracking/trackers/{name}/{what}", floats=3)
            for name in (*numbers, "head")
            for what in ("position", "rotation")
        ]
        self._packets = Selection([], messages, self._out.limit)
        self._wanted = np.arange(len(messages)) < 2 * len(numbers) + _OF_HEAD[head]
        self._placing = Placing(self.profile.frame)
        self._rows = np.empty((len(numbers) + 1, 7), np.float32)

    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        if not self._is_known(pose):
            return ()
        xyz, turns, shown = self._trackers(pose)
        shown = shown.repeat(2) & self._wanted
        if not shown.any():
            return ()
        self._placing.write(xyz, turns, self._rows)
        rows = self._packets.rows.reshape(-1, 6)
        euler(self._rows, rows)
        rows[-1, 3] = rows[-1, 5] = 0.0
        return self._packets.filled(shown)


@compiled("void(f4[:,::1], f4[:,::1])")
def euler(turned: Floats, rows: Floats) -> None:
    """Writes positions and angles (N, 6), degrees about x, y and z, of positions and unit
    quaternions (N, 7) in Unity's space, which applies z first, then x, then y. Looking straight up
    or down, z is 0: there y and z are one turn.
    """
    for row in range(len(turned)):
        x, y = float(turned[row, 3]), float(turned[row, 4])
        z, w = float(turned[row, 5]), float(turned[row, 6])
        sine = 2 * (w * x - y * z)
        side, up = 2 * (w * z + x * y), 1 - 2 * (x * x + z * z)
        if abs(sine) > _FLAT:
            roll = 0.0
            yaw = math.atan2(2 * (w * y - x * z), 1 - 2 * (y * y + z * z))  # of what was right
        else:
            roll = math.atan2(side, up)
            yaw = math.atan2(2 * (w * y + x * z), 1 - 2 * (x * x + y * y))  # of what was in front
        # Not the arcsine: near a right angle it makes a rounding error a hundredth of a degree.
        pitch = math.atan2(sine, math.hypot(side, up))
        rows[row, :3] = turned[row, :3]
        rows[row, 3] = math.degrees(pitch) + 0.0
        rows[row, 4] = math.degrees(yaw) + 0.0
        rows[row, 5] = math.degrees(roll) + 0.0
