"""Virtual Motion Capture protocol: `vmc://127.0.0.1:39539`, bones and trackers in Unity's space.

    /VMC/Ext/OK        i 1; 0 while there is no pose to show, and then no more than the time
    /VMC/Ext/T         f seconds since the first pose
    /VMC/Ext/Root/Pos  s "root", 7 f: at the origin
    /VMC/Ext/Bone/Pos  s UnityEngine.HumanBodyBones, 7 f: against its parent; only bones we have
    /VMC/Ext/Tra/Pos   s a marker's label, 7 f: in the world, turned as the bone it sits on

7 f are a position in metres and a quaternion x, y, z, w. As on protocol.vmc.info (marionette-spec):
the first form of OK and of Root, which every receiver reads. Bones are those of a normalised
humanoid, as VRM 0 has it: no rotation in the T-pose.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bridge.humanoid.skeleton import BONES
from bridge.pose import Pose
from bridge.sinks.bundles import Bundles, Selection, template
from bridge.sinks.engine import EngineSink, Placing, Profile, one_of, parse_length
from bridge.sinks.sink import SinkContext
from bridge.sinks.trackers import bone_rows
from bridge.uncertainty import Bones, Points
from drivers.coordinates import FRAMES
from drivers.url import Url

_ROOT = np.array([0, 0, 0, 0, 0, 0, 1], np.float32)


class VmcSink(EngineSink):
    """Options: `send` (bones, trackers or both), `hips` (how high the avatar's are in its rest
    pose: all positions are scaled to that). Trackers alone come without root and rotations.
    """

    profile = Profile(39539, 250.0, FRAMES["unity"])  # receivers have crashed above

    def __init__(self, url: Url, context: SinkContext) -> None:
        send = url.take("send", "both", one_of("both", "bones", "trackers"))
        self._height = url.take("hips", None, parse_length)
        super().__init__(url, context)
        self._with_bones, with_markers = send != "trackers", send != "bones"
        self.wants_posture = self._with_bones or self.caution.moves or self._height is not None
        labels = context.info.labels if with_markers else ()
        names = BONES if self._with_bones else ()
        self._bones = Bones(self.caution)
        self._points = Points(self.caution, bone_rows(labels))
        self._unturned = np.tile(_ROOT[3:], (len(labels), 1))
        self._placing = Placing(self.profile.frame)
        head = [template("/VMC/Ext/OK", ("i", 1)), template("/VMC/Ext/T", floats=1)]
        if self._with_bones:
            head.append(template("/VMC/Ext/Root/Pos", ("s", "root"), floats=7))
        things = [template("/VMC/Ext/Bone/Pos", ("s", name), floats=7) for name in names]
        things += [template("/VMC/Ext/Tra/Pos", ("s", label), floats=7) for label in labels]
        self._known = Selection(head, things, self._out.limit)
        self._known.head[1:] = _ROOT[: 7 * self._with_bones]
        self._shown = np.ones(len(things), bool)
        self._places = np.empty((len(names), 3), np.float32)  # each against its parent
        waiting = [template("/VMC/Ext/OK", ("i", 0)), template("/VMC/Ext/T", floats=1)]
        self._unknown = Bundles(waiting, self._out.limit)

    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        seconds = self._seconds(pose)
        if not self._is_known(pose):
            return self._unknown.filled(np.array([seconds], np.float32))
        posture, first, rows = pose.posture, len(self._places), self._known.rows
        count = len(rows) - first
        xyz, turns, shown = self._points(pose.t, pose.xyz[:count], pose.sigma[:count], posture)
        size = 1.0
        if posture is not None and self._height is not None:
            # As large as the avatar, whose hips would float else, or sink into the floor.
            size = self._height / posture.rest[0, 2]
        if posture is not None and self._with_bones:
            bones = self._bones(pose.t, posture)
            self._places[:] = posture.rest
            self._places[0] = bones.hips
            self._placing.write(self._places, bones.local, rows[:first], size)
            self._shown[:first] = bones.shown
        else:
            turns = self._unturned
        self._placing.write(xyz, turns, rows[first:], size)
        self._shown[first:] = shown & ~np.isnan(xyz[:, 0])  # no engine knows a NaN
        self._known.head[0] = seconds
        return self._known.filled(self._shown)
