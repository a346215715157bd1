"""markerbridge's own OSC dialect: one message a frame (docs/wires.md).

    /markerbridge/layout  d rate in Hz, then s per label
    /markerbridge/frame   i index, i check of the labels, d device time in seconds, then f f f
                          metres per marker, NaN where it is missing

The layout comes before the first frame and then once a second; there is no way back, so no hello.
The check is the CRC-32 (as zlib's) of all labels in order, each ended by a zero byte: a frame whose
layout was lost is never read with the labels of another. A sender may leave it out.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterable

import numpy as np

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.url import Url
from drivers.wire.osc import OscError, OscMessage, arguments, build, label_of, messages

FRAME = "cmu"  # metres, Z up

LAYOUT_ADDRESS = "/markerbridge/layout"
FRAME_ADDRESS = "/markerbridge/frame"
MOST = 1024  # labels: of a hundred performers
_HEAD = struct.Struct(">iId")
# Index, check and time, as their type tags say. Senders without doubles (TouchDesigner) write the
# time as a float.
_HEADS = {
    head: struct.Struct(">" + head.replace("ii", "iI")) for head in ("iid", "iif", "id", "if")
}


def check_of(labels: Iterable[str]) -> int:
    """The check of a layout's labels, 32 bits."""
    return zlib.crc32(b"".join(label.encode() + b"\0" for label in labels))


class NativeOscEncoder:
    """Frames to datagrams; the device's side of the wire."""

    def __init__(self) -> None:
        self._prefix = b""
        self._check = 0

    def encode_layout(self, layout: Layout) -> bytes:
        prototype = build(
            FRAME_ADDRESS, ("i", 0), ("i", 0), ("d", 0.0), *[("f", 0.0)] * (3 * len(layout.labels))
        )
        # Address and type tags never change with the frame: only what follows them is made anew.
        self._prefix = prototype[: len(prototype) - _HEAD.size - 12 * len(layout.labels)]
        self._check = check_of(layout.labels)
        return build(LAYOUT_ADDRESS, ("d", layout.rate), *(("s", name) for name in layout.labels))

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """One datagram; `encode_layout` comes first."""
        head = _HEAD.pack(index & 0x7FFFFFFF, self._check, t_device)
        return self._prefix + head + xyz.astype(">f4").tobytes()

    def has_hello(self, data: bytes) -> bool:
        return False


class NativeOscDecoder:
    """Datagrams to frames. Counts `bad_osc`, `bad_packet`, `foreign` (well-formed OSC that is not
    ours), `no_layout` and `layout_mismatch`.
    """

    hello = b""

    def __init__(self) -> None:
        self.layout: Layout | None = None
        self.counters: Counter[str] = Counter()
        self._check = 0

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
        if not isinstance(rate, (int, float)) or not labels:
            raise ValueError("layout is a rate and labels")
        if len(labels) > MOST:
            raise ValueError(f"more than {MOST:,} labels")
        names = tuple(label_of(label) for label in labels)
        layout = Layout(names, float(rate))
        if layout != self.layout:
            self.layout = layout
            self._check = check_of(names)
        self.counters["layouts"] += 1

    def _read_frame(self, message: OscMessage, t: float) -> MarkerFrame | None:
        head = message.types[: 3 if message.types.startswith("ii") else 2]
        floats = message.types[len(head) :]
        if head not in _HEADS or floats.strip("f"):
            raise ValueError("frame is one or two ints, a double and floats")
        index, *check, t_device = _HEADS[head].unpack_from(message.data)
        values = np.frombuffer(message.data[_HEADS[head].size :], ">f4")
        xyz = values.reshape(-1, 3).astype(np.float32)
        if len(values) != len(floats) or not np.isfinite(t_device):
            raise ValueError("frame of another length than its type tags")
        if self.layout is None:
            self.counters["no_layout"] += 1
            return None
        if len(xyz) != len(self.layout.labels) or check not in ([], [self._check]):
            self.counters["layout_mismatch"] += 1
            return None
        xyz[~np.isfinite(xyz).all(axis=1)] = np.nan
        return MarkerFrame(index, t, t_device, self.layout, xyz)


def open_decoder(url: Url) -> NativeOscDecoder:
    """The host's side of the wire; it has no options."""
    return NativeOscDecoder()


def open_encoder(url: Url) -> NativeOscEncoder:
    """The device's side of the wire; it has no options."""
    return NativeOscEncoder()
