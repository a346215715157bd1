"""markerbridge's own serial wire: COBS packets ended by 0x00, best with one before as well.

Packet, before COBS, little endian, ended by the CRC-32 (zlib) of all bytes before it:

    version u8 (1) | flags u8: kind (low 4 bits) and layout number (high 4 bits) | body
    data    (kind 0): marker count u8, frame index u32, device time in microseconds u64,
                      presence bitmap (bit i of byte i // 8), float32 x, y, z in metres of the
                      markers present
    layout  (kind 1): marker count u8, rate f64 in Hz, then per label: length u8, ASCII
    hello   (kind 2): empty; host to device, answered by a layout packet

The layout number changes with the layout, so a frame is never read with the labels of another.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter

import numpy as np
from cobs import cobs

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.url import Url
from drivers.wire.packets import PacketBuffer

FRAME = "cmu"  # metres, Z up

VERSION = 1
DATA, LAYOUT, HELLO = 0, 1, 2
MAX_PACKET = 16_384  # longer than any packet of 255 markers; a line of noise is cut here

_DATA_HEAD = struct.Struct("<BBBIQ")
_LAYOUT_HEAD = struct.Struct("<BBBd")
_CRC = struct.Struct("<I")


def _seal(packet: bytes) -> bytes:
    encoded: bytes = cobs.encode(packet + _CRC.pack(zlib.crc32(packet)))
    return encoded + b"\0"


def _sent(packet: bytes) -> bytes:
    # The leading end closes whatever came before: a packet that was cut swallows no good one.
    return b"\0" + _seal(packet)


class CobsEncoder:
    """Frames to COBS packets; the device's side of the wire."""

    def __init__(self) -> None:
        self._number = -1
        self._layout: Layout | None = None
        self._tail = b""

    def encode_layout(self, layout: Layout) -> bytes:
        """A layout packet; a layout other than the last gets the next number.

        Raises ValueError for more than 255 markers or a label that is not 1 to 255 ASCII bytes.
        """
        if layout != self._layout:
            self._number = (self._number + 1) % 16
            self._layout = layout
        labels = [label.encode("ascii") for label in layout.labels]
        if len(labels) > 255 or any(not 1 <= len(label) <= 255 for label in labels):
            raise ValueError("at most 255 markers, with labels of 1 to 255 ASCII characters")
        head = _LAYOUT_HEAD.pack(VERSION, LAYOUT | self._number << 4, len(labels), layout.rate)
        return _sent(head + b"".join(bytes([len(label)]) + label for label in labels))

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """A data packet; `encode_layout` comes first."""
        present = ~np.isnan(xyz).any(axis=1)
        head = _DATA_HEAD.pack(
            VERSION,
            DATA | self._number << 4,
            len(xyz),
            index & 0xFFFFFFFF,
            round(t_device * 1e6) & 0xFFFFFFFFFFFFFFFF,
        )
        bitmap = np.packbits(present, bitorder="little").tobytes()
        return _sent(head + bitmap + xyz[present].astype("<f4").tobytes())

    def has_hello(self, data: bytes) -> bool:
        joined = self._tail + data
        self._tail = joined[1 - len(HELLO_PACKET) :]
        return HELLO_PACKET in joined


HELLO_PACKET = _seal(bytes([VERSION, HELLO]))


class CobsDecoder:
    """COBS packets to frames. Counts `bad_cobs`, `bad_crc`, `bad_version`, `bad_packet`,
    `overlong`, `no_layout` and `layout_mismatch`; whatever it met, it reads the next good packet.
    """

    hello = b"\0" + HELLO_PACKET

    def __init__(self) -> None:
        self.layout: Layout | None = None
        self.counters: Counter[str] = Counter()
        self._number = -1
        self._buffer = PacketBuffer(b"\0", MAX_PACKET)

    def reset(self) -> None:
        # What comes back may be another device, which numbers its layouts from the start again.
        self.layout = None
        self._number = -1
        self._buffer.clear()

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        frames = []
        for packet in self._buffer.feed(data):
            if packet is None:
                self.counters["overlong"] += 1
            elif packet:
                frame = self._read(packet, t)
                if frame is not None:
                    frames.append(frame)
        return frames

    def _read(self, encoded: bytes, t: float) -> MarkerFrame | None:
        try:
            packet = cobs.decode(encoded)
        except cobs.DecodeError:
            self.counters["bad_cobs"] += 1
            return None
        body = packet[:-4]
        if len(packet) < 6 or _CRC.pack(zlib.crc32(body)) != packet[-4:]:
            self.counters["bad_crc"] += 1
            return None
        if body[0] != VERSION:
            self.counters["bad_version"] += 1
            return None
        kind, number = body[1] & 0x0F, body[1] >> 4
        try:
            if kind == DATA:
                return self._read_data(body, number, t)
            if kind == LAYOUT:
                self._read_layout(body, number)
            elif kind != HELLO:
                self.counters["bad_packet"] += 1
        except (ValueError, struct.error, IndexError):
            self.counters["bad_packet"] += 1
        return None

    def _read_layout(self, body: bytes, number: int) -> None:
        *_, count, rate = _LAYOUT_HEAD.unpack_from(body)
        at, labels = _LAYOUT_HEAD.size, []
        for _ in range(count):
            end = at + 1 + body[at]
            labels.append(body[at + 1 : end].decode("ascii"))
            at = end
        if at != len(body) or not all(label and label.isprintable() for label in labels):
            raise ValueError("labels that are none, or of another length than the packet")
        layout = Layout(tuple(labels), rate)
        if layout != self.layout:
            self.layout = layout
        self._number = number
        self.counters["layouts"] += 1

    def _read_data(self, body: bytes, number: int, t: float) -> MarkerFrame | None:
        _, _, count, index, microseconds = _DATA_HEAD.unpack_from(body)
        bitmap_end = _DATA_HEAD.size + (count + 7) // 8
        bitmap = body[_DATA_HEAD.size : bitmap_end]
        values = np.frombuffer(body, "<f4", offset=bitmap_end).reshape(-1, 3)
        given = int.from_bytes(bitmap, "little")
        if given >> count or given.bit_count() != len(values) or not np.isfinite(values).all():
            raise ValueError("bitmap and coordinates disagree")
        if self.layout is None:
            self.counters["no_layout"] += 1
            return None
        if number != self._number or count != len(self.layout.labels):
            self.counters["layout_mismatch"] += 1
            return None
        xyz = np.empty((count, 3), np.float32)
        if len(values) == count:
            xyz[:] = values
        else:
            bits = np.frombuffer(bitmap, np.uint8)
            present = np.unpackbits(bits, count=count, bitorder="little").astype(bool)
            xyz[:] = np.nan
            xyz[present] = values
        return MarkerFrame(index, t, microseconds / 1e6, self.layout, xyz)


def open_decoder(url: Url) -> CobsDecoder:
    """The host's side of the wire; it has no options."""
    return CobsDecoder()


def open_encoder(url: Url) -> CobsEncoder:
    """The device's side of the wire; it has no options."""
    return CobsEncoder()
