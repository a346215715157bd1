"""A source that reads packets from a line: asks for the layout, and reconnects by itself."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable
from typing import Protocol

import numpy as np

from drivers.clock import Clock
from drivers.clock_map import ClockMap
from drivers.convention import Convention
from drivers.frame import Layout, MarkerFrame, Source, SourceError, in_range
from drivers.sequence import Sequence
from drivers.transport import Received, Transport, TransportLost
from drivers.url import Url
from drivers.wire.codec import Decoder

SILENCE = 1.0  # s without a byte, or on a line of many a frame, before the device is asked again
ANSWER = 0.25  # s that it gets to answer before the line is closed and opened again
PATIENCE = 8.0  # s: a line that opens but says nothing is opened again after longer and longer
SETTLED = 1.0  # s in which a wire without layouts names its markers one by one
RETRY = 0.1  # s between attempts to open a line that was lost
ROUNDING = 1e-6  # s by which a wait may end too early
HELD = 0.1  # s of silence after which frames no longer wait for a late one

log = logging.getLogger(__name__)


def reorder_of(url: Url) -> int:
    """The option `reorder` of an address: frames that wait for a late one. Raises UrlError."""
    return url.take("reorder", 0, _depth)


def _depth(text: str) -> int:
    if text not in {"0", "1", "2", "3"}:
        raise ValueError("it is a number of frames, 0 to 3")
    return int(text)


class Recorder(Protocol):
    """What keeps all that came over a line: called on the reader's thread, so it must not wait."""

    def received(self, source: str, received: Received) -> None: ...

    def lost(self, source: str, t: float) -> None: ...

    def found(self, source: str, t: float) -> None: ...


