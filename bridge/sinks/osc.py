"""Our own pose stream over OSC: `osc://127.0.0.1:9200` (docs/wires.md).

/markerbridge/layout  d rate in Hz, then s per label (first, and once a second)
/markerbridge/pose    i index, d seconds since the first pose, s provenance (a letter per
                      marker: M measured, I imputed, E estimated, L lost), f f f metres per
                      marker, then f sigma in metres per marker
"""

from __future__ import annotations

import struct

import numpy as np
from pythonosc.osc_message_builder import OscMessageBuilder

from bridge.pose import Pose, Provenance
from bridge.sinks.sink import Sink, SinkContext
from drivers.frame import Layout
from drivers.options import positive
from drivers.udp_sender import UdpSender
from drivers.url import Url
from drivers.wire.osc_native import NativeOscEncoder

POSE_ADDRESS = "/markerbridge/pose"
LAYOUT_EVERY = 1.0  # s
_LETTERS = np.frombuffer("".join(kind.name[0] for kind in Provenance).encode(), np.uint8)
_HEAD = struct.Struct(">id")


class OscSink(Sink):
    """All markers of each pose with provenance and sigma, one message a frame."""

    def __init__(self, url: Url, context: SinkContext) -> None:
        self.name = url.text
        self.rate = url.take("rate", 0.0, positive)
        url.finish()
        self._out = UdpSender(*url.address(9200))
        self._context = context
        labels = len(context.info.labels)
        self._padding = b"\0" * (4 - labels % 4)
        prototype = OscMessageBuilder(POSE_ADDRESS)
        prototype.add_arg(0, "i")
        prototype.add_arg(0.0, "d")
        prototype.add_arg("M" * labels, "s")
        for _ in range(4 * labels):
            prototype.add_arg(0.0, "f")
        size = _HEAD.size + labels + len(self._padding) + 16 * labels
        # Address and type tags never change: only what follows them is made anew.
        self._prefix = prototype.build().dgram[:-size]
        self._start: float | None = None
        self._layout_due = 0.0

    def __call__(self, pose: Pose) -> None:
        if self._start is None:
            self._start = self._layout_due = pose.t
        if pose.t >= self._layout_due:
            layout = Layout(self._context.info.labels, self._context.rate)
            self._out.send(NativeOscEncoder().encode_layout(layout))
            self._layout_due = pose.t + LAYOUT_EVERY
        self._out.send(
            self._prefix
            + _HEAD.pack(pose.index & 0x7FFFFFFF, pose.t - self._start)
            + _LETTERS[pose.provenance].tobytes()
            + self._padding
            + pose.xyz.astype(">f4").tobytes()
            + pose.sigma.astype(">f4").tobytes()
        )

    def close(self) -> None:
        self._out.close()
