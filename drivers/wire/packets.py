"""Packets that a byte ends, taken out of a stream however it was cut into reads."""

from __future__ import annotations


class PacketBuffer:
    """What has come of a stream of packets, each ended by the byte `end`.

    A packet longer than `longest` bytes is skipped to its end, so memory is bounded. The length of
    the buffer is that of the packet begun.
    """

    def __init__(self, end: bytes, longest: int) -> None:
        self._end = end
        self._longest = longest
        self.clear()

    def __len__(self) -> int:
        return len(self._begun)

    def clear(self) -> None:
        """Forgets a packet begun."""
        self._begun = b""
        self._skipping = False

    def feed(self, data: bytes) -> list[bytes | None]:
        """The packets that `data` ended, without their ends; None for each that is too long."""
        *ended, self._begun = (self._begun + data).split(self._end)
        if ended and self._skipping:  # the rest of one that was told of already
            del ended[0]
            self._skipping = False
        packets = [packet if len(packet) <= self._longest else None for packet in ended]
        if self._skipping or len(self._begun) > self._longest:
            self._begun = b""
            if not self._skipping:
                packets.append(None)
            self._skipping = True
        return packets
