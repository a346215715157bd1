"""Time, injected: the system's monotonic clock, and a virtual one for runs in one process."""

from __future__ import annotations

import heapq
import itertools
import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Seconds on a monotonic clock, and a wait until a moment on it."""

    def now(self) -> float: ...

    def sleep_until(self, moment: float) -> None: ...


class SystemClock:
    """CLOCK_MONOTONIC: shared by all processes of one machine."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        remaining = moment - time.monotonic()
        if remaining > 0:
            time.sleep(remaining)


class VirtualClock:
    """A clock that jumps from one scheduled call to the next, so nothing ever waits."""

    def __init__(self, start: float = 0.0) -> None:
        self._now = start
        self._calls: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def now(self) -> float:
        return self._now

    def call_at(self, moment: float, call: Callable[[], None]) -> None:
        """Schedules `call`; calls for the same moment run in the order they were made."""
        heapq.heappush(self._calls, (moment, next(self._order), call))

    def advance(self, until: float) -> bool:
        """Runs the next call if it is due by `until`, else jumps there; True if one ran."""
        if self._calls and self._calls[0][0] <= until:
            moment, _, call = heapq.heappop(self._calls)
            self._now = max(self._now, moment)
            call()
            return True
        self._now = max(self._now, until)
        return False

    def sleep_until(self, moment: float) -> None:
        while self.advance(moment):
            pass


SYSTEM_CLOCK = SystemClock()
