"""A sink's own thread and queue: poses wait here, and what is dropped is counted."""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque

from bridge.pose import Pose
from bridge.sinks.sink import Input, Sink, SinkClosed, SinkError
from bridge.statistics import Hop
from drivers.clock import Clock
from drivers.session_log import FOUND, LOST, LineBytes, LineEvent
from drivers.transport import Received

log = logging.getLogger(__name__)

BURST = 0.1  # s: a rate limit is kept over this time, so jitter alone delays nothing
COUNTED = ("sent", "dropped", "rate_limited", "recorded", "errors")
FLUSH = 2.0  # s that a sink gets at the end for what still waits


class Outlet:
    """Delivers poses to one sink. Without `start`, `put` delivers at once, on the caller's thread.

    A stream slower than the sink's rate loses nothing: after a stall the waiting poses are sent at
    that rate. A faster one is thinned out: the newest pose wins.

    Counts `sent`, `dropped` (the queue was full), `rate_limited`, `recorded` (inputs, by a sink
    that records) and `errors`, of which `last_error` is the newest in words. A sink that raises
    loses that pose and no other. hop: how old poses are when they are sent.
    """

    stream_rate = 0.0  # Hz, once it is known

    def __init__(self, sink: Sink, clock: Clock) -> None:
        self.sink = sink
        self.counters: Counter[str] = Counter()
        self.hop = Hop()
        self.last_error: str | None = None
        self._clock = clock
        self._queue: deque[Pose | Input] = deque()
        self._wake = threading.Condition()
        self._closing = False
        self._delivering = False  # a pose is with the outlet's own thread
        self._unwanted = False
        self._thread: threading.Thread | None = None
        self._tokens = self._most = max(1.0, sink.rate * BURST)
        self._refilled = clock.now()

    def start(self) -> None:
        """From now on poses are delivered by a thread of the outlet's own."""
        self._thread = threading.Thread(target=self._work, name=self.sink.name, daemon=True)
        self._thread.start()

    def put(self, pose: Pose) -> None:
        """Takes a pose; drops the oldest waiting one where too many wait."""
        if self._unwanted:
            return
        if self._thread is None:
            if self._too_fast and self._wait_for_token() > 0:
                self.counters["rate_limited"] += 1
            else:
                self._deliver(pose)
            return
        with self._wake:
            if self._at_once():
                self._deliver(pose)
                return
            self._queue.append(pose)
            if self.sink.waiting is not None and len(self._queue) > self.sink.waiting:
                self._queue.popleft()
                self.counters["dropped"] += 1
            self._wake.notify()

    def record(self, came: Input) -> None:
        """Takes what came in, for a sink that records."""
        if self._thread is None:
            self._deliver(came)
            return
        with self._wake:
            self._queue.append(came)
            self._wake.notify()

    def close(self) -> None:
        """Delivers what still waits (a recorder all of it, others for two seconds), then closes.

        Raises SinkError where the sink cannot save.
        """
        if self._thread is not None:
            with self._wake:
                self._closing = True
                self._wake.notify()
            self._thread.join(None if self.sink.waiting is None else FLUSH)
            self._thread = None
        try:
            self.sink.close()
        except OSError as error:
            raise SinkError(f"{self.sink.name}: {error}") from error

    def _work(self) -> None:
        while True:
            with self._wake:
                self._delivering = False
                while not self._queue and not self._closing:
                    self._wake.wait()
                self._delivering = bool(self._queue)
                if not self._queue:
                    return
                pose = self._queue.popleft()
            wait = self._wait_for_token()
            if wait > 0:
                self._clock.sleep_until(self._clock.now() + wait)
                self._wait_for_token()
                if self._too_fast:
                    with self._wake:
                        self.counters["rate_limited"] += len(self._queue)
                        pose = self._queue.pop() if self._queue else pose
                        self._queue.clear()
            self._deliver(pose)

    def _at_once(self) -> bool:
        """Whether a pose is delivered on the thread that brings it: that costs less than to wake up
        another. Nothing may wait before it.
        """
        free = self.sink.prompt and not (self._queue or self._delivering)
        return free and self._wait_for_token() <= 0.0

    @property
    def _too_fast(self) -> bool:
        return 0 < self.sink.rate < self.stream_rate

    def _wait_for_token(self) -> float:
        """Takes a token of the rate limit if there is one; else the seconds until there is."""
        if not self.sink.rate:
            return 0.0
        now = self._clock.now()
        self._tokens = min(self._most, self._tokens + (now - self._refilled) * self.sink.rate)
        self._refilled = now
        if self._tokens < 1.0:
            return (1.0 - self._tokens) / self.sink.rate
        self._tokens -= 1.0
        return 0.0

    def _deliver(self, item: Pose | Input) -> None:
        if self._unwanted:
            return
        try:
            if not isinstance(item, Pose):
                self.sink.record(item)
                self.counters["recorded"] += 1
                return
            self.sink(item)
        except SinkClosed as closed:
            self._unwanted = True
            log.info("%s: %s", self.sink.name, closed)
            return
        except Exception as error:
            self._failed(error)
            return
        self.counters["sent"] += 1
        self.hop.passed(item.t, self._clock.now())

    def _failed(self, error: Exception) -> None:
        self.counters["errors"] += 1
        self.last_error = str(error) or type(error).__name__
        if self.counters["errors"] == 1:
            log.warning("%s: %s (said once; counted from now on)", self.sink.name, error)


class Tap:
    """What comes over the line of a source, on its way to the sinks that record it; `name` is the
    source's in the recording.
    """

    def __init__(self, name: str, outlets: list[Outlet]) -> None:
        self._name = name
        self._outlets = outlets

    def received(self, source: str, received: Received) -> None:
        self._record(LineBytes(self._name, received))

    def lost(self, source: str, t: float) -> None:
        self._record(LineEvent(self._name, t, LOST))

    def found(self, source: str, t: float) -> None:
        self._record(LineEvent(self._name, t, FOUND))

    def _record(self, came: Input) -> None:
        for outlet in self._outlets:
            outlet.record(came)
