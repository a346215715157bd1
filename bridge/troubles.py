"""What is wrong with a session now, in the words of one who sits before it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from drivers.url import short

if TYPE_CHECKING:
    from bridge.session import Status

LOST = 1.0  # s without a frame and without a line that are trouble; what was seen is not of now
SILENT = 3.0  # s without a frame that are trouble
ENOUGH = 0.9  # of the frames of a stream that come
SOON = 3.0  # s after which a marker that never came is trouble


class Trouble(NamedTuple):
    """state: in two words. grave: whether nobody can be seen to move."""

    state: str
    words: str
    grave: bool


def troubles(status: Status, before: Status | None) -> list[Trouble]:
    """The gravest first. before: the session's status some seconds earlier, for what is wrong only
    while it goes on; None: of all that has been.
    """
    if status.performers:
        found = _of_each(status, before)
    else:
        found = [*_source(status, before), *_markers(status), *_sinks(status, before)]
    return sorted(found, key=lambda trouble: not trouble.grave)


def _of_each(status: Status, before: Status | None) -> list[Trouble]:
    """Each performer's own; the same of several, as of who share a line, is one."""
    whose: dict[Trouble, list[str]] = {}
    for name, own in status.performers.items():
        for trouble in troubles(own, before.performers[name] if before else None):
            whose.setdefault(trouble, []).append(name)
    return [
        trouble._replace(words=f"{', '.join(names)}: {trouble.words}")
        for trouble, names in whose.items()
    ]


def instead(status: Status, before: Status | None) -> str:
    """What comes in place of frames, to be said behind that none do."""

    def came(name: str) -> int:
        if before is None and status.source.get("frames"):  # not told apart from what came then
            return 0
        return status.source.get(name, 0) - (before.source.get(name, 0) if before else 0)

    if came("frames"):
        return ": those that come are of others"
    if count := came("bytes"):
        return f", though {count:,} bytes came: `markerbridge doctor` tells why"
    if count := came("refused"):
        return f", though {count:,} packets came, of senders that the option allow does not name"
    return ": nothing comes"


def _source(status: Status, before: Status | None) -> Iterator[Trouble]:
    source = status.source
    since = f"for {status.silent:.0f} s"
    away = source.get("disconnects", 0) > source.get("reconnects", 0)
    if away and status.silent >= LOST:
        yield Trouble("line lost", f"the line is lost, no frame {since}: it is tried again", True)
    elif status.silent >= SILENT:
        yield Trouble("no data", f"no frame {since}{instead(status, before)}", True)
    elif status.layout_rate and 0 < status.rate < ENOUGH * status.layout_rate:
        words = f"only {status.rate:.0f} of {status.layout_rate:.0f} frames a second come in"
        yield Trouble("frames lost", words, False)
    lost = source["fifo_overflow"] - (before.source["fifo_overflow"] if before else 0)
    if lost > 0:
        words = f"this machine does not keep up: {lost:,} frames were dropped"
        yield Trouble("too slow", words, False)


def _markers(status: Status) -> Iterator[Trouble]:
    markers = status.markers
    if status.silent >= SILENT or not markers:
        return
    if all(marker.state == "lost" for marker in markers.values()):
        yield Trouble("no pose", "the pose is lost: too few tracked markers are seen", True)
    never = [label for label, marker in markers.items() if marker.missing == status.frames]
    if never and len(never) < len(markers) and status.seconds > SOON:
        yield Trouble("marker lost", f"not seen so far: {', '.join(never)}", False)


def _sinks(status: Status, before: Status | None) -> Iterator[Trouble]:
    for name, sink in status.sinks.items():
        earlier = before.sinks[name] if before else {}
        if sink["errors"] > earlier.get("errors", 0):
            yield Trouble("sink fails", f"{short(name)}: {sink['last_error']}", False)
        elif (dropped := sink["dropped"] - earlier.get("dropped", 0)) > 0:
            words = f"{short(name)} does not keep up: {dropped:,} poses were dropped"
            yield Trouble("sink slow", words, False)
