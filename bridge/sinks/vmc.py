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
from bridge.sinks.engine import EngineSink, Profile, joined, one_of, parse_length
from bridge.sinks.sink import SinkContext
from bridge.sinks.trackers import bone_rows
from bridge.uncertainty import Bones, Points
from drivers.coordinates import FRAMES
from drivers.url import Url

_NO_ROTATION = np.array([0.0, 0.0, 0.0, 1.0], np.float32)
_ROOT = np.append(np.zeros(3, np.float32), _NO_ROTATION)


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
        self._markers = len(labels)
        self._bones = Bones(self.caution)
        self._points = Points(self.caution, bone_rows(labels))
        head = [template("/VMC/Ext/OK", ("i", 1)), template("/VMC/Ext/T", floats=1)]
        if self._with_bones:
            head.append(template("/VMC/Ext/Root/Pos", ("s", "root"), floats=7))
        things = [template("/VMC/Ext/Bone/Pos", ("s", name), floats=7) for name in names]
        things += [template("/VMC/Ext/Tra/Pos", ("s", label), floats=7) for label in labels]
        self._known = Selection(head, things, self._out.limit)
        waiting = [template("/VMC/Ext/OK", ("i", 0)), template("/VMC/Ext/T", floats=1)]
        self._unknown = Bundles(waiting, self._out.limit)

    def _datagrams(self, pose: Pose) -> Iterable[bytes | bytearray]:
        seconds = np.array([self._seconds(pose)], np.float32)
        if not self._is_known(pose):
            return self._unknown.filled(seconds)
        posture = pose.posture
        xyz, sigma = pose.xyz[: self._markers], pose.sigma[: self._markers]
        xyz, turns, shown = self._points(pose.t, xyz, sigma, posture)
        shown = shown & ~np.isnan(xyz[:, 0])  # no engine knows a NaN
        if posture is not None and self._with_bones:
            bones = self._bones(pose.t, posture)
            places = posture.rest.copy()
            places[0] = bones.hips
            xyz = np.concatenate([places, xyz])
            turns = np.concatenate([bones.local, turns])
            shown = np.concatenate([bones.shown, shown])
        else:
            turns = np.broadcast_to(_NO_ROTATION, turns.shape)
        if posture is not None and self._height is not None:
            # As large as the avatar, whose hips would float else, or sink into the floor.
            xyz = xyz * (np.float32(self._height) / posture.rest[0, 2])
        frame = self.profile.frame
        floats = joined(frame.from_ours(xyz), frame.rotations_from_ours(turns))
        if self._with_bones:
            seconds = np.concatenate([seconds, _ROOT])
        return self._known.filled(floats, shown, seconds)
