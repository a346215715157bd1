"""Faults of packets on their way: lost, doubled, spoilt, held up, overtaken."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from pydantic import Field, PrivateAttr

from simulators.faults.fault import Fault, Stream


@dataclass(frozen=True, slots=True)
class Packet:
    """Bytes that are to be sent. t: when they were made, due: when they reach the line, both in
    seconds of the stream. spoilt: whether they are no longer what was encoded."""

    data: bytes
    t: float
    due: float
    spoilt: bool = False


class PacketFault(Fault):
    """A fault of whole packets; counts the packets it acted on."""

    def apply(self, packet: Packet) -> list[Packet]:
        """What becomes of a packet."""
        return self._change(packet) if self.acts(packet.t) else [packet]

    @abstractmethod
    def _change(self, packet: Packet) -> list[Packet]: ...


class Loss(PacketFault):
    """Packets are lost."""

    kind: Literal["loss"]

    def _change(self, packet: Packet) -> list[Packet]:
        self.count()
        return []


class Duplicate(PacketFault):
    """Packets come again. copies: how often. Counts copies."""

    kind: Literal["duplicate"]
    copies: Annotated[int, Field(ge=1, le=100)] = 1

    def _change(self, packet: Packet) -> list[Packet]:
        self.count(self.copies)
        return [packet] * (1 + self.copies)


class Truncate(PacketFault):
    """Packets lose their end, at least a byte of it."""

    kind: Literal["truncate"]

    def _change(self, packet: Packet) -> list[Packet]:
        if len(packet.data) < 2:
            return [packet]
        self.count()
        kept = int(self._stream.random.integers(1, len(packet.data)))
        return [replace(packet, data=packet.data[:kept], spoilt=True)]


class Flip(PacketFault):
    """Bits change: so many per packet."""

    kind: Literal["flip"]
    bits: Annotated[int, Field(ge=1)] = 1

    def _change(self, packet: Packet) -> list[Packet]:
        self.count()
        data = bytearray(packet.data)
        number = min(self.bits, 8 * len(data))
        for bit in self._stream.random.choice(8 * len(data), number, replace=False):
            data[bit // 8] ^= 1 << (bit % 8)
        return [replace(packet, data=bytes(data), spoilt=True)]


class Jitter(PacketFault):
    """Packets are delayed by up to so many seconds, their order kept."""

    kind: Literal["jitter"]
    up_to: Annotated[float, Field(gt=0)]

    _last: float = PrivateAttr(-math.inf)

    def start(self, stream: Stream) -> None:
        super().start(stream)
        self._last = -math.inf

    def apply(self, packet: Packet) -> list[Packet]:
        # Those that are not delayed themselves wait behind those that are.
        changed = super().apply(packet)
        self._last = max(self._last, changed[0].due)
        return [replace(changed[0], due=self._last)]

    def _change(self, packet: Packet) -> list[Packet]:
        self.count()
        return [replace(packet, due=packet.due + self._stream.random.uniform(0, self.up_to))]


class Reorder(PacketFault):
    """Packets are overtaken by up to so many frames."""

    kind: Literal["reorder"]
    by: Annotated[int, Field(ge=1, le=100)] = 1

    def _change(self, packet: Packet) -> list[Packet]:
        self.count()
        frames = self._stream.random.integers(1, self.by + 1) + 0.5
        return [replace(packet, due=packet.due + frames / self._stream.layout.rate)]
