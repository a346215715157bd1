"""Device stamps on the host's clock: when a frame was measured, not when it happened to arrive."""

from __future__ import annotations

import math
from collections import Counter, deque

import numpy as np

BUCKET = 1.0  # s of which the quickest frame is kept
WINDOW = 60  # buckets: a minute
ENOUGH = 10  # buckets from which drift is told
MOST_DRIFT = 5e-4  # a quartz clock is an order better
JUMP = 0.25  # s by which a device's clock has to leap to be another clock
LATEST = 1e11  # s: what is beyond is no time


class ClockMap:
    """Maps device time to host time: a line below all (device, receive - device) of a minute.

    No frame arrives before it is sent, so the smallest difference is the truest; the others are
    delays. Drift is the median slope (Theil and Sen) of the smallest differences of each second. A
    stamp that runs back, or is later than it can be by more than a quarter of a second, is of a
    clock that was set: the map begins anew (`clock_jumps`). One that stands still says nothing.
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters = counters
        self.reset()

    def reset(self) -> None:
        """Another device, or the same one started anew."""
        self._buckets: deque[tuple[float, float]] = deque(maxlen=WINDOW)  # device, difference
        self._opened = -math.inf  # device time of the newest bucket's beginning
        self._last = -math.inf
        self._offset = math.nan  # of the line at device time `_origin`
        self._origin = 0.0
        self.drift = 0.0  # seconds the host's clock gains on the device's, per second of the device

    @property
    def offset(self) -> float:
        """Host time less device time now, in seconds; NaN before the first stamp."""
        return self._offset + self.drift * (self._last - self._origin)

    def map(self, t: float, t_device: float) -> float:
        """Host time of a frame received at `t` and stamped `t_device`; `t` where that says nothing,
        as NaN does.
        """
        if t_device == self._last or not abs(t_device) < LATEST:
            return t
        difference = t - t_device
        if t_device < self._last or self._expected(t_device) - difference > JUMP:
            self._counters["clock_jumps"] += 1
            self.reset()
        self._last = t_device
        if t_device - self._opened >= BUCKET:
            self._opened = t_device
            self._buckets.append((t_device, difference))
            self._fit()
        elif difference < self._buckets[-1][1]:
            self._buckets[-1] = (t_device, difference)
        expected = self._expected(t_device)
        if difference < expected:  # quicker than any before
            self._offset += difference - expected
            expected = difference
        return t_device + expected

    def _expected(self, t_device: float) -> float:
        return self._offset + self.drift * (t_device - self._origin)

    def _fit(self) -> None:
        """The line: its slope by the quickest frames of each second, its height below them all."""
        device, difference = np.array(self._buckets).T
        self._origin = float(device[-1])
        since = device - self._origin
        if len(since) >= ENOUGH:
            later, earlier = np.tril_indices(len(since), -1)
            run = since[later] - since[earlier]
            slope = np.median((difference[later] - difference[earlier]) / run)
            self.drift = float(np.clip(slope, -MOST_DRIFT, MOST_DRIFT))
        self._offset = float((difference - self.drift * since).min())
