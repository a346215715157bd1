"""VRChat's OSC trackers: `vrchat://127.0.0.1:9000`, in Unity's space.

    /tracking/trackers/<1 to 8>/position, /rotation  f f f metres; f f f degrees
    /tracking/trackers/head/position, /rotation      f f f where the head's bone begins; f f f of
                                                     which VRChat takes the second, the yaw

As on docs.vrchat.com/docs/osc-trackers: Euler angles are applied in Unity's order, z, x, y; a metre
is a metre of the real room, so nothing is scaled here. VRChat shifts our room so that the head is
where its own is, and turns it slowly to where its own looks; no rotation is looking forward.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bridge.pose import Pose
from bridge.sinks.bundles import Selection, template
from bridge.sinks.engine import EngineSink, Profile, joined, one_of
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
        self._count = 2 * len(numbers) + _OF_HEAD[head]
        self._packets = Selection([], messages[: self._count], self._out.limit)

    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        if not self._is_known(pose):
            return ()
        xyz, turns, shown = self._trackers(pose)
        shown = np.repeat(shown, 2)[: self._count]
        if not shown.any():
            return ()
        frame = self.profile.frame
        angles = euler(frame.rotations_from_ours(turns))
        angles[-1, [0, 2]] = 0.0
        floats = joined(frame.from_ours(xyz), angles).reshape(-1, 3)[: self._count]
        return self._packets.filled(floats, shown)


def euler(turns: Floats) -> Floats:
    """(N, 3) degrees about x, y and z of unit quaternions (N, 4) in Unity's space, which applies z
    first, then x, then y. Looking straight up or down, z is 0: there y and z are one turn.
    """
    x, y, z, w = turns.astype(float).T
    sine = 2 * (w * x - y * z)
    side, up = 2 * (w * z + x * y), 1 - 2 * (x * x + z * z)
    flat = np.abs(sine) > _FLAT
    yaw = np.where(
        flat,
        np.arctan2(2 * (w * y - x * z), 1 - 2 * (y * y + z * z)),  # of what was to the right
        np.arctan2(2 * (w * y + x * z), 1 - 2 * (x * x + y * y)),  # of what was in front
    )
    roll = np.where(flat, 0.0, np.arctan2(side, up))
    # Not the arcsine: near a right angle it makes a rounding error a hundredth of a degree.
    radians = np.stack([np.arctan2(sine, np.hypot(side, up)), yaw, roll], axis=1)
    angles: Floats = np.degrees(radians, dtype=np.float32)
    return angles
