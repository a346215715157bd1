"""Frames from markers that come one by one, for wires without frames or layouts of their own."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drivers.frame import Layout, MarkerFrame
from drivers.options import positive
from drivers.url import Url

CONFIRM = 3  # times that a label has to come before it is believed: a flipped bit makes no marker
WITHIN = 2.0  # s in which they have to come
MOST = 255  # labels of one stream, and of one frame
SEEN = 1.0  # s after which a frame no longer waits for a marker that does not come
GONE = 60.0  # s after which a label's place may be given to another
PAUSE = 0.7  # share of the time between two comings of a marker that is a pause between frames
STEADY = 3  # whole frames in one order after which that is the order
ASSUMED = 120.0  # Hz, until the rate is known
MEASURE = 1.0  # s over which the rate is measured
CHANGED = 0.05  # share by which the rate has to differ to be another one
USUAL = (
    *(24, 25, 30, 48, 50, 60, 72, 75, 90, 100, 120, 144, 150, 180, 200, 240, 250, 300, 360, 400),
    *(480, 500, 1000),
)
ROUND = 0.02  # share within which a measured rate is a usual one

_NOWHERE = (math.nan,) * 3


class Assembler:
    """Collects markers until a frame is whole, learns the layout, and measures the rate.

    A frame ends with the last of the markers that came within the last second, so it is not held
    back; else with the first marker of the next: one that comes again, that bears another index,
    or that stands before the newest in the order in which the markers keep coming. While no order
    is known, a pause ends a frame; once it is, time has no say, for a line may deliver the markers
    of one frame in two portions, or those of many frames in one.

    Counts markers that came after their frame (`late_markers`), of labels not believed yet
    (`unconfirmed`), and labels beyond 255 (`too_many_labels`).

    rate: the stream's in Hz where it is known, else it is measured. order: the labels as they stand
    in each frame, where the wire fixes that.
    """

    def __init__(
        self, counters: Counter[str], rate: float | None = None, order: Sequence[str] = ()
    ) -> None:
        self.counters = counters
        self._fixed_rate = rate
        self._fixed_order = order
        self.reset()

    def reset(self) -> None:
        """Forgets layout and rate, and a frame begun."""
        self.layout: Layout | None = None
        self._rows: dict[str, int] = {}
        self._seen: dict[str, float] = {}  # when each label of the layout came last
        self._heard: dict[str, _Heard] = {}  # the others
        self._order = _Order(self._fixed_order)
        # The newest frame: its markers as they came, those it waits for, whether it was sent.
        self._markers: dict[str, Sequence[float]] = {}
        self._awaited: set[str] = set()
        self._sent = False
        self._given: int | None = None  # its index, where the wire has one
        self._index = -1
        self._t = self._t_device = math.nan
        self._stamp = math.nan  # of the frame sent last
        self._interval = math.inf  # s since its markers came before, the shortest
        self._rate = _Rate(self._fixed_rate)

    def add(
        self,
        label: str,
        xyz: Sequence[float],
        t: float,
        t_device: float = math.nan,
        index: int | None = None,
    ) -> list[MarkerFrame]:
        """Takes in a marker, three numbers in the wire's unit; the frames that are whole now.

        A marker that the wire names without a place (lost) is three NaN. index: the device's
        number for the frame, where the wire gives it with each marker.
        """
        frames = []
        if self._is_of_next(label, t, index):
            frames = self.end()
            self._awaited = {name for name, seen in self._seen.items() if self._t - seen <= SEEN}
        self._given = index
        self._markers[label] = xyz
        self._awaited.discard(label)
        self._t, self._t_device = t, t_device
        self._interval = min(self._interval, self._since(label, t))
        self._hear(label, t)
        if self._sent:
            self.counters["late_markers"] += 1
        elif not self._awaited and label in self._rows:
            frames += self._send()
        return frames

    def put(
        self,
        markers: Mapping[str, Sequence[float]],
        t: float,
        t_device: float = math.nan,
        index: int | None = None,
    ) -> list[MarkerFrame]:
        """Takes in a frame that the wire gives whole, even one without markers."""
        frames = self.end()
        self._markers = dict(markers)
        self._given, self._t, self._t_device = index, t, t_device
        for label in markers:
            self._hear(label, t)
        self._learn()
        frames += self._send(whole=True)
        self._close()
        return frames

    def end(self, index: int | None = None) -> list[MarkerFrame]:
        """The frame begun is whole. index: the device's number for it, where there is one."""
        if index is not None and self._markers:
            self._given = index
        self._learn()
        frames = [] if self._sent else self._send(whole=self._given is not None)
        self._close()
        return frames

    def _close(self) -> None:
        self._markers, self._given, self._sent = {}, None, False
        self._interval = math.inf

    def _is_of_next(self, label: str, t: float, index: int | None) -> bool:
        """Whether a marker is of the frame after the newest."""
        if not self._markers or label in self._markers or len(self._markers) >= MOST:
            return True
        if index is not None:
            return index != self._given
        if label in self._order:
            return self._order.runs_back(label, self._markers)
        return t - self._t > PAUSE * min(self._since(label, t), self._interval)

    def _since(self, label: str, t: float) -> float:
        """Seconds since a label came last."""
        if label in self._seen:
            return t - self._seen[label]
        return t - self._heard[label].last if label in self._heard else math.inf

    def _send(self, *, whole: bool = False) -> list[MarkerFrame]:
        """The newest frame, as far as its labels are believed. whole: even if none is."""
        places = [_NOWHERE] * len(self._rows)
        known = 0
        for label, place in self._markers.items():
            row = self._rows.get(label)
            if row is not None:
                places[row] = (place[0], place[1], place[2])
                known += 1
        if known < len(self._markers):
            self.counters["unconfirmed"] += len(self._markers) - known
        if self.layout is None or not (known or whole):
            return []
        self._sent = True
        self._index = self._index + 1 if self._given is None else self._given
        # A time that stands still (seconds since 1970 in a float32 do) says nothing.
        t_device = math.nan if self._t_device == self._stamp else self._t_device
        self._stamp = self._t_device
        if self._rate.measure(self._t if math.isnan(t_device) else t_device, self._index):
            self._lay_out(self.layout.labels)
        with np.errstate(over="ignore"):  # too large for float32: infinite, and out of range
            xyz = np.array(places, np.float32)
        xyz[np.isnan(xyz).any(axis=1)] = np.nan
        return [MarkerFrame(self._index, self._t, t_device, self.layout, xyz)]

    def _hear(self, label: str, t: float) -> None:
        """Notes that a label came."""
        if label in self._rows:
            self._seen[label] = t
            return
        heard = self._heard.get(label)
        if heard is None or t - heard.first > WITHIN:
            if len(self._heard) >= MOST:
                self._heard = {k: v for k, v in self._heard.items() if t - v.last <= WITHIN}
            if len(self._heard) >= MOST:
                self._heard.clear()
            heard = _Heard(0, t, t)
        self._heard[label] = _Heard(heard.times + 1, heard.first, t)

    def _learn(self) -> None:
        """Takes the labels of the newest frame that came often enough into the layout, and learns
        the order of its markers."""
        if self._heard:
            new = [name for name in self._markers if name in self._heard]
            new = [name for name in new if self._heard[name].times >= CONFIRM]
            if new:
                self._take_in(new)
        came = [name for name in self._markers if name in self._rows]
        self._order.learn(came, whole=not self._awaited)

    def _take_in(self, new: list[str]) -> None:
        labels = list(self._rows)
        if len(labels) + len(new) > MOST:
            labels = [name for name in labels if self._t - self._seen[name] <= GONE]
            self._order.forget()
        room = MOST - len(labels)
        if room < len(new):
            self.counters["too_many_labels"] += len(new) - room
        self._seen = {name: self._seen[name] for name in labels}
        for name in new:
            heard = self._heard.pop(name)
            if room > 0:
                room -= 1
                self._seen[name] = heard.last
        if tuple(self._seen) != tuple(self._rows):
            self._lay_out(tuple(self._seen))

    def _lay_out(self, labels: tuple[str, ...]) -> None:
        self._rows = {label: row for row, label in enumerate(labels)}
        self.layout = Layout(labels, self._rate.value)


