"""markerbridge's own OSC dialect: one message a frame (docs/wires.md).

    /markerbridge/layout  d rate in Hz, then s per label
    /markerbridge/frame   i index, d device time in seconds, then f f f metres per marker, NaN
                          where it is missing

The layout comes before the first frame and then once a second; there is no way back, so no hello.
"""

from __future__ import annotations

import struct
from collections import Counter

import numpy as np
from pythonosc.osc_message_builder import OscMessageBuilder

from drivers.frame import Floats, Layout, MarkerFrame, in_range
from drivers.url import Url
from drivers.wire.osc import OscError, OscMessage, arguments, messages

FRAME = "cmu"  # metres, Z up

LAYOUT_ADDRESS = "/markerbridge/layout"
FRAME_ADDRESS = "/markerbridge/frame"
_HEAD = struct.Struct(">id")


class NativeOscEncoder:
    """Frames to datagrams; the device's side of the wire."""

    def __init__(self) -> None:
        self._prefix = b""

    def encode_layout(self, layout: Layout) -> bytes:
        builder = OscMessageBuilder(LAYOUT_ADDRESS)
        builder.add_arg(float(layout.rate), "d")
        for label in layout.labels:
            builder.add_arg(label, "s")
        prototype = OscMessageBuilder(FRAME_ADDRESS)
        prototype.add_arg(0, "i")
        prototype.add_arg(0.0, "d")
        for _ in range(3 * len(layout.labels)):
            prototype.add_arg(0.0, "f")
        datagram = prototype.build().dgram
        # Address and type tags never change with the frame: only what follows them is made anew.
        self._prefix = datagram[: len(datagram) - _HEAD.size - 12 * len(layout.labels)]
        return builder.build().dgram

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """One datagram; `encode_layout` comes first."""
        return self._prefix + _HEAD.pack(index & 0x7FFFFFFF, t_device) + xyz.astype(">f4").tobytes()

    def has_hello(self, data: bytes) -> bool:
        return False


class NativeOscDecoder:
    """Datagrams to frames. Counts `bad_osc`, `bad_packet`, `foreign` (well-formed OSC that is not
    ours), `no_layout`, `layout_mismatch`, and markers `out_of_range`.
    """

    hello = b""

    def __init__(self) -> None:
        self.layout: Layout | None = None
        self.counters: Counter[str] = Counter()

    def reset(self) -> None:
        self.layout = None

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        try:
            received = messages(data)
        except OscError:
            self.counters["bad_osc"] += 1
            return []
        frames = []
        for message in received:
            try:
                if message.address == FRAME_ADDRESS:
                    frame = self._read_frame(message, t)
                    if frame is not None:
                        frames.append(frame)
                elif message.address == LAYOUT_ADDRESS:
                    self._read_layout(message)
                else:
                    self.counters["foreign"] += 1
            except (ValueError, TypeError, struct.error):
                self.counters["bad_packet"] += 1
        return frames

    def _read_layout(self, message: OscMessage) -> None:
        rate, *labels = arguments(message)
        if not isinstance(rate, (int, float)) or not labels or not all(labels):
            raise ValueError("layout is a rate and labels")
        layout = Layout(tuple(str(label) for label in labels), float(rate))
        if set(message.types[1:]) != {"s"}:
            raise ValueError("labels are strings")
        if layout != self.layout:
            self.layout = layout
        self.counters["layouts"] += 1

    def _read_frame(self, message: OscMessage, t: float) -> MarkerFrame | None:
        # Senders without doubles (TouchDesigner) write the time as a float.
        head = message.types[:2]
        if head not in ("id", "if") or message.types[2:].strip("f"):
            raise ValueError("frame is an int, a double and floats")
        index, t_device = struct.unpack_from(">" + head, message.data)
        values = np.frombuffer(message.data[4 + (8 if head == "id" else 4) :], ">f4")
        xyz = values.reshape(-1, 3).astype(np.float32)
        if 3 * len(xyz) != len(message.types) - 2 or not np.isfinite(t_device):
            raise ValueError("frame of another length than its type tags")
        if self.layout is None:
            self.counters["no_layout"] += 1
            return None
        if len(xyz) != len(self.layout.labels):
            self.counters["layout_mismatch"] += 1
            return None
        there = in_range(xyz).all(axis=1)
        self.counters["out_of_range"] += int((~there & ~np.isnan(xyz).any(axis=1)).sum())
        xyz[~there] = np.nan
        return MarkerFrame(index, t, t_device, self.layout, xyz)


def open_decoder(url: Url) -> NativeOscDecoder:
    """The host's side of the wire; it has no options."""
    return NativeOscDecoder()


def open_encoder(url: Url) -> NativeOscEncoder:
    """The device's side of the wire; it has no options."""
    return NativeOscEncoder()
