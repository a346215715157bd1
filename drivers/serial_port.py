"""Marker streams on a serial line: `serial:/dev/ttyUSB0?baud=921600&codec=cobs`."""

from __future__ import annotations

import contextlib
import os
import select
import termios
from pathlib import Path
from typing import Any

import serial
from serial.tools import list_ports

from drivers.clock import Clock
from drivers.frame import Source, SourceError
from drivers.transport import Received, TransportLost
from drivers.url import Url
from drivers.wire.registry import take_decoder
from drivers.wire_source import WireSource, reorder_of


class PortError(SourceError):
    """A serial port that cannot be opened. reason: why, and what to do."""

    def __init__(self, path: str, error: Exception) -> None:
        self.reason = _reason(path, error)
        super().__init__(f"cannot open serial port {path}: {self.reason}")


def _reason(path: str, error: Exception) -> str:
    if not Path(path).exists():
        return (
            "there is no such port: is the device plugged in (or `markerbridge simulate ... --to "
            f"serial:{path}` running)?"
        )
    if not os.access(path, os.R_OK | os.W_OK):
        return (
            "you may not read it: sudo usermod -aG dialout $USER, then log in again (the group may "
            "have another name: ls -l tells)"
        )
    if "exclusively lock" in str(error) or "busy" in str(error):
        return "another program uses it"
    return str(error)


class SerialTransport:
    """A serial port, or a pty that stands for one (POSIX).

    select and os.read take half the time of pyserial's own read, which asks the driver for the
    number of waiting bytes each time.
    """

    def __init__(self, path: str, baud: int, clock: Clock) -> None:
        """Raises SourceError where the port cannot be opened."""
        self._clock = clock
        try:
            self._port = serial.Serial(path, baud, timeout=0, exclusive=True)
            self._keep_dtr()
        except (serial.SerialException, OSError, ValueError, termios.error) as error:
            raise PortError(path, error) from error
        self.low_latency = self._lower_latency()

    def receive(self, timeout: float) -> Received | None:
        try:
            ready, _, _ = select.select([self._port.fileno()], [], [], timeout)
            if not ready:
                return None
            data = os.read(self._port.fileno(), 65_536)
        except (OSError, ValueError, serial.SerialException) as error:
            raise TransportLost(str(error)) from error
        if not data:  # ready without data: the device is gone
            raise TransportLost("end of file")
        return Received(data, self._clock.now())

    def send(self, data: bytes) -> None:
        """Hands it to the driver as far as there is room: a device that takes nothing in is not
        waited for.
        """
        try:
            os.write(self._port.fileno(), data)
        except BlockingIOError:
            return
        except (OSError, serial.SerialException) as error:
            raise TransportLost(str(error)) from error

    def close(self) -> None:
        # A port that is gone closes badly; one that takes nothing in, only after half a minute
        # unless what waits for it is dropped.
        with contextlib.suppress(OSError, termios.error):
            self._port.reset_output_buffer()
        with contextlib.suppress(OSError, termios.error):
            self._port.close()

    def _keep_dtr(self) -> None:
        """Leaves the line up when the port is closed: many boards reset when it goes down, and
        would start anew each time a silent port is opened again.
        """
        attributes = termios.tcgetattr(self._port.fileno())
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(self._port.fileno(), termios.TCSANOW, attributes)

    def _lower_latency(self) -> bool:
        """Whether the driver was told to pass bytes on at once (USB adapters wait up to 16 ms)."""
        try:
            self._port.set_low_latency_mode(True)
        except (OSError, ValueError, NotImplementedError, AttributeError):
            return False  # a pty, or a driver that knows no such mode
        return True


class SerialPort:
    """A port by its path, and by its USB serial number where it has one: a device that comes back
    under another name is found again, and another one under its name is not taken for it.
    """

    def __init__(self, path: str, baud: int, clock: Clock) -> None:
        self._path, self._baud, self._clock = path, baud, clock
        self._identity: tuple[str, str] | None = None
        self._opened = False

    def __call__(self) -> SerialTransport:
        """Opens it. Raises SourceError where it is not there."""
        if not self._opened:
            transport = SerialTransport(self._path, self._baud, self._clock)
            self._opened, found = True, _identities()
            mine = found.get(os.path.realpath(self._path))  # /dev/serial/by-id holds links
            # Some makers give all that they make one number: it tells nothing then.
            self._identity = mine if list(found.values()).count(mine) == 1 else None
            return transport
        return SerialTransport(self._find(), self._baud, self._clock)

    def _find(self) -> str:
        if self._identity is None:
            return self._path
        found = _identities()
        if found.get(os.path.realpath(self._path)) == self._identity:
            return self._path
        for path, identity in found.items():
            if identity == self._identity:
                return path
        raise SourceError(f"no serial port with the USB serial number {self._identity[0]}")


def _identities() -> dict[str, tuple[str, str] | None]:
    """By path: the USB serial number, and which of its device's ports it is; None without one."""
    return {
        str(port.device): (port.serial_number, (port.location or "").partition(":")[2])
        if port.serial_number
        else None
        for port in listed_ports()
    }


def listed_ports() -> list[Any]:
    """What the system knows, as pyserial tells it; nothing while one of them is going away, over
    which pyserial stumbles.
    """
    try:
        return list(list_ports.comports())
    except (OSError, TypeError, ValueError):
        return []


def open_serial(url: Url, clock: Clock) -> Source:
    """The source at a serial address. Raises UrlError or SourceError."""
    path = url.file_path()
    baud = url.take("baud", 921_600, _baud)
    decoder, convention = take_decoder(url)
    reorder = reorder_of(url)
    url.finish()
    return WireSource(
        url.text,
        SerialPort(path, baud, clock),
        decoder,
        clock,
        convention=convention,
        reorder=reorder,
        reopens=True,
    )


def _baud(text: str) -> int:
    if not (text.isdecimal() and 0 < int(text) < 2**31):
        raise ValueError("it is a number of bits a second, for example 115200")
    return int(text)
