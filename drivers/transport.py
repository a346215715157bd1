"""Where bytes come from and go to: the only part of a wire driver that does I/O."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple, Protocol

from drivers.clock import VirtualClock


class TransportLost(OSError):
    """The other side is gone: an unplugged device, a closed port."""


class Received(NamedTuple):
    """Bytes as they came. t: seconds on the host's clock. sender: `127.0.0.1:40312`, or nothing
    where a line has but one other end."""

    data: bytes
    t: float
    sender: str = ""


class Transport(Protocol):
    """A two-way line. `receive` and `send` raise TransportLost when the line is gone."""

    def receive(self, timeout: float) -> Received | None:
        """The bytes that are there, or None when `timeout` seconds pass without any."""
        ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class MemoryTransport:
    """One end of a line within this process, on virtual time.

    A `receive` with nothing there lets time run until the other end has sent something or the
    time-out has passed, so whatever is scheduled on the clock happens meanwhile.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._inbox: deque[Received] = deque()
        self._peer: MemoryTransport | None = None

    def receive(self, timeout: float) -> Received | None:
        deadline = self._clock.now() + timeout
        while not self._inbox:
            if self._peer is None:
                raise TransportLost("the other end is closed")
            if not self._clock.advance(deadline) and not self._inbox:
                return None
        return self._inbox.popleft()

    def send(self, data: bytes) -> None:
        if self._peer is None:
            raise TransportLost("the other end is closed")
        self._peer._inbox.append(Received(data, self._clock.now()))

    def close(self) -> None:
        if self._peer is not None:
            self._peer._peer = None
            self._peer = None


def memory_line(clock: VirtualClock) -> tuple[MemoryTransport, MemoryTransport]:
    """Both ends of a new in-memory line; datagrams stay whole and in order."""
    ends = MemoryTransport(clock), MemoryTransport(clock)
    ends[0]._peer, ends[1]._peer = ends[1], ends[0]
    return ends
