"""Our own pose stream over OSC: `osc://127.0.0.1:9200` (docs/wires.md).

/markerbridge/layout  d rate in Hz, then s per label (first, and once a second)
/markerbridge/pose    i index, d seconds since the first pose, s provenance (a letter per
                      marker: M measured, I imputed, E estimated, L lost), f f f per marker, then
                      f sigma per marker; metres and our axes, unless the address says otherwise
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bridge.pose import Pose, Provenance
from bridge.sinks.engine import Profile
from bridge.sinks.markers import MarkerSink
from bridge.sinks.sink import SinkContext
from drivers.coordinates import OURS
from drivers.url import Url
from drivers.wire.osc import build
from drivers.wire.osc_native import NativeOscEncoder

POSE_ADDRESS = "/markerbridge/pose"
LAYOUT_EVERY = 1.0  # s
_LETTERS = np.frombuffer("".join(kind.name[0] for kind in Provenance).encode(), np.uint8)
_HEAD = struct.Struct(">id")


class OscSink(MarkerSink):
    """All markers of each pose with provenance and sigma, one message a frame."""

    profile = Profile(9200, 0.0, OURS)

    def __init__(self, url: Url, context: SinkContext) -> None:
        super().__init__(url, context)
        self._context = context
        labels = len(self._layout.labels)
        self._padding = b"\0" * (4 - labels % 4)
        floats = [("f", 0.0)] * (4 * labels)
        prototype = build(POSE_ADDRESS, ("i", 0), ("d", 0.0), ("s", "M" * labels), *floats)
        size = _HEAD.size + labels + len(self._padding) + 16 * labels
        # Address and type tags never change: only what follows them is made anew.
        self._prefix = prototype[:-size]
        self._layout_due = -np.inf

    def _datagrams(self, pose: Pose) -> Iterator[bytes]:
        if pose.t >= self._layout_due:
            layout = replace(self._layout, rate=self._context.rate)
            yield NativeOscEncoder().encode_layout(layout)
            self._layout_due = pose.t + LAYOUT_EVERY
        sigma = pose.sigma / np.float32(self._convention.frame.unit)
        yield (
            self._prefix
            + _HEAD.pack(pose.index & 0x7FFFFFFF, self._seconds(pose))
            + _LETTERS[pose.provenance].tobytes()
            + self._padding
            + self._xyz(pose).astype(">f4").tobytes()
            + sigma.astype(">f4").tobytes()
        )
