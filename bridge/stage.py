"""The run loop: sources on the one side, the sessions of performers on the other.

The threads that frames travel on are here and in the sinks' outlets. A frame is taken through by
the thread that read it: to hand it over would cost as much as to estimate it. What comes meanwhile
is read before the next is taken through, and waits in a queue of a second.
"""

from __future__ import annotations

import math
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

from bridge.cast import Cast
from bridge.estimator import Jointly
from bridge.session import Session, Status
from bridge.sinks.sink import close_all
from bridge.statistics import Ages
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import MarkerFrame

T = TypeVar("T")

FIFO = 1.0  # s of frames that may wait for the estimator
POLL = 0.1  # s between looks at whether to stop
AT_ONCE = 64  # frames that are read before one is taken through: a flood must not keep it waiting
SWITCH = 0.0005  # s that a thread which tells of a session may keep a frame waiting


class Stage:
    """Sessions that run together, and their sources."""

    def __init__(self, casts: Sequence[Cast], *, clock: Clock = SYSTEM_CLOCK) -> None:
        self.casts = list(casts)
        self.sessions = {name: session for cast in casts for name, session in cast.sessions.items()}
        self._clock = clock
        self._jointly = Jointly([session.estimator for session in self.sessions.values()])
        self._taking = threading.Lock()  # whoever takes frames through holds it
        self._finished = threading.Event()
        self._ended = threading.Event()  # a reader has
        self._error: Exception | None = None

    @classmethod
    def of(cls, session: Session, *, clock: Clock = SYSTEM_CLOCK) -> Stage:
        """One performer alone."""
        return cls([Cast(session.source, {session.performer: session}, alone=True)], clock=clock)

    @property
    def name(self) -> str:
        """The addresses of all sources."""
        return " ".join(cast.source.name for cast in self.casts)

    def run(self, stop: threading.Event, seconds: float | None = None) -> None:
        """Takes frames through until `stop` is set, the sources end, or `seconds` have passed.

        Raises what a source raised, after all that was delivered has been taken through.
        """
        for session in self.sessions.values():
            session.start()
        end = None if seconds is None else self._clock.now() + seconds
        readers = [
            threading.Thread(target=self._read, args=(cast,), name=cast.source.name, daemon=True)
            for cast in self.casts
        ]
        with _quick_switches():
            for reader in readers:
                reader.start()
            try:
                while any(reader.is_alive() for reader in readers):
                    left = POLL if end is None else min(POLL, end - self._clock.now())
                    if stop.is_set() or self._error or left <= 0:
                        break
                    self._ended.wait(left)
                    self._ended.clear()
                    self._tell_lost()
            finally:
                self._finished.set()
                for reader in readers:
                    reader.join(2.0)
        for cast in self.casts:  # what has come in goes out
            while cast.backlog.frames:
                self._take_oldest(cast)
        if self._error:
            raise self._error

    def close(self) -> None:
        """Closes sources and sinks, recordings whole; a second call does nothing.

        Raises SinkError where a recording could not be saved, after all else is closed.
        """
        close_all(self.sessions.values())

    def status(self) -> Status:
        """What all of it has done so far. Of several performers, the worst of each: the rate that
        is farthest from what it should be, the ages of the hop's slowest; and all markers and
        sinks, by name.
        """
        return _together([known for _, known in self._by_cast()])

    def by_source(self) -> list[tuple[str, Status]]:
        """The same for each source, with its address: of those alone who are in it."""
        return [(cast.source.name, _together([known])) for cast, known in self._by_cast()]

    def _by_cast(self) -> list[tuple[Cast, dict[str, Status]]]:
        return [
            (cast, {name: session.status() for name, session in cast.sessions.items()})
            for cast in self.casts
        ]

    def _take_oldest(self, cast: Cast) -> None:
        """Takes the oldest waiting frame through: those in it who ask the model do so together."""
        with self._taking:
            parts = cast.parts(cast.backlog.frames.popleft())
            asking = [(session, frame) for session, frame in parts if session.begin(frame) is None]
            estimates = self._jointly.estimate([session.estimator for session, _ in asking])
            for (session, frame), estimate in zip(asking, estimates, strict=True):
                session.finish(frame, estimate)

    def _tell_lost(self) -> None:
        with self._taking:
            for session in self.sessions.values():
                session.tell_lost()

    def _read(self, cast: Cast) -> None:
        """A reader's thread."""
        source, backlog = cast.source, cast.backlog
        due = math.inf  # when to rehearse
        try:
            while not self._finished.is_set() and (source.ready or not source.exhausted):
                frame = source.read(min(POLL, max(0.0, due - self._clock.now())))
                if frame is None:
                    if self._clock.now() >= due:
                        due = math.inf
                        cast.rehearse()
                    continue
                if len(self.casts) == 1:  # of several, they would keep each other from their work
                    due = cast.rehearsal_due(frame)
                self._put(cast, frame)
                while backlog.frames and not self._finished.is_set():
                    began = self._clock.now()
                    self._take_oldest(cast)
                    late = self._clock.now() - began > 1.0 / frame.layout.rate
                    for _ in range(AT_ONCE):
                        # What has come is read before more is done, so that it has its true time.
                        if not (source.ready or (late and source.live)):
                            break
                        if (more := source.read(0.0)) is None:
                            break
                        self._put(cast, more)
        except Exception as error:  # for the caller's thread to raise
            self._error = error
        finally:
            self._ended.set()

    def _put(self, cast: Cast, frame: MarkerFrame) -> None:
        """Lets a frame wait; where too many do, the oldest makes room, and is counted."""
        backlog, room = cast.backlog, max(2.0, FIFO * frame.layout.rate)
        backlog.frames.append(frame)
        if len(backlog.frames) > room and cast.source.live:
            cast.record(backlog.frames.popleft())
            backlog.overflow += 1


def _together(casts: Sequence[Mapping[str, Status]]) -> Status:
    """One status of several performers, by name, of each source."""
    known = {name: status for cast in casts for name, status in cast.items()}
    first, *others = known.values()
    if not others:
        return first
    sources = [next(iter(cast.values())) for cast in casts]
    source: Counter[str] = Counter()
    for one in sources:
        source.update(one.source)
    slowest = min(known.values(), key=lambda one: one.rate / (one.layout_rate or 1.0))
    return replace(
        first,
        frames=max(one.frames for one in known.values()),
        rate=slowest.rate,
        layout_rate=slowest.layout_rate,
        silent=min(one.silent for one in known.values()),
        ages={name: _worst(one.ages[name] for one in known.values()) for name in first.ages},
        markers=_by_name({name: one.markers for name, one in known.items()}, ":"),
        imputed_samples=sum(one.imputed_samples for one in known.values()),
        lost_frames=sum(one.lost_frames for one in known.values()),
        missing_indices=source["missing"],
        waiting=sum(one.waiting for one in sources),
        source=dict(source),
        sinks=_by_name({name: one.sinks for name, one in known.items()}, " to "),
        performers=known,
    )


def _worst(ages: Iterable[Ages]) -> Ages:
    return max(ages, key=lambda age: age.p99 or 0.0)


def _by_name(known: Mapping[str, Mapping[str, T]], between: str) -> dict[str, T]:
    return {
        f"{performer}{between}{name}": value
        for performer, own in known.items()
        for name, value in own.items()
    }


@contextmanager
def _quick_switches() -> Iterator[None]:
    """A dashboard that is being drawn gives way to a frame sooner than Python has it."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    try:
        yield
    finally:
        sys.setswitchinterval(usual)
