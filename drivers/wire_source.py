"""A source that reads packets from a line: asks for the layout, and reconnects by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from drivers.clock import Clock
from drivers.frame import MarkerFrame, Source, SourceError
from drivers.transport import Transport, TransportLost
from drivers.wire.codec import Decoder

SILENCE = 1.0  # s without a byte before the device is asked again
RETRY = 0.1  # s between attempts to open a line that was lost


class WireSource(Source):
    """Frames that `decoder` reads from the line that `connect` opens.

    `connect` raises SourceError where the line cannot be opened: the first time that is the
    caller's to see, afterwards the line is tried again every 100 ms. Counts `bytes`,
    `disconnects`, `reconnects`, and what the decoder counts.
    """

    def __init__(
        self, name: str, connect: Callable[[], Transport], decoder: Decoder, clock: Clock
    ) -> None:
        super().__init__(name, clock)
        self._connect = connect
        self._decoder = decoder
        self._decoder.counters = self.counters
        self._transport: Transport | None = connect()
        self._quiet_since = clock.now()
        self._say_hello()

    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        if self._transport is None and not self._reconnect(timeout):
            return None
        assert self._transport is not None
        # Wake up in time to ask a silent device again.
        wait = min(timeout, max(0.0, self._quiet_since + SILENCE - self.clock.now()))
        try:
            data = self._transport.receive(wait)
        except TransportLost:
            self._lose()
            return None
        now = self.clock.now()
        if not data:
            if now - self._quiet_since >= SILENCE:
                self._quiet_since = now
                self._say_hello()
            return None
        self._quiet_since = now
        self.counters["bytes"] += len(data)
        frames = self._decoder.feed(data, now)
        self.layout = self._decoder.layout
        return frames

    def _say_hello(self) -> None:
        if self._decoder.hello and self._transport is not None:
            try:
                self._transport.send(self._decoder.hello)
            except TransportLost:
                self._lose()

    def _lose(self) -> None:
        self.counters["disconnects"] += 1
        if self._transport is not None:
            self._transport.close()
        self._transport = None

    def _reconnect(self, timeout: float) -> bool:
        try:
            self._transport = self._connect()
        except SourceError:
            self.clock.sleep_until(self.clock.now() + min(RETRY, timeout))
            return False
        self.counters["reconnects"] += 1
        self._decoder.reset()
        self._quiet_since = self.clock.now()
        self._say_hello()
        return self._transport is not None  # it may be gone again already

    def close(self) -> None:
        super().close()
        if self._transport is not None:
            self._transport.close()
            self._transport = None
