"""What the OSC dialects have in common that send a message per marker, and no layouts."""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from drivers.frame import Floats, Layout, MarkerFrame
from drivers.wire.assembler import MOST, Assembled, Assembler
from drivers.wire.osc import OscError, OscMessage, build_bundle, is_bundle, messages, sized

LONGEST = 200  # bytes of a label that is part of an address
LARGEST = 1e30  # of a coordinate: what a float32 holds with room to spare

BELIEVED = 50  # packets without an index after which the stream is one that has none

Position = Sequence[float]  # three numbers, NaN where the marker is lost


class MarkerDecoder(Assembled, ABC):
    """Datagrams to frames. A dialect writes one hook, `_read`.

    A bundle that has a marker in common with the bundle before it is a frame of its own, under the
    index that it brings; parts of one frame have none in common. Those, and messages sent one by
    one, are collected (`Assembler`). Counts `bad_osc`, `bad_packet` (ours, but not as it must be),
    `foreign` (OSC that is not ours), `no_markers` (packets without any), `duplicate_markers` and
    `too_many_labels` (within a packet), `no_index` (packets without one in a stream that has them),
    and what the Assembler counts.

    rate: the stream's in Hz where it is known, else it is measured.
    """

    hello = b""

    def __init__(self, rate: float | None = None) -> None:
        self._frames = Assembler(Counter(), rate)
        self.reset()

    def reset(self) -> None:
        self._frames.reset()
        self._before: Mapping[str, Position] = {}  # markers of the bundle before
        self._time = math.nan  # of the device, as last told, in seconds
        self._index: int | None = None  # of the frame that this packet holds, if it tells
        self._untold = BELIEVED  # packets with markers since one told an index
        self._ended = False  # whether this packet says that the frame is whole

    @abstractmethod
    def _read(self, message: OscMessage) -> tuple[str, Position] | None:
        """The marker that a message tells of; what it tells of the frame is kept.

        Raises ValueError for a message of ours that is not as it must be. Counts foreign ones.
        """

    def feed(self, data: bytes, t: float) -> list[MarkerFrame]:
        try:
            received = messages(data)
        except OscError:
            self.counters["bad_osc"] += 1
            return []
        self._index, self._ended = None, False
        markers = self._read_all(received)
        if not markers:
            self.counters["no_markers"] += 1
        elif self._lacks_index():
            self.counters["no_index"] += 1
            return []
        frames: list[MarkerFrame] = []
        if is_bundle(data) and markers:
            common = not self._before.keys().isdisjoint(markers)
            self._before = markers
            if common or self._index is not None:
                frames = self._frames.put(markers, t, self._time, self._index)
                markers = {}
        for label, xyz in markers.items():
            frames += self._frames.add(label, xyz, t, self._time)
        if self._ended:
            frames += self._frames.end()
        return frames

    def _lacks_index(self) -> bool:
        """Whether markers come without an index in a stream that has them: any number that we gave
        them would be another frame's.
        """
        self._untold = 0 if self._index is not None else self._untold + 1
        return 0 < self._untold < BELIEVED

    def _read_all(self, received: Iterable[OscMessage]) -> dict[str, Position]:
        markers: dict[str, Position] = {}
        for message in received:
            try:
                marker = self._read(message)
            except (ValueError, struct.error):
                self.counters["bad_packet"] += 1
                continue
            if marker is None:
                continue
            label, xyz = marker
            if label in markers:
                self.counters["duplicate_markers"] += 1
            elif len(markers) == MOST:
                self.counters["too_many_labels"] += 1
            else:
                markers[label] = xyz
        return markers


def position_of(types: str, values: Sequence[float]) -> Position:
    """Three numbers of these type tags. Raises ValueError."""
    if types == "fff":
        return values
    if len(types) != 3 or types.strip("fid"):  # Max writes 0 where it means 0.0
        raise ValueError("a position is three numbers")
    return [value if abs(value) < LARGEST else math.nan for value in values]


def in_address(label: str) -> str:
    """A label that an OSC address can hold. Raises ValueError for others."""
    if set(label) & set("*?[]{}") or not label.isprintable() or len(label.encode()) > LONGEST:
        raise ValueError(
            f"marker '{label}': a name here is at most {LONGEST} letters, none of "
            "them one of * ? [ ] { }"
        )
    return label


class Slot:
    """A marker's place in a bundle: a message of which only the position changes.

    behind: bytes of `message` after the position's three floats. lost: the message where the marker
    is missing; none is sent where it is empty.
    """

    def __init__(self, message: bytes, behind: int = 0, lost: bytes = b"") -> None:
        element = sized(message)
        at = len(element) - behind - 12
        self._before, self._after = element[:at], element[at + 12 :]
        self.lost = sized(lost) if lost else b""

    def filled(self, xyz: bytes) -> bytes:
        """The element of a bundle; `xyz` is three floats, big endian."""
        return self._before + xyz + self._after


class MarkerEncoder(ABC):
    """Frames to datagrams, a bundle each. A dialect writes how a marker is sent, and what before
    the markers. The wire has no layouts.
    """

    def __init__(self) -> None:
        self._slots: list[Slot] = []

    @abstractmethod
    def _slot(self, label: str, row: int) -> Slot:
        """Raises ValueError for a label that the wire cannot carry."""

    def _head(self, index: int, t_device: float) -> list[bytes]:
        """The elements before the markers."""
        return []

    def encode_layout(self, layout: Layout) -> bytes:
        """Nothing is sent. Raises ValueError for labels that the wire cannot carry."""
        self._slots = [self._slot(label, row) for row, label in enumerate(layout.labels)]
        return b""

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        """One datagram; `encode_layout` comes first."""
        lost = set(np.flatnonzero(np.isnan(xyz).any(axis=1)).tolist())
        floats = xyz.astype(">f4").tobytes()
        elements = self._head(index, t_device)
        for row, slot in enumerate(self._slots):
            at = 12 * row
            elements.append(slot.lost if row in lost else slot.filled(floats[at : at + 12]))
        return build_bundle(elements)

    def has_hello(self, data: bytes) -> bool:
        return False
