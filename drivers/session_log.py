"""The black box: all that came into a session and all that it made of it, in one MCAP file.

    raw/SOURCE     bytes as they came: the sender in ASCII, a zero byte, the bytes
    events/SOURCE  JSON: the line was opened, lost, found
    events/log     JSON: records are missing here, because the disk was full
    frames         index i64, device time f64 in seconds (NaN: none), x y z f32 per marker in
                   metres (NaN: missing)
    poses          index i64, provenance u8 per marker (0 measured, 1 imputed, 2 estimated,
                   3 lost), x y z f32 per marker in metres, sigma f32 per marker in metres

Little endian. A channel's metadata holds what its messages share: the source's address, or labels
(a JSON list) and rate in Hz; other labels are another channel. Log time is the host's time of
receipt, publish time that of frames and poses by the device's clock, mapped. Both count from 1970;
the metadata record `session` has the offset to the host's monotonic clock, and what else there is
to know: program, model, start.
"""

from __future__ import annotations

import json
import logging
import math
import struct
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import Floats, Layout, MarkerFrame, SourceError, in_range
from drivers.mcap_file import McapFile, McapWriter, Message, Schema
from drivers.transport import Received

PROFILE = "markerbridge"
FORMAT = "1"
OPENED, LOST, FOUND, GAP = "opened", "lost", "found", "gap"  # events
MOST_PROVENANCE = 3
_FRAME = struct.Struct("<qd")
_POSE = struct.Struct("<q")
_LATEST = 2**64 - 1  # ns: the latest time that there is

