"""Frames from markers that come one by one, for wires without frames or layouts of their own."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from drivers.frame import Floats, Layout, MarkerFrame

CONFIRM = 3  # times that a label has to come before it is believed: a flipped bit makes no marker
MOST = 255  # labels of one stream
SEEN = 1.0  # s after which a frame no longer waits for a marker that does not come
GONE = 60.0  # s after which a label's place may be given to another
ASSUMED = 120.0  # Hz, until the rate is known
MEASURE = 1.0  # s over which the rate is measured
CHANGED = 0.05  # share by which the rate has to differ to be another one
USUAL = (24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 150, 180, 200, 240, 250, 300, 360, 400)
ROUND = 0.02  # share within which a measured rate is a usual one


class Assembler:
    """Collects markers until a frame is whole, learns the layout, and measures the rate.

    A frame is whole when all markers seen within the last second are in, when one comes again,
    when the next comes more than half an interval after the first, or when the wire says so
    (`end`). Counts markers that came after their frame (`late_markers`), of labels not believed yet
    (`unconfirmed`), and beyond 255 labels (`too_many_labels`).

    rate: the stream's in Hz where it is known, else it is measured.
    """

    def __init__(self, counters: Counter[str], rate: float | None = None) -> None:
        self.counters = counters
        self._fixed_rate = rate
        self.reset()

    def reset(self) -> None:
        """Forgets layout and rate, and a frame begun."""
        self.layout: Layout | None = None
        self._rate = self._fixed_rate or ASSUMED
        self._rows: dict[str, int] = {}
        self._seen: dict[str, float] = {}
        self._heard: Counter[str] = Counter()
        self._markers: dict[str, Sequence[float]] = {}
        self._last: set[str] = set()  # labels of the frame before, while a marker may come late
        self._begun = -math.inf
        self._t = self._t_device = math.nan
        self._index = -1
        self._first: tuple[float, int] | None = None  # time and index of the first frame measured

    def add(
        self, label: str, xyz: Sequence[float], t: float, t_device: float = math.nan
    ) -> list[MarkerFrame]:
        """Takes in a marker, three numbers in the wire's unit; the frames that are whole now.

        A marker that the wire names without a place (lost) is three NaN.
        """
        frames = []
        late = t - self._begun > 0.5 / self._rate
        if self._markers and (label in self._markers or late):
            frames = self.end()
        elif not self._markers and not late and self._last and label not in self._last:
            self.counters["late_markers"] += 1
            self._believe(label, t)
            return frames
        if not self._markers:
            self._begun = t
        self._markers[label] = xyz
        self._t, self._t_device = t, t_device
        self._believe(label, t)
        if self._rows and self._rows.keys() & self._expected(t) <= self._markers.keys():
            frames += self.end()
        return frames

    def end(self, index: int | None = None) -> list[MarkerFrame]:
        """The frame begun is whole. index: the device's number for it, where there is one."""
        markers, self._markers = self._markers, {}
        self._last = set(markers)
        known = [label for label in markers if label in self._rows]
        self.counters["unconfirmed"] += len(markers) - len(known)
        if not known or self.layout is None:
            return []
        self._index = self._index + 1 if index is None else index
        self._measure_rate()
        xyz: Floats = np.full((len(self.layout.labels), 3), np.nan, np.float32)
        for label in known:
            xyz[self._rows[label]] = markers[label]
        xyz[~np.isfinite(xyz).all(axis=1)] = np.nan
        return [MarkerFrame(self._index, self._t, self._t_device, self.layout, xyz)]

    def _expected(self, t: float) -> set[str]:
        return {label for label, seen in self._seen.items() if t - seen <= SEEN}

    def _believe(self, label: str, t: float) -> None:
        """Counts a label, and takes it into the layout when it has come often enough."""
        if label in self._rows:
            self._seen[label] = t
            return
        if len(self._heard) >= MOST:
            self._heard.clear()
        self._heard[label] += 1
        if self._heard[label] < CONFIRM:
            return
        labels = list(self._rows)
        if len(labels) >= MOST:
            labels = [name for name in labels if t - self._seen[name] <= GONE]
            if len(labels) >= MOST:
                self.counters["too_many_labels"] += 1
                return
        del self._heard[label]
        self._seen = {name: self._seen[name] for name in labels} | {label: t}
        self._lay_out((*labels, label))

    def _lay_out(self, labels: tuple[str, ...]) -> None:
        self._rows = {label: row for row, label in enumerate(labels)}
        self.layout = Layout(labels, self._rate)

    def _measure_rate(self) -> None:
        if self._fixed_rate:
            return
        now = self._t if math.isnan(self._t_device) else self._t_device
        if self._first is None or not 0 <= now - self._first[0] < 2 * MEASURE:
            self._first = (now, self._index)
            return
        seconds, frames = now - self._first[0], self._index - self._first[1]
        if seconds < MEASURE or frames < 2:
            return
        self._first = None
        rate = frames / seconds
        rate = min((r for r in USUAL if abs(r - rate) <= ROUND * r), default=rate)
        if abs(rate - self._rate) > CHANGED * self._rate and rate < 1e6:
            self._rate = float(rate)
            self._lay_out(tuple(self._rows))
