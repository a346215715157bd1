"""Our own pose stream as OSC messages, for all sinks that send it (docs/wires.md).

/markerbridge/layout  d rate in Hz, then s per label
/markerbridge/pose    i index, d seconds since the first pose, s provenance (a letter per
                      marker: M measured, I imputed, E estimated, L lost), f f f per marker, then
                      f sigma per marker

Of one of several performers, ann, the addresses are /markerbridge/ann/layout and so on.
"""

from __future__ import annotations

import struct

import numpy as np

from bridge.pose import Pose, Provenance
from drivers.frame import Floats, Layout
from drivers.wire.osc import build

ROOT = "/markerbridge"
_LETTERS = np.frombuffer("".join(kind.name[0] for kind in Provenance).encode(), np.uint8)
_HEAD = struct.Struct(">id")


class PoseMessages:
    """The messages of poses that have one layout. unit: the receiver's, in metres. performer:
    whose they are; empty where there is one alone.
    """

    def __init__(self, layout: Layout, unit: float, performer: str = "") -> None:
        self._layout = layout
        self._root = f"{ROOT}/{performer}" if performer else ROOT
        self._unit = np.float32(unit)
        labels = len(layout.labels)
        self._padding = b"\0" * (4 - labels % 4)
        floats = [("f", 0.0)] * (4 * labels)
        prototype = build(f"{self._root}/pose", ("i", 0), ("d", 0.0), ("s", "M" * labels), *floats)
        size = _HEAD.size + labels + len(self._padding) + 16 * labels
        # Address and type tags never change: only what follows them is made anew.
        self._prefix = prototype[:-size]

    def layout(self, rate: float) -> bytes:
        """The layout message. rate: of the stream, Hz."""
        labels = (("s", label) for label in self._layout.labels)
        return build(f"{self._root}/layout", ("d", rate), *labels)

    def pose(self, pose: Pose, seconds: float, xyz: Floats) -> bytes:
        """The message of a pose. seconds: since the first. xyz: (M, 3) as the receiver has it."""
        return (
            self._prefix
            + _HEAD.pack(pose.index & 0x7FFFFFFF, seconds)
            + _LETTERS[pose.provenance].tobytes()
            + self._padding
            + xyz.astype(">f4").tobytes()
            + (pose.sigma / self._unit).astype(">f4").tobytes()
        )
