"""Frames in the order of their indices: gaps, duplicates and late frames told from each other."""

from __future__ import annotations

from collections import Counter, deque

from drivers.frame import MarkerFrame

LEAP = 1200  # frames: a larger step is another count, not lost or late frames
RESTART = 8  # old frames in a row, in order, after which the device has started anew
OVERTAKEN = 8  # frames that no frame is later than


class Sequence:
    """Delivers each index once and in order. depth: frames that wait for one that is late, 0 to 3.

    Counts `missing` (indices that never came), `late` (came after their turn had been given up;
    they are no longer missing then), `duplicates`, `reordered` (put right by the buffer),
    `restarts`, and `bad_indices`: a leap after which the count goes on where it was.
    """

    def __init__(self, counters: Counter[str], depth: int = 0) -> None:
        self._counters = counters
        self._depth = depth
        self._waiting: dict[int, MarkerFrame] = {}
        self._next: int | None = None
        self._given_up: deque[int] = deque(maxlen=LEAP)
        self._old: list[int] = []  # indices of old frames in a row
        self._steady: int | None = None  # what follows the last index that came when it was due

    def reset(self) -> None:
        """The device may count anew from here."""
        self._waiting.clear()
        self._given_up.clear()
        self._old = []
        self._next = None
        self._steady = None

    @property
    def waiting(self) -> bool:
        """Whether frames wait for one that is late."""
        return bool(self._waiting)

    def put(self, frame: MarkerFrame) -> list[MarkerFrame]:
        """The frames whose turn it is now."""
        index = frame.index
        if self._next is None:
            return self._begin(frame)
        if self._is_back(index):
            self._counters["bad_indices"] += 1
            return self._begin(frame)
        if abs(index - self._next) > LEAP:
            self._counters["restarts"] += 1
            return self._begin(frame)
        if index < self._next:
            return self._put_old(frame)
        self._old = []
        if index in self._waiting:
            self._counters["duplicates"] += 1
            return []
        if self._waiting and index < max(self._waiting):
            self._counters["reordered"] += 1
        if index == self._next:
            self._steady = index + 1
        self._waiting[index] = frame
        # One far ahead does not wait: were its index wrong, it would keep its place for long.
        return self._due(self._depth if index - self._next < OVERTAKEN else 0)

    def flush(self) -> list[MarkerFrame]:
        """The frames that still wait, when nothing comes any more."""
        return self._due(0)

    def _due(self, depth: int) -> list[MarkerFrame]:
        due: list[MarkerFrame] = []
        if self._next is None:
            return due
        while self._waiting and (self._next in self._waiting or len(self._waiting) > depth):
            first = min(self._waiting)
            if first > self._next:
                self._counters["missing"] += first - self._next
                self._given_up.extend(range(self._next, first))
            due.append(self._waiting.pop(first))
            self._next = first + 1
        return due

    def _put_old(self, frame: MarkerFrame) -> list[MarkerFrame]:
        """A frame whose turn has passed: a copy, late, or the first of a new count."""
        index = frame.index
        if self._old and index <= self._old[-1]:
            self._old = []
        self._old.append(index)
        if len(self._old) == RESTART:
            self._counters["restarts"] += 1
            return self._begin(frame)
        if index in self._given_up:
            self._given_up.remove(index)
            self._counters["missing"] -= 1
            self._counters["late"] += 1
        else:
            self._counters["duplicates"] += 1
        return []

    def _is_back(self, index: int) -> bool:
        """Whether the count goes on before a leap that nothing has confirmed: one index was wrong,
        as on a wire without checksums.
        """
        assert self._next is not None
        return (
            self._steady is not None
            and abs(self._next - self._steady) > OVERTAKEN
            and 0 <= index - self._steady < OVERTAKEN
        )

    def _begin(self, frame: MarkerFrame) -> list[MarkerFrame]:
        """Counts from this frame on; what waits comes first."""
        due = self.flush()
        # What was given up for a leap that nothing confirmed is still to come.
        steady = self._steady
        still = frame.index if steady is None else max(frame.index, steady)
        self._counters["missing"] -= sum(index >= still for index in self._given_up)
        self.reset()
        self._next = frame.index + 1
        self._steady = steady
        return [*due, frame]
