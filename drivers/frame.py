"""The types that every part of markerbridge shares: layout, marker frame, source.

Positions are metres, right-handed, Z up, float32; a missing marker is a NaN row.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import MarkerbridgeError

LATE = 100  # inputs without a frame that `read` takes in past its deadline

Floats = npt.NDArray[np.float32]
Rows = npt.NDArray[np.intp]


FARTHEST = 10_000.0  # m: no marker is farther away; larger numbers are a broken sender's


def in_range(xyz: Floats) -> npt.NDArray[np.bool_]:
    """Where coordinates are numbers that can be meant, in metres."""
    return np.abs(xyz) <= FARTHEST  # a NaN compares false


class SourceError(MarkerbridgeError):
    """A source cannot be opened or read; the message names it and says what to do."""


@dataclass(frozen=True, slots=True)
class Layout:
    """What the rows of a frame mean: marker labels in order, and the device's rate in Hz."""

    labels: tuple[str, ...]
    rate: float

    def __post_init__(self) -> None:
        if len(set(self.labels)) != len(self.labels):
            twice = sorted({label for label in self.labels if self.labels.count(label) > 1})
            raise ValueError(f"marker labels occur twice: {', '.join(twice)}")
        if not (0 < self.rate < 1e6):
            raise ValueError(f"rate {self.rate} Hz is not between 0 and 1,000,000")

    def places(self, labels: Sequence[str]) -> tuple[Rows, Rows]:
        """Of the `labels` that are here: their rows among those, and their rows here."""
        own = {label: row for row, label in enumerate(self.labels)}
        pairs = [(row, own[label]) for row, label in enumerate(labels) if label in own]
        both = np.array(pairs, np.intp).reshape(-1, 2)
        return both[:, 0], both[:, 1]


@dataclass(frozen=True, slots=True, eq=False)
class MarkerFrame:
    """One sample of all markers of a stream.

    index: the device's own frame number; where its wire has none, counted by us. t: seconds on the
    host's monotonic clock at receipt. t_device: seconds on the device's clock; NaN where it sends
    none. xyz: (M, 3) float32 metres, in the order of layout.labels, NaN rows where a marker is
    missing. t_mapped: t_device on the host's clock, as near as can be told; `t` without a stamp.
    t_parsed: seconds on the host's clock when it was read; NaN where nothing had to be.
    """

    index: int
    t: float
    t_device: float
    layout: Layout
    xyz: Floats
    t_mapped: float = math.nan
    t_parsed: float = math.nan

    def ordered(self, labels: Sequence[str]) -> Floats:
        """The markers (M, 3) of `labels`, in their order; NaN where there is none."""
        rows, own = self.layout.places(labels)
        xyz: Floats = np.full((len(labels), 3), np.nan, np.float32)
        xyz[rows] = self.xyz[own]
        return xyz


class Source(ABC):
    """A stream of marker frames.

    A driver writes one hook, `_receive`; time-outs, iteration and queueing are here. `counters`
    counts, by name, everything that was received and everything that was not delivered. `live`:
    whether frames come whether or not they are read; a file waits.
    """

    live = True

    def __init__(self, name: str, clock: Clock = SYSTEM_CLOCK) -> None:
        self.name = name
        self.clock = clock
        self.counters: Counter[str] = Counter()
        self.exhausted = False  # True once no further frame can come: the end of a file
        self.layout: Layout | None = None
        self._ready: deque[MarkerFrame] = deque()

    @abstractmethod
    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        """Waits at most `timeout` seconds for input; the frames it completed, None for no input."""

    @property
    def ready(self) -> bool:
        """Whether `read` has another frame at once."""
        return bool(self._ready)

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the newest layout; empty before the first one."""
        return self.layout.labels if self.layout else ()

    def read(self, timeout: float = 1.0) -> MarkerFrame | None:
        """The next frame, or None when `timeout` seconds pass or the source is exhausted."""
        deadline = self.clock.now() + timeout
        late = 0
        while not self._ready:
            remaining = max(0.0, deadline - self.clock.now())
            # What has come already is read even past the deadline, but not for ever: rubbish may
            # come as fast as it is read.
            late += remaining == 0.0
            if self.exhausted or late > LATE:
                return None
            received = self._receive(remaining)
            if received is None and remaining == 0.0:
                return None
            self._ready.extend(received or ())
        self.counters["frames"] += 1
        return self._ready.popleft()

    def __iter__(self) -> Iterator[MarkerFrame]:
        while not (self.exhausted and not self._ready):
            frame = self.read()
            if frame is not None:
                yield frame

    def close(self) -> None:
        """Frees what the source holds; a second call does nothing."""
        self.exhausted = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
