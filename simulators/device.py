"""The simulated device: one frame after the other, at its times, as bytes on a line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from threading import Event

from drivers.clock import Clock, VirtualClock
from drivers.frame import Floats, Layout
from drivers.transport import Transport, TransportLost
from drivers.wire.codec import Encoder
from drivers.wire.osc_native import NativeOscEncoder
from simulators.corruption import Corruption

LAYOUT_EVERY = 1.0  # s between layout packets
PATIENCE = 0.2  # s: how long the device waits at a time before it looks whether to stop


@dataclass(slots=True)
class Wire:
    """One line of the device and how it writes on it."""

    transport: Transport
    encoder: Encoder
    layout: Layout
    layout_due: float = float("-inf")

    def send_layout(self, now: float) -> None:
        self.transport.send(self.encoder.encode_layout(self.layout))
        self.layout_due = now + LAYOUT_EVERY

    def send_frame(self, now: float, index: int, t_device: float, xyz: Floats) -> None:
        if now >= self.layout_due:
            self.send_layout(now)
        self.transport.send(self.encoder.encode_frame(index, t_device, xyz))


class Device:
    """Sends `poses`, clean (41, 3) metres each, as a tracker that sees only some of the markers.

    `rows` are the markers it sees, `corruption` what goes wrong with them. `truth` is a second
    line that gets every clean pose under the same index, always before the frame itself, so that
    who reads the frame finds its truth there. Frame i is due at the start + i / (rate · speed).
    """

    def __init__(
        self,
        poses: Iterator[Floats],
        rows: list[int],
        corruption: Corruption,
        wire: Wire,
        clock: Clock,
        *,
        speed: float = 1.0,
        truth: Wire | None = None,
    ) -> None:
        self._poses = poses
        self._rows = rows
        self._corruption = corruption
        self._wire = wire
        self._truth = truth
        self._clock = clock
        self._interval = 1.0 / (wire.layout.rate * speed)
        self._start = clock.now()
        self.sent = 0
        self.done = False

    @property
    def due(self) -> float:
        """When the next frame is to be sent, on the clock."""
        return self._start + self.sent * self._interval

    def wait_for_host(self, stop: Event) -> None:
        """Waits for the first hello, answers it, and starts the clip then.

        On a serial line only: who opens a port throws away what came before.
        """
        while not stop.is_set() and not self._answered(PATIENCE):
            pass
        self._start = self._clock.now()

    def step(self) -> None:
        """Sends the frame that is due now; answers a hello that came meanwhile."""
        pose = next(self._poses, None)
        if pose is None:
            self.done = True
            return
        now, index = self._clock.now(), self.sent
        t_device = index / self._wire.layout.rate
        self._answered(0.0)
        if self._truth:
            self._truth.send_frame(now, index, t_device, pose)
        measured = self._corruption.apply(pose[self._rows])
        self._wire.send_frame(now, index, t_device, measured)
        self.sent += 1

    def play(self, stop: Event) -> None:
        """Sends all frames in real time, until the clip ends or it is told to stop."""
        while not (self.done or stop.is_set()):
            moment = self._clock.now() + PATIENCE
            self._clock.sleep_until(min(self.due, moment))
            if self.due <= moment:
                self.step()

    def schedule(self, clock: VirtualClock) -> None:
        """Sends all frames from calls on a virtual clock, while somebody else reads."""

        def next_frame() -> None:
            try:
                self.step()
            except TransportLost:  # the reader has closed its end
                self.done = True
            if not self.done:
                clock.call_at(self.due, next_frame)

        clock.call_at(self.due, next_frame)

    def _answered(self, timeout: float) -> bool:
        received = self._wire.transport.receive(timeout)
        if not (received and self._wire.encoder.has_hello(received.data)):
            return False
        self._wire.send_layout(self._clock.now())
        return True


def truth_wire(transport: Transport, layout: Layout) -> Wire:
    """The line for clean poses: OSC, as `run --truth` reads it."""
    return Wire(transport, NativeOscEncoder(), layout)