class WireSource(Source):
    """Frames that `decoder` reads from the line that `connect` opens, as `convention` says.

    `connect` raises SourceError where the line cannot be opened: the first time that is the
    caller's to see, afterwards the line is tried again every 100 ms. reopens: whether a line that
    stays silent is closed and opened again, as a serial port is. reorder: frames (0 to 3) that wait
    for one that is late. Counts `bytes`, `silences`, `disconnects`, `reconnects`, `out_of_range`
    (markers), `bad_layout`, and what decoder, sequence and clock map count.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], Transport],
        decoder: Decoder,
        clock: Clock,
        *,
        convention: Convention | None = None,
        reorder: int = 0,
        reopens: bool = False,
    ) -> None:
        super().__init__(name, clock)
        self.recorder: Recorder | None = None
        self.clock_map = ClockMap(self.counters)
        self._connect = connect
        self._decoder = decoder
        self._decoder.counters = self.counters
        self._convention = convention or Convention()
        self._sequence = Sequence(self.counters, reorder)
        self._reopens = reopens
        self._foreign: Layout | None = None
        self._checked: tuple[str, ...] = ()  # their labels when `labels` was last compared
        self._settled_at = math.inf  # when a layout that lacks labels will have come to stay
        self._transport: Transport | None = connect()
        self._quiet_since = clock.now()
        self._framed = clock.now()  # when the newest frame came
        self._patience = SILENCE
        self._asked = False
        self._try_at = clock.now()
        self._said_hello = clock.now()
        self._say_hello()

    def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
        if self._transport is None and not self._reconnect(timeout):
            return None
        assert self._transport is not None
        # Wake up in time to ask a silent device again, and for frames that wait for a late one.
        due = min(self._silent_at, self._held_until)
        try:
            received = self._transport.receive(min(timeout, max(0.0, due - self.clock.now())))
        except TransportLost:
            self._lose()
            return self._finished(self._sequence.flush())
        if received is None:
            return self._silent()
        held = received.t - self._framed > HELD
        frames = self._finished(self._sequence.flush()) if held else []
        self._patience, self._asked = SILENCE, False
        self.counters["bytes"] += len(received.data)
        if self.recorder:
            self.recorder.received(self.name, received)
        read = self._decode(received)
        if read:
            self._framed = received.t
        if read or self._reopens:  # a line that several send to may be loud and say nothing
            self._quiet_since = received.t
        if self._decoder.layout is None and received.t - self._said_hello > ANSWER:
            self._say_hello()  # the answer was lost
        restarts = self.counters["restarts"]
        ordered = [frame for one in read for frame in self._sequence.put(one)]
        if self.counters["restarts"] > restarts:  # and so has its clock
            self.clock_map.reset()
        return frames + self._finished(ordered)

    def _decode(self, received: Received) -> list[MarkerFrame]:
        """Frames of the wire that these bytes complete."""
        return self._decoder.feed(received.data, received.t)

    def _finished(self, frames: list[MarkerFrame]) -> list[MarkerFrame]:
        """Frames of the wire as ours: our labels, metres, and the host's clock."""
        if self._decoder.layout is not self._foreign:
            self._adopt(self._decoder.layout)
        if self._foreign and self.clock.now() >= self._settled_at:
            self._tell_lacking(self._foreign)
        finished = []
        parsed = self.clock.now()
        for frame in frames:
            if frame.layout is not self._foreign:  # the last before a change
                self._adopt(frame.layout)
            if self.layout is None:
                self.counters["bad_layout"] += 1
                continue
            xyz = self._convention.xyz_in(frame.xyz)
            known = in_range(xyz)
            if not known.all():
                there = known.all(axis=1, keepdims=True)
                given = ~np.isnan(xyz).any(axis=1, keepdims=True)
                self.counters["out_of_range"] += int((~there & given).sum())
                xyz = np.where(there, xyz, np.float32(np.nan))
            mapped = self.clock_map.map(frame.t, frame.t_device)
            finished.append(
                MarkerFrame(frame.index, frame.t, frame.t_device, self.layout, xyz, mapped, parsed)
            )
        return finished

    def _adopt(self, foreign: Layout | None) -> None:
        self._foreign, self.layout = foreign, None
        if foreign is None:
            return
        known, self._checked = foreign.labels == self._checked, foreign.labels
        try:
            self.layout = self._convention.layout_in(foreign)
        except ValueError as error:
            if not known:
                log.warning("%s: the option labels does not fit the stream: %s", self.name, error)
        if not known:
            lacks = self._convention.lacking(foreign)
            self._settled_at = self.clock.now() + SETTLED if lacks else math.inf

    def _tell_lacking(self, foreign: Layout) -> None:
        """Says which labels of the option the stream has not, once they can be expected."""
        self._settled_at = math.inf
        log.warning(
            "%s: the option labels names %s, which the stream does not carry (it has %s)",
            *(self.name, ", ".join(self._convention.lacking(foreign)), ", ".join(foreign.labels)),
        )

    def _silent(self) -> list[MarkerFrame] | None:
        """Nothing came: asks the device, then opens the line again."""
        now = self.clock.now() + ROUNDING
        if now >= self._held_until:
            return self._finished(self._sequence.flush())
        if now < self._silent_at:
            return None
        if self._asked:
            self.counters["silences"] += 1
            self._patience = min(2 * self._patience, PATIENCE)
            self._lose()
        else:
            self._say_hello()
            self._asked = self._reopens
            if not self._reopens:
                self._quiet_since = self.clock.now()
        return None

    @property
    def _silent_at(self) -> float:
        """When the line will have been silent for too long."""
        return self._quiet_since + self._patience + (ANSWER if self._asked else 0.0)

    @property
    def _held_until(self) -> float:
        """When frames no longer wait for a late one."""
        return self._framed + HELD if self._sequence.waiting else math.inf

    def _say_hello(self) -> None:
        self._said_hello = self.clock.now()
        if self._decoder.hello and self._transport is not None:
            try:
                self._transport.send(self._decoder.hello)
            except TransportLost:
                self._lose()

    def _lose(self) -> None:
        self.counters["disconnects"] += 1
        if self._transport is not None:
            self._transport.close()
        self._transport = None
        if self.recorder:
            self.recorder.lost(self.name, self.clock.now())

    def _reconnect(self, timeout: float) -> bool:
        until = self.clock.now() + timeout
        if self._try_at > self.clock.now():
            self.clock.sleep_until(min(self._try_at, until))
        if self._try_at > self.clock.now():
            return False
        self._try_at = self.clock.now() + RETRY
        try:
            self._transport = self._connect()
        except SourceError:
            self.clock.sleep_until(min(self._try_at, until))
            return False
        self.counters["reconnects"] += 1
        self._start_anew()
        self._quiet_since = self.clock.now()
        self._asked = False
        if self.recorder:
            self.recorder.found(self.name, self._quiet_since)
        self._say_hello()
        return self._transport is not None  # it may be gone again already

    def _start_anew(self) -> None:
        """What comes from here on may be of another device."""
        self._decoder.reset()
        self._sequence.reset()
        self.clock_map.reset()

    def close(self) -> None:
        super().close()
        if self._transport is not None:
            self._transport.close()
            self._transport = None
