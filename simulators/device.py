"""The simulated device: one frame after the other, at its times, as bytes on a line."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import Event

from drivers.clock import Clock, VirtualClock
from drivers.convention import Convention
from drivers.frame import Floats, Layout
from drivers.transport import TransportLost
from drivers.wire.codec import Encoder
from drivers.wire.osc_native import NativeOscEncoder
from simulators.corruption import Corruption
from simulators.faults.chain import FaultChain
from simulators.faults.packets import Packet
from simulators.faults.plan import FaultPlan
from simulators.lines import Line

LAYOUT_EVERY = 1.0  # s between layout packets
PATIENCE = 0.2  # s: how long the device waits at a time before it looks whether to stop


@dataclass(slots=True)
class Wire:
    """One line of the device and how it writes on it: layout and positions are ours, `convention`
    makes them the wire's."""

    line: Line
    encoder: Encoder
    layout: Layout
    convention: Convention = field(default_factory=Convention)
    layout_due: float = -math.inf

    def layout_packets(self, now: float) -> list[bytes]:
        """The layout packet; none on a wire that has no such thing."""
        packet = self.encoder.encode_layout(self.convention.layout_out(self.layout))
        self.layout_due = now + LAYOUT_EVERY
        return [packet] if packet else []

    def packets(self, now: float, index: int, t_device: float, xyz: Floats) -> list[bytes]:
        """The packet of a frame, after the layout where that is due."""
        layout = self.layout_packets(now) if now >= self.layout_due else []
        return [*layout, self.encoder.encode_frame(index, t_device, self.convention.xyz_out(xyz))]


class Device:
    """Sends `poses`, clean (41, 3) metres each, as a tracker that sees only some of the markers.

    `rows` are the markers it sees, `corruption` and `faults` what goes wrong with them; the wire's
    layout is that of the faults. `truth` is a second line that gets every clean pose under the same
    index, always before the frame itself, so that who reads the frame finds its truth there.
    Frame i is due at the start + i / (rate · speed).

    `counters`: what the faults did, by kind; `packets` that were made, frames and layouts; those
    that went out `whole` and `spoilt`, and those that found `no_line`. At the end
    packets + duplicate = whole + spoilt + no_line + loss.
    """

    def __init__(
        self,
        poses: Iterator[Floats],
        rows: list[int],
        corruption: Corruption,
        wire: Wire,
        clock: Clock,
        *,
        faults: FaultChain | None = None,
        speed: float = 1.0,
        truth: Wire | None = None,
    ) -> None:
        self._poses = poses
        self._rows = rows
        self._corruption = corruption
        self._faults = faults or FaultChain(FaultPlan(), wire.layout)
        self._wire = wire
        self._truth = truth
        self._clock = clock
        self._speed = speed
        self._start = clock.now()
        self._ended = False  # no further frame; what was delayed may still be waiting
        self._waiting: list[tuple[float, int, Packet]] = []  # by due time, then as they were made
        self._order = itertools.count()
        self._plugged = True
        self.counters = self._faults.counters
        self.sent = 0

    @property
    def done(self) -> bool:
        """Whether everything has been sent."""
        return self._ended and not self._waiting

    @property
    def due(self) -> float:
        """When there is next something to be sent, on the clock; infinite when all is done."""
        frame = math.inf if self._ended else self._moment(self._t)
        return min(frame, self._moment(self._waiting[0][0]) if self._waiting else math.inf)

    def wait_for_host(self, stop: Event, opened: Callable[[float], bool] | None = None) -> None:
        """Waits for the first hello, answers it, and starts the clip then.

        On a serial line only: who opens a port throws away what came before. opened: for wires
        that have no hello, whether a host opens the line within so many seconds.
        """
        here = opened or self._asked
        while not stop.is_set():
            if here(PATIENCE):
                self._start = self._clock.now()
                self._put(self._wire.layout_packets(self._start))
                self._send()
                return

    def step(self) -> None:
        """Makes the frame that is due now, sends what is; answers a hello that came meanwhile."""
        if not self._ended and self._moment(self._t) <= self._clock.now():
            pose = next(self._poses, None)
            if pose is None:
                self._ended = True
            else:
                self._make(pose)
        self._send()

    def play(self, stop: Event) -> None:
        """Sends all frames in real time, until the clip ends or it is told to stop."""
        while not (self.done or stop.is_set()):
            moment = self._clock.now() + PATIENCE
            self._clock.sleep_until(min(self.due, moment))
            if self.due <= moment:
                self.step()

    def schedule(self, clock: VirtualClock) -> None:
        """Sends all frames from calls on a virtual clock, while somebody else reads."""

        def step() -> None:
            try:
                self.step()
            except TransportLost:  # the reader has closed its end
                self._ended, self._waiting = True, []
            if not self.done:
                clock.call_at(self.due, step)

        clock.call_at(self.due, step)

    @property
    def _t(self) -> float:
        """The next frame's time, seconds of the stream."""
        return self.sent / self._wire.layout.rate

    def _moment(self, t: float) -> float:
        """When `t`, seconds of the stream, is on the clock."""
        return self._start + t / self._speed

    def _make(self, pose: Floats) -> None:
        """Makes the packets of one frame."""
        now, index, t = self._clock.now(), self.sent, self._t
        self._plug(not self._faults.unplugged(t))
        if self._plugged and self._asked(0.0):
            self._put(self._wire.layout_packets(now))
        if self._truth:
            for data in self._truth.packets(now, index, t, pose):
                self._truth.line.send(data)
        measured = self._faults.markers(t, self._corruption.apply(pose[self._rows]))
        self._put(self._wire.packets(now, index, self._faults.stamp(t), measured))
        self.sent += 1

    def _put(self, packets: list[bytes]) -> None:
        """Packets made now start on their way to the line."""
        self.counters["packets"] += len(packets)
        for data in packets:
            for packet in self._faults.packets(Packet(data, self._t, self._t)):
                heapq.heappush(self._waiting, (packet.due, next(self._order), packet))

    def _send(self) -> None:
        """Sends the packets that are due."""
        while self._waiting and self._moment(self._waiting[0][0]) <= self._clock.now():
            _, _, packet = heapq.heappop(self._waiting)
            if self._plugged:
                self._wire.line.send(packet.data)
                self.counters["spoilt" if packet.spoilt else "whole"] += 1
            else:
                self.counters["no_line"] += 1

    def _plug(self, inside: bool) -> None:
        if inside != self._plugged:
            self._plugged = inside
            (self._wire.line.plug if inside else self._wire.line.unplug)()

    def _asked(self, timeout: float) -> bool:
        """Whether a hello comes within `timeout` seconds."""
        received = self._wire.line.receive(timeout)
        return received is not None and self._wire.encoder.has_hello(received.data)


def truth_wire(line: Line, layout: Layout) -> Wire:
    """The line for clean poses: OSC, as `run --truth` reads it."""
    return Wire(line, NativeOscEncoder(), layout)
