"""A log with rates, not floods: what goes wrong in a session, a line at a time."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from bridge.repeating import repeating
from drivers.url import short

if TYPE_CHECKING:
    from bridge.session import Status

LOOK = 0.25  # s between looks at the counters
LOG_EVERY = 10.0  # s between sums of what went wrong
SILENT = 2.0  # s without a frame that are worth a line
AWAY = 3.0  # s that a tracked marker is missing that are worth a line
AT_MOST = 1.0  # s between lines about the connection; longer and longer while it comes and goes
# Told as lines about the connection.
CONNECTION = {"disconnects", "reconnects", "silences"}
# Counted, but nothing is wrong with it.
HARMLESS = CONNECTION | {
    *("frames", "bytes", "layouts", "answers", "foreign", "no_markers", "not_ready"),
    "unconfirmed",  # labels of a wire without layouts, until they have come three times
    *("reordered", "rate_limited", "sent", "recorded"),
}

log = logging.getLogger(__name__)


class Watch:
    """Compares a session's counters from look to look; its time is the session's own.

    A source that is lost, silent or there again is told at once; a plug that flaps, less and less
    often, with how often it did. So is a tracked marker that is away for long, and its return. All
    else that was counted is summed up `every` seconds, a line for the source, the truth and each
    sink, if anything went wrong.
    """

    def __init__(self, source: str, every: float = LOG_EVERY) -> None:
        self._source, self._every = short(source), every
        self._sums: dict[str, dict[str, int]] = {}  # counters at the last sum, by name
        self._summed = 0.0  # when the last sum was made
        self._connection = _Connection(source, every)
        self._markers = _Markers(self._source)

    def look(self, status: Status) -> None:
        """To be called some times a second."""
        self._connection.look(status.source, status.seconds)
        self._markers.look(status)
        elapsed = status.seconds - self._summed
        if elapsed < self._every:
            return
        self._summed = status.seconds
        self._sum_up(self._source, status.source, "frames", "frames", elapsed)
        if status.truth:
            self._sum_up("truth", status.truth, "frames", "frames", elapsed)
        for name, sink in status.sinks.items():
            self._sum_up(name, sink, "sent", "poses", elapsed)

    def _sum_up(
        self, name: str, counters: Mapping[str, Any], good: str, unit: str, elapsed: float
    ) -> None:
        now = {key: count for key, count in counters.items() if isinstance(count, int)}
        grown = _growth(self._sums.get(name, {}), now)
        self._sums[name] = now
        wrong = {key: count for key, count in grown.items() if key not in HARMLESS}
        if wrong:
            sums = f"{grown.get(good, 0):,} {unit}, {_listed(wrong)}"
            log.warning("%s: in %.0f s: %s", name, elapsed, sums)


class _Connection:
    """Whether a source is there and sends, told when that changes."""

    def __init__(self, source: str, every: float) -> None:
        self._source, self._most = short(source), every
        self._address = source
        self._told = ""  # what the last line said is wrong: "lost", "silent" or nothing
        self._since = 0.0  # since when
        self._away = False  # at the last look
        self._losses = 0  # up to the last line
        self._counters: dict[str, int] = {}  # at the last frame
        self._frame_at = 0.0
        self._quiet_until, self._pause = 0.0, AT_MOST

    def look(self, counters: Mapping[str, int], now: float) -> None:
        if counters.get("frames") != self._counters.get("frames"):
            self._counters, self._frame_at = dict(counters), now
        away = counters.get("disconnects", 0) > counters.get("reconnects", 0)
        # A silent line is closed and opened again on purpose: at one look it may be away.
        lost, self._away = away and self._away, away
        if now >= self._quiet_until and self._tell(counters, now, lost=lost, away=away):
            calm = now - self._quiet_until > self._most
            self._pause = AT_MOST if calm else min(2 * self._pause, self._most)
            self._quiet_until = now + self._pause

    def _tell(self, counters: Mapping[str, int], now: float, *, lost: bool, away: bool) -> bool:
        """Whether there was something to tell."""
        losses = counters.get("disconnects", 0) - counters.get("silences", 0)
        if lost:
            if self._told == "lost":
                return False
            log.warning("%s: connection lost", self._source)
            self._told, self._since = "lost", now
        elif away:  # told at the next look
            return False
        elif self._told == "lost":
            log.info("%s: found again after %s", self._source, _span(now - self._since))
            self._told, self._frame_at = "", now
        elif losses > self._losses:
            times = losses - self._losses
            often = "" if times == 1 else f", {times} times"
            log.warning("%s: connection lost and found again%s", self._source, often)
        elif now - self._frame_at > SILENT:
            if self._told == "silent":
                return False
            quiet = f"no frames for {SILENT:g} s"
            log.warning("%s: %s: %s", self._source, quiet, self._why(counters))
            self._told, self._since = "silent", self._frame_at
        elif self._told == "silent":
            log.info(
                "%s: frames come again after %s",
                *(self._source, _span(self._frame_at - self._since)),
            )
            self._told = ""
        else:
            return False
        self._losses = losses
        return True

    def _why(self, counters: Mapping[str, int]) -> str:
        grown = _growth(self._counters, counters)
        count = grown.pop("bytes", 0)
        kinds = {name: number for name, number in grown.items() if name not in CONNECTION}
        found = f" ({_listed(kinds)})" if kinds else ""
        if not count:
            refused = kinds.get("refused")
            who = "only packets of senders that the option allow does not name come"
            return f"{who}{found}" if refused else "nothing comes"
        doctor = f"`markerbridge doctor {shlex.quote(self._address)}`, in place of this, tells why"
        return f"{count:,} bytes came, but no frame in them{found}: {doctor}"


class _Markers:
    """Tracked markers that are missing for long, told when they are and when they are back."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._since: dict[str, float] = {}
        self._told: set[str] = set()

    def look(self, status: Status) -> None:
        now = status.seconds
        gone, back = [], []
        if status.silent > LOOK:  # it is not the markers
            return
        for label, marker in status.markers.items():
            if marker.state == "measured":
                since = self._since.pop(label, now)
                if label in self._told:
                    back.append(f"{label} after {_span(now - since)}")
                    self._told.discard(label)
            elif now - self._since.setdefault(label, now) > AWAY and label not in self._told:
                self._told.add(label)
                if marker.missing < status.frames:  # one that the stream has not is told before
                    gone.append(label)
        if gone:
            log.warning("%s: no %s for %g s", self._source, ", ".join(gone), AWAY)
        if back:
            log.info("%s: seen again: %s", self._source, ", ".join(back))


@contextmanager
def watching(
    by_source: Callable[[], Sequence[tuple[str, Status]]], every: float = LOG_EVERY
) -> Iterator[None]:
    """Watches the sources of a running session, each by its address, until the block ends."""
    watches = [Watch(name, every) for name, _ in by_source()]

    def look() -> None:
        for watch, (_, status) in zip(watches, by_source(), strict=True):
            watch.look(status)

    with repeating(look, LOOK, "watch"):
        yield


def _growth(before: Mapping[str, int], now: Mapping[str, int]) -> dict[str, int]:
    """How much each counter has grown since, if it has."""
    growth = {name: count - before.get(name, 0) for name, count in now.items()}
    return {name: count for name, count in growth.items() if count > 0}


def _listed(counts: Mapping[str, int]) -> str:
    """The largest first."""
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count:,} {name}" for name, count in ranked)


def _span(seconds: float) -> str:
    for length, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"
