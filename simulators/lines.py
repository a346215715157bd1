"""The device's end of real lines: a pty that stands for a serial port, a UDP sender."""

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

from drivers.errors import MarkerbridgeError
from drivers.transport import Received
from drivers.udp_sender import UdpSender

PATIENCE = 0.25  # s that a host gets to make room before bytes are lost
DRAIN = 2.0  # s that a host gets at the end to read what it was sent


class SimulatorError(MarkerbridgeError):
    """A simulated device cannot be set up; the message says why and what to do."""


class PtyLine:
    """A pseudo-terminal whose host side is linked to `path`, as a device file is.

    What the host does not read in time is lost, as on a serial line: counted in `lost`.
    """

    def __init__(self, path: Path) -> None:
        """Raises SimulatorError where the link cannot be made; an old link is replaced."""
        self._device, self._host = pty.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._device, False)
        self.path = path
        self.lost = 0
        self._stalled = False
        try:
            if path.is_symlink():
                path.unlink()
            path.symlink_to(os.ttyname(self._host))
        except OSError as error:
            os.close(self._device)
            os.close(self._host)
            raise SimulatorError(
                f"cannot make the serial port {path}: {error.strerror}; choose a path that does "
                "not exist, for example serial:/tmp/tracker"
            ) from error

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
        while empty < 3 and time.monotonic() < end:  # the kernel moves bytes on in steps
            time.sleep(0.02)
            waiting = fcntl.ioctl(self._host, termios.FIONREAD, b"\0" * 4)
            empty = empty + 1 if waiting == b"\0" * 4 else 0

    def close(self) -> None:
        with contextlib.suppress(OSError):
            if self.path.readlink() == Path(os.ttyname(self._host)):
                self.path.unlink()
        for end in (self._device, self._host):
            with contextlib.suppress(OSError):
                os.close(end)


class UdpLine(UdpSender):
    """Datagrams as a line: nothing ever comes back. What the system refuses counts as `lost`."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(host, port)
        self.lost = 0

    def receive(self, timeout: float) -> Received | None:
        return None

    def send(self, datagram: bytes | bytearray) -> None:
        try:
            super().send(datagram)
        except OSError:
            self.lost += 1

    def drain(self) -> None:
        """Nothing: a datagram is out of our hands once it is sent."""


Line = PtyLine | UdpLine
