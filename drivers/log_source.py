"""A recorded session once more: `log:session.mcap?speed=1`, through the drivers that it came by."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Generic, TypeVar

from drivers.clock import Clock
from drivers.frame import MarkerFrame, Source, SourceError
from drivers.ownership import OwnedSource
from drivers.session_log import LOST, LineBytes, LineEvent, SessionLog
from drivers.transport import Received, TransportLost
from drivers.url import Url, UrlError
from drivers.wire.registry import take_decoder
from drivers.wire_source import reorder_of

TRUTH = "truth"  # the name in logs of what is no source of the session

T = TypeVar("T", bound=MarkerFrame | LineBytes | LineEvent)


class _Playback(Generic[T]):
    """What a log tells, at the times it tells, later by `shift` seconds."""

    def __init__(self, entries: Iterator[T], start: float, clock: Clock, speed: float) -> None:
        self.shift = clock.now() - start
        self._entries = entries
        self.next: T | None = next(entries, None)  # None at the end
        self._start = start
        self._clock = clock
        self._speed = speed

    def due(self, timeout: float) -> bool:
        """Whether it is time for the next one, having waited for `timeout` seconds at most."""
        if self.next is None or self._speed == math.inf:
            return self.next is not None
        moment = self._start + self.shift + (_time(self.next) - self._start) / self._speed
        self._clock.sleep_until(min(moment, self._clock.now() + timeout))
        return self._clock.now() >= moment

    def take(self) -> T:
        """The next one; there is one, as it is due."""
        assert self.next is not None
        taken, self.next = self.next, next(self._entries, None)
        return taken


def _time(entry: MarkerFrame | LineBytes | LineEvent) -> float:
    return entry.received.t if isinstance(entry, LineBytes) else entry.t


class LogLine:
    """The line of a recorded source, as a transport that is lost and found when it was then."""

    def __init__(self, playback: _Playback[LineBytes | LineEvent]) -> None:
        self._playback = playback
        self._lost = False

    @property
    def ended(self) -> bool:
        return self._playback.next is None

    def connect(self) -> LogLine:
        """Raises SourceError as long as the line was gone."""
        if self._lost and not self._playback.due(0.0):
            raise SourceError("the line was lost")
        self._lost = False
        return self

    def receive(self, timeout: float) -> Received | None:
        while self._playback.due(timeout):
            entry = self._playback.take()
            if isinstance(entry, LineBytes):
                received = entry.received
                return received._replace(t=received.t + self._playback.shift)
            if entry.event == LOST:
                self._lost = True
                raise TransportLost("the line was lost")
        return None

    def send(self, data: bytes) -> None:
        """Nothing: a log does not answer."""

    def close(self) -> None:
        """Nothing: it is opened again and again."""


class LogSource(OwnedSource):
    """The bytes of a recorded source, decoded as the options of `wire` say; those that nothing
    took are left there. address: what it would be recorded from, should it be recorded again.
    """

    live = False

    def __init__(self, wire: Url, address: str, line: LogLine, clock: Clock) -> None:
        """Raises UrlError for an option that is wrong."""
        self.address = address
        decoder, convention = take_decoder(wire)
        reorder = reorder_of(wire)
        super().__init__(
            wire.text, line.connect, decoder, clock, convention=convention, reorder=reorder
        )
        self._line = line

    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        if not self._line.ended:
            return super()._receive(timeout)
        self.exhausted = True
        return self._finished(self._sequence.flush())


class LogFrames(Source):
    """The frames of a log that holds no bytes: the source of its session was a file."""

    live = False

    def __init__(self, name: str, playback: _Playback[MarkerFrame], clock: Clock) -> None:
        super().__init__(name, clock)
        self._playback = playback

    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        if self._playback.next is None:
            self.exhausted = True
        if not self._playback.due(timeout):
            return None
        frame, shift = self._playback.take(), self._playback.shift
        self.layout = frame.layout
        return (replace(frame, t=frame.t + shift, t_mapped=frame.t_mapped + shift),)


def open_log(url: Url, clock: Clock) -> Source:
    """The source at `log:FILE?speed=1` (or a factor above 1, or `max`: as fast as it is read).

    `source` names one of several; by default the first that is not the truth. What else the
    address says is in place of what the recorded address said: labels, frame, reorder and so on.
    Raises UrlError or SourceError.
    """
    return play_log(SessionLog(Path(url.file_path())), url, clock)


def play_log(log: SessionLog, url: Url, clock: Clock) -> Source:
    """The same of a log that has been opened: what is not whole of it is not said again."""
    path = url.file_path()
    speed = url.take("speed", 1.0, _speed)
    name = url.take("source", _first(log), _among(log))
    if not name:
        url.finish()
        if not log.holds["frames"]:
            raise SourceError(f"{path} holds neither bytes nor frames of a source")
        return LogFrames(url.text, _Playback(log.frames(), log.start, clock, speed), clock)
    try:
        recorded = Url.parse(log.sources[name])
    except UrlError as error:
        raise SourceError(f"{path}: {name} was recorded from no address: {error}") from error
    options = recorded.options | url.options
    address = Url.parse(recorded.text.partition("?")[0]).adding(options).text
    wire = replace(recorded, text=url.text, options=options, known=url.known)
    line = LogLine(_Playback(log.lines(name), log.start, clock, speed))
    source = LogSource(wire, address, line, clock)
    # Of the recorded address all is well: what is no option of the wire was one of its port.
    url.options = {name: url.options[name] for name in url.options if name in wire.options}
    url.finish()
    return source


def _first(log: SessionLog) -> str:
    """The source that is meant where none is named; none where there is none."""
    return next((name for name in log.sources if name != TRUTH), next(iter(log.sources), ""))


def _among(log: SessionLog) -> Callable[[str], str]:
    def check(name: str) -> str:
        if name not in log.sources:
            raise ValueError(f"the log has {', '.join(log.sources) or 'none'}")
        return name

    return check


def _speed(text: str) -> float:
    speed = math.inf if text == "max" else float(text)
    if not speed >= 1:
        raise ValueError("it is a factor from 1 on, or max")
    return speed
