"""The device's end of lines: a pty that stands for a serial port, a UDP sender, and a line within
this process."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import select
import termios
import time
import tty
from pathlib import Path
from typing import Protocol

from drivers.clock import VirtualClock
from drivers.errors import MarkerbridgeError
from drivers.frame import SourceError
from drivers.transport import MemoryTransport, Received, Transport, TransportLost, memory_line
from drivers.udp_sender import UdpSender

PATIENCE = 0.25  # s that a host gets to make room before bytes are lost
DRAIN = 2.0  # s that a host gets at the end to read what it was sent
LOOK = 0.01  # s between looks at whether a host has opened the line
SETTLE = 0.1  # s from a host's opening of a port until it has thrown away what came before


class SimulatorError(MarkerbridgeError):
    """A simulated device cannot be set up; the message says why and what to do."""


class Line(Transport, Protocol):
    """A line that can be pulled out and put in again. What nobody reads counts as `lost`."""

    lost: int  # packets

    def unplug(self) -> None:
        """Pulls the plug: the host's end fails, and there is nothing to open in its place."""
        ...

    def plug(self) -> None:
        """Puts it in again: the host can open the line anew. Raises SimulatorError."""
        ...

    def drain(self) -> None:
        """Gives the host time to read all, where closing would throw away the rest."""
        ...


class PtyLine:
    """A pseudo-terminal whose host side is linked to `path`, as a device file is.

    What the host does not read in time is lost, as on a serial line.
    """

    def __init__(self, path: Path) -> None:
        """Raises SimulatorError where the link cannot be made; an old link is replaced."""
        self.path = path
        self.lost = 0
        self.plug()

    def plug(self) -> None:
        self._device, self._host = pty.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._device, False)
        self._name = os.ttyname(self._host)
        self._stalled = False
        try:
            if self.path.is_symlink():
                self.path.unlink()
            self.path.symlink_to(self._name)
        except OSError as error:
            self.unplug()
            raise SimulatorError(
                f"cannot make the serial port {self.path}: {error.strerror}; choose a path that "
                "does not exist, for example serial:/tmp/tracker"
            ) from error

    def unplug(self) -> None:
        with contextlib.suppress(OSError):
            if self.path.readlink() == Path(self._name):
                self.path.unlink()
        for end in (self._device, self._host):
            with contextlib.suppress(OSError):
                os.close(end)
        self._device = self._host = -1  # unplugged; the numbers may soon be another file's

    def opened(self, timeout: float) -> bool:
        """Whether a host opens the line within `timeout` seconds."""
        # The kernel says that nobody has opened the host's side only if we have not either.
        os.close(self._host)
        hung_up = select.poll()
        hung_up.register(self._device, 0)
        end = time.monotonic() + timeout
        while nobody := bool(hung_up.poll(0)):
            if time.monotonic() > end:
                break
            time.sleep(LOOK)
        self._host = os.open(self._name, os.O_RDWR | os.O_NOCTTY)
        if not nobody:
            time.sleep(SETTLE)
        return not nobody

    def receive(self, timeout: float) -> Received | None:
        ready, _, _ = select.select([self._device], [], [], timeout)
        return Received(os.read(self._device, 4096), time.monotonic()) if ready else None

    def send(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._device, data) :]
                self._stalled = False
            except BlockingIOError:
                # The host's buffer is full. It gets a moment, but only once: a host that has gone
                # must not hold up the device.
                _, ready, _ = select.select(
                    [], [self._device], [], 0 if self._stalled else PATIENCE
                )
                if not ready:
                    self._stalled = True
                    self.lost += 1
                    return

    def drain(self) -> None:
        """Waits until the host has read all, or for two seconds: closing throws away the rest."""
        end = time.monotonic() + DRAIN
        empty = 0
        while self._host >= 0 and empty < 3 and time.monotonic() < end:
            time.sleep(0.02)  # the kernel moves bytes on in steps
            waiting = fcntl.ioctl(self._host, termios.FIONREAD, b"\0" * 4)
            empty = empty + 1 if waiting == b"\0" * 4 else 0

    close = unplug


class UdpLine:
    """Datagrams as a line: nothing ever comes back. What the system refuses counts as `lost`.

    Put in again, it sends from another port, as a restarted program does.
    """

    def __init__(self, host: str, port: int) -> None:
        """Raises AddressError where the host is unknown."""
        self._address = host, port
        self.lost = 0
        self.plug()

    def plug(self) -> None:
        self._sender = UdpSender(*self._address)

    def unplug(self) -> None:
        self._sender.close()

    def receive(self, timeout: float) -> Received | None:
        return None

    def send(self, data: bytes) -> None:
        try:
            self._sender.send(data)
        except OSError:
            self.lost += 1

    def drain(self) -> None:
        """Nothing: a datagram is out of our hands once it is sent."""

    close = unplug


class MemoryLine:
    """A serial line within this process, on virtual time; the host opens it with `connect`."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._end: MemoryTransport | None = None
        self._inside = True
        self.lost = 0

    def connect(self) -> Transport:
        """The host's end of it, new each time. Raises SourceError while the plug is out."""
        if not self._inside:
            raise SourceError("the line is unplugged")
        self.close()
        host, self._end = memory_line(self._clock)
        return host

    def plug(self) -> None:
        self._inside = True

    def unplug(self) -> None:
        self._inside = False
        self.close()

    def receive(self, timeout: float) -> Received | None:
        if self._end is not None:
            with contextlib.suppress(TransportLost):
                return self._end.receive(timeout)
            self._end = None
        self._clock.sleep_until(self._clock.now() + timeout)
        return None

    def send(self, data: bytes) -> None:
        if self._end is not None:
            with contextlib.suppress(TransportLost):
                return self._end.send(data)
            self._end = None
        self.lost += 1
        return None

    def drain(self) -> None:
        """Nothing: what was sent is there at once."""

    def close(self) -> None:
        if self._end is not None:
            self._end.close()
            self._end = None