_RAW = Schema("markerbridge.Received", "text", "sender ASCII, a zero byte, bytes received")
_EVENTS = Schema(
    "markerbridge.Event",
    "jsonschema",
    '{"type":"object","properties":{"event":{"type":"string"},"address":{"type":"string"},'
    '"records":{"type":"integer"}}}',
)
_FRAMES = Schema(
    "markerbridge.Frame", "text", "little endian: index i64, device time f64 s, x y z f32 m each"
)
_POSES = Schema(
    "markerbridge.Pose",
    "text",
    "little endian: index i64, provenance u8 each, x y z f32 m each, sigma f32 m each",
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LineBytes:
    """What was received over the line of a source, by the name it has in the log."""

    source: str
    received: Received


@dataclass(frozen=True, slots=True)
class LineEvent:
    """What became of a source's line: opened (then with its address), lost or found."""

    source: str
    t: float
    event: str
    address: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class LoggedPose:
    """A pose, and the layout that its M rows have. provenance: (M,) uint8, sigma: (M,) metres."""

    index: int
    t: float
    layout: Layout
    xyz: Floats
    provenance: npt.NDArray[np.uint8]
    sigma: Floats


Entry = LineBytes | LineEvent | MarkerFrame | LoggedPose


class LogWriter:
    """Writes a new log. What cannot be written is an OSError, and as soon as there is room again
    the log says how much is missing. facts: what there is to know of the session, by name; written
    with the first record.
    """

    def __init__(self, path: Path, program: str, clock: Clock = SYSTEM_CLOCK) -> None:
        """Raises OSError; FileExistsError where there is a file: logs are never overwritten."""
        self.path = path
        now = round(clock.now() * 1e9)
        self._offset = time.time_ns() - now
        self.facts = {
            "format": FORMAT,
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "monotonic_ns": str(now),
            "epoch_ns": str(now + self._offset),
        }
        self._file = McapWriter(path, PROFILE, program)
        self._clock = clock
        self._begun = False
        self._addresses: dict[str, str] = {}
        self._channels: dict[tuple[str, str | Layout], int] = {}
        self._missing = 0

    def add(self, entry: Entry) -> None:
        """Writes one record."""
        try:
            if not self._begun:
                self._file.add_metadata("session", self.facts)
                self._begun = True
            if self._missing:
                note = {"event": GAP, "records": self._missing}
                self._put(self._json("log"), self._clock.now(), json.dumps(note).encode())
                self._missing = 0
            self._write(entry)
        except OSError:
            self._missing += 1
            raise

    def close(self) -> None:
        """Ends the file; one that holds nothing is removed. Raises OSError where there is no room
        for the end: the log is readable all the same.
        """
        self._file.close()
        if not self._file.messages:
            self.path.unlink(missing_ok=True)

    def _write(self, entry: Entry) -> None:
        if isinstance(entry, LineBytes):
            data, t, sender = entry.received
            about = {"address": self._addresses.get(entry.source, "")}
            channel = self._channel(f"raw/{entry.source}", "", "bytes", _RAW, about)
            self._put(channel, t, sender.encode() + b"\0" + data)
        elif isinstance(entry, MarkerFrame):
            head = _FRAME.pack(entry.index, entry.t_device)
            channel = self._channel("frames", entry.layout, "binary", _FRAMES, {})
            self._put(channel, entry.t, head + _bytes(entry.xyz), entry.t_mapped)
        elif isinstance(entry, LoggedPose):
            head = _POSE.pack(entry.index) + entry.provenance.astype(np.uint8).tobytes()
            channel = self._channel("poses", entry.layout, "binary", _POSES, {})
            self._put(channel, entry.t, head + _bytes(entry.xyz) + _bytes(entry.sigma))
        else:
            note = {"event": entry.event}
            if entry.event == OPENED:
                note["address"] = self._addresses[entry.source] = entry.address
            self._put(self._json(entry.source), entry.t, json.dumps(note).encode())

    def _json(self, source: str) -> int:
        about = {"address": self._addresses[source]} if source in self._addresses else {}
        return self._channel(f"events/{source}", "", "json", _EVENTS, about)

    def _channel(
        self, topic: str, shared: str | Layout, encoding: str, schema: Schema, about: dict[str, str]
    ) -> int:
        """The channel of a topic, one for each layout."""
        key = (topic, shared)
        if key not in self._channels:
            if isinstance(shared, Layout):
                about = {"labels": json.dumps(shared.labels), "rate": repr(shared.rate)}
            self._channels[key] = self._file.channel(topic, encoding, schema, about)
        return self._channels[key]

    def _put(self, channel: int, t: float, data: bytes, t_mapped: float = math.nan) -> None:
        log_time = self._epoch(t)
        published = log_time if math.isnan(t_mapped) else self._epoch(t_mapped)
        self._file.add(channel, log_time, published, data)

    def _epoch(self, t: float) -> int:
        """Host time in seconds as nanoseconds since 1970."""
        if not math.isfinite(t):
            return 0
        return min(max(round(t * 1e9) + self._offset, 0), _LATEST)


def _bytes(values: Floats) -> bytes:
    return values.astype("<f4").tobytes()


class SessionLog:
    """A log, as far as it is whole; what is not is said once.

    facts: what is known of the session. sources: addresses by name, of those whose bytes it holds.
    start: the host's time of the first record, seconds on its monotonic clock then. holds: how many
    messages there are by topic.
    """

    def __init__(self, path: Path) -> None:
        """Raises SourceError for what is no log of ours, or holds nothing."""
        self.path = path
        self.facts: dict[str, str] = {}
        self.sources: dict[str, str] = {}
        self.holds: Counter[str] = Counter()
        self._file = McapFile(path)
        self._offset = 0
        first = _LATEST
        for message in self._file:
            topic = message.channel.topic
            self.holds[topic] += 1
            if topic.startswith("raw/"):
                address = message.channel.metadata.get("address", "")
                self.sources.setdefault(topic.removeprefix("raw/"), address)
            first = min(first, message.log_time)
        if self._file.profile != PROFILE:
            raise SourceError(f"{path} is an MCAP file, but not one that markerbridge recorded")
        self.facts = self._file.metadata.get("session", {})
        if self.facts.get("format", FORMAT) != FORMAT:
            raise SourceError(f"{path} was recorded by another version of markerbridge")
        if not self.holds:
            raise SourceError(f"{path} holds nothing: it broke off before anything came")
        if self._file.cut or self._file.damaged:
            log.warning(
                "%s is not whole: %d bytes at its end and %d damaged records are left out",
                *(path, self._file.cut, self._file.damaged),
            )
        self._offset = self._find_offset()
        self.start = self._host(first)

    def lines(self, source: str) -> Iterator[LineBytes | LineEvent]:
        """What happened on the line of a source, in order."""
        for message in self._file:
            kind, _, name = message.channel.topic.partition("/")
            if name != source:
                continue
            t = self._host(message.log_time)
            if kind == "raw":
                sender, zero, data = message.data.partition(b"\0")
                if zero:
                    yield LineBytes(name, Received(data, t, sender.decode("ascii", "replace")))
            elif kind == "events":
                event = _event(message.data)
                if event in (LOST, FOUND):
                    yield LineEvent(name, t, event)

    def frames(self) -> Iterator[MarkerFrame]:
        """The frames as they reached the session, in order."""
        for message, layout in self._with_layout("frames"):
            numbers = _numbers(message.data, _FRAME.size, 3 * len(layout.labels))
            if numbers is None:
                continue
            index, t_device = _FRAME.unpack_from(message.data)
            t, t_mapped = self._host(message.log_time), self._host(message.publish_time)
            yield MarkerFrame(index, t, t_device, layout, _places(numbers), t_mapped)

    def poses(self) -> Iterator[LoggedPose]:
        """The poses in order."""
        for message, layout in self._with_layout("poses"):
            count = len(layout.labels)
            numbers = _numbers(message.data, _POSE.size + count, 4 * count)
            if numbers is None:
                continue
            (index,) = _POSE.unpack_from(message.data)
            provenance = np.frombuffer(message.data, np.uint8, count, _POSE.size)
            if provenance.max(initial=0) > MOST_PROVENANCE:
                continue
            xyz, sigma = _places(numbers[: 3 * count]), numbers[3 * count :]
            yield LoggedPose(index, self._host(message.log_time), layout, xyz, provenance, sigma)

    def _with_layout(self, topic: str) -> Iterator[tuple[Message, Layout]]:
        """The messages of a topic, with the layout of their channel; those without are left out."""
        layouts: dict[int, Layout | None] = {}
        for message in self._file:
            channel = message.channel
            if channel.topic != topic:
                continue
            if channel.id not in layouts:
                layouts[channel.id] = _layout(channel.metadata)
            layout = layouts[channel.id]
            if layout is not None:
                yield message, layout

    def _host(self, epoch: int) -> float:
        """Nanoseconds since 1970 as the host's time in seconds."""
        return (epoch - self._offset) / 1e9

    def _find_offset(self) -> int:
        """Nanoseconds from the host's monotonic clock to 1970; 0 where the log does not say."""
        try:
            offset = int(self.facts["epoch_ns"]) - int(self.facts["monotonic_ns"])
        except (KeyError, ValueError):
            return 0
        return offset if abs(offset) <= _LATEST else 0


def _event(data: bytes) -> str:
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return ""
    return str(found.get("event", "")) if isinstance(found, dict) else ""


def _layout(about: Mapping[str, str]) -> Layout | None:
    """The layout that a channel's metadata tells, if it does."""
    try:
        labels, rate = json.loads(about["labels"]), float(about["rate"])
        if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
            return None
        return Layout(tuple(labels), rate)
    except (KeyError, ValueError, RecursionError):
        return None


def _numbers(data: bytes, start: int, count: int) -> Floats | None:
    """The float32 from `start` on, unless there are more or fewer than `count`."""
    if len(data) != start + 4 * count:
        return None
    return np.frombuffer(data, "<f4", count, start).astype(np.float32)


def _places(numbers: Floats) -> Floats:
    """Numbers as (M, 3) metres, NaN rows where a marker is missing."""
    xyz = numbers.reshape(-1, 3)
    return np.where(in_range(xyz).all(axis=1, keepdims=True), xyz, np.float32(np.nan))