class Assembled:
    """What a decoder leaves to its Assembler, `_frames`."""

    _frames: Assembler

    @property
    def layout(self) -> Layout | None:
        return self._frames.layout

    @property
    def counters(self) -> Counter[str]:
        return self._frames.counters

    @counters.setter
    def counters(self, counters: Counter[str]) -> None:
        self._frames.counters = counters


def take_rate(url: Url) -> float | None:
    """The option `rate` of an address, in Hz. Raises UrlError."""
    return url.take("rate", None, _hertz)


def _hertz(text: str) -> float:
    if positive(text) >= 1e6:
        raise ValueError("a stream has less than 1,000,000 frames a second")
    return float(text)


class _Heard(NamedTuple):
    """How often a label came that is not believed yet, and when first and last."""

    times: int
    first: float
    last: float


class _Order:
    """The order in which the markers of a frame keep coming, once that is known.

    It is forgotten when it splits a frame in two: parts that have no marker in common.
    """

    def __init__(self, fixed: Sequence[str] = ()) -> None:
        self._fixed = fixed
        self.forget()

    def forget(self) -> None:
        self._places = {label: place for place, label in enumerate(self._fixed)}
        self._candidate: list[str] = []
        self._times = 0
        self._splits = False  # whether the newest frame ended because of the order
        self._before: list[str] = []  # the markers of the frame before, if that did

    def __contains__(self, label: str) -> bool:
        return label in self._places

    def runs_back(self, label: str, frame: dict[str, Sequence[float]]) -> bool:
        """Whether a marker stands before the newest one of a frame."""
        newest = next((name for name in reversed(frame) if name in self._places), label)
        self._splits = self._places[label] < self._places[newest]
        return self._splits

    def learn(self, came: list[str], *, whole: bool) -> None:
        """From a frame that has ended: its markers as they came."""
        split = self._before and not set(came) & set(self._before)
        self._before = came if self._splits else []
        self._splits = False
        if split:
            self.forget()
        elif self._places:
            if not self._places.keys() >= set(came):
                self._insert(came)
        elif whole and came:
            self._times = self._times + 1 if came == self._candidate else 1
            self._candidate = came
            if self._times >= STEADY:
                self._places = {label: place for place, label in enumerate(came)}

    def _insert(self, came: list[str]) -> None:
        """Labels that are new stand behind those that they came behind."""
        order = list(self._places)
        at = 0
        for label in came:
            if label not in self._places:
                order.insert(at, label)
            at = order.index(label) + 1
        self._places = {label: place for place, label in enumerate(order)}


class _Rate:
    """The rate of a stream in Hz: as given, or measured over a second at a time."""

    def __init__(self, fixed: float | None) -> None:
        self.value = fixed or ASSUMED
        self._fixed = fixed is not None
        self._first: tuple[float, int] | None = None  # time and index of the first frame measured
        self._measured: float | None = None

    def measure(self, now: float, index: int) -> bool:
        """Takes in a frame; whether the rate is another one now.

        After the first second it takes two that agree: lost frames make no other rate.
        """
        if self._fixed:
            return False
        if self._first is None or not 0 <= now - self._first[0] < 2 * MEASURE:
            self._first = (now, index)
            return False
        seconds, frames = now - self._first[0], index - self._first[1]
        if seconds < MEASURE or frames < 2:
            return False
        self._first = (now, index)
        rate = frames / seconds
        rate = min((r for r in USUAL if abs(r - rate) <= ROUND * r), default=rate)
        agrees = self._measured is None or abs(rate - self._measured) <= CHANGED * rate
        self._measured = rate
        if not agrees or rate >= 1e6 or abs(rate - self.value) <= CHANGED * self.value:
            return False
        self.value = float(rate)
        return True
