"""What came from a source in some seconds: listened to, or read once more at another address."""

from __future__ import annotations

import itertools
import math
import threading
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from bridge.doctor.finding import corrected
from drivers.clock import VirtualClock
from drivers.clock_map import ClockMap
from drivers.convention import Convention
from drivers.frame import Floats, MarkerFrame, Source
from drivers.registry import open_source
from drivers.transport import Received, memory_line
from drivers.url import Url
from drivers.wire.registry import take_decoder
from drivers.wire_source import HELD, WireSource, reorder_of

POLL = 0.1  # s between looks at whether to stop
MOST = 32 << 20  # bytes that are kept
WIRES = ("serial", "osc")  # schemes whose bytes can be read once more, under other options
# Counters of what the bytes themselves do not tell.
OF_THE_LINE = ("disconnects", "reconnects", "silences", "refused", "other_sender", "sender_changes")


@dataclass(frozen=True, eq=False)
class Heard:
    """What came from the source at `address`.

    received: the bytes, where it is a line. convention, known: how the address says that the
    stream's world is, and the options that it may have; None and nothing where it can have none.
    offset (s), drift: of the clock map. receive_buffer: bytes granted to a UDP socket.
    """

    address: str
    seconds: float
    frames: list[MarkerFrame] = field(default_factory=list)
    received: list[Received] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)
    convention: Convention | None = None
    known: tuple[str, ...] = ()
    offset: float = math.nan
    drift: float = 0.0
    receive_buffer: int | None = None

    @property
    def can_be_read_again(self) -> bool:
        """Whether there is anything to read under other options."""
        return bool(self.received) or (_is_file(self.address) and bool(self.frames))

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the newest layout; none before the first frame."""
        return self.frames[-1].layout.labels if self.frames else ()

    @property
    def senders(self) -> Counter[str]:
        """How many times each was heard."""
        return Counter(entry.sender for entry in self.received)

    def positions(self) -> Floats:
        """(N, M, 3) metres: all frames in the newest layout, NaN where a marker is missing."""
        found: Floats = np.full((len(self.frames), len(self.labels), 3), np.nan, np.float32)
        newest = self.frames[-1].layout if self.frames else None
        for n, frame in enumerate(self.frames):
            found[n] = frame.xyz if frame.layout is newest else frame.ordered(self.labels)
        return found


class _Tape:
    """Keeps what came over a line (drivers.wire_source.Recorder)."""

    def __init__(self) -> None:
        self.received_: list[Received] = []
        self._room = MOST

    def received(self, source: str, received: Received) -> None:
        self._room -= len(received.data)
        if self._room >= 0:
            self.received_.append(received)

    def lost(self, source: str, t: float) -> None:
        """What matters of it is in the counters."""

    def found(self, source: str, t: float) -> None:
        """What matters of it is in the counters."""


def listen(source: Source, seconds: float, stop: threading.Event) -> Heard:
    """Reads for so many seconds of the source's clock, or until told to stop."""
    tape = _Tape()
    if isinstance(source, WireSource):
        source.recorder = tape
    began = source.clock.now()
    frames = []
    while not (stop.is_set() or source.exhausted):
        left = began + seconds - source.clock.now()
        if left <= 0:
            break
        frame = source.read(min(left, POLL))
        if frame is not None:
            frames.append(frame)
    clock_map: ClockMap | None = getattr(source, "clock_map", None)
    convention, known = _convention(source.name)
    return Heard(
        source.name,
        source.clock.now() - began,
        frames,
        tape.received_,
        Counter(source.counters),
        convention,
        known,
        clock_map.offset if clock_map else math.nan,
        clock_map.drift if clock_map else 0.0,
        getattr(source, "receive_buffer", None),
    )


def read_again(heard: Heard, address: str) -> Heard:
    """The same bytes as a source at another address reads them: those of the chief sender; a file
    once more, as far as it was heard.
    """
    if _is_file(address):
        with open_source(corrected(address, {"speed": "max"})) as file:
            frames = list(itertools.islice(file, len(heard.frames)))
        return replace(heard, address=address, frames=frames, convention=_convention(address)[0])
    url = Url.parse(address)
    decoder, convention = take_decoder(url)
    reorder = reorder_of(url)
    received = heard.received
    if heard.counters["other_sender"]:
        chief = heard.senders.most_common(1)[0][0]
        received = [entry for entry in received if entry.sender == chief]
    clock = VirtualClock(received[0].t)
    host, device = memory_line(clock)
    source = WireSource(
        address, lambda: host, decoder, clock, convention=convention, reorder=reorder
    )
    for entry in received:
        clock.call_at(entry.t, partial(device.send, entry.data))
    frames = []
    while (frame := source.read(received[-1].t + 2 * HELD - clock.now())) is not None:
        frames.append(frame)
    return Heard(
        address,
        heard.seconds,
        frames,
        heard.received,
        source.counters + Counter({name: heard.counters[name] for name in OF_THE_LINE}),
        *_convention(address),
        source.clock_map.offset,
        source.clock_map.drift,
        heard.receive_buffer,
    )


def _is_file(address: str) -> bool:
    return address.startswith("c3d:")


def _convention(address: str) -> tuple[Convention | None, tuple[str, ...]]:
    url = Url.parse(address)
    if _is_file(address):
        return Convention.take(url, unit=1.0), tuple(url.known)
    if url.scheme not in WIRES:
        return None, ()
    _, convention = take_decoder(url)
    return convention, tuple(url.known)
