"""Marker streams on a serial line: `serial:/dev/ttyUSB0?baud=921600&codec=cobs`."""

from __future__ import annotations

import os
import select
import termios

import serial

from drivers.clock import Clock
from drivers.frame import Source, SourceError
from drivers.transport import TransportLost
from drivers.url import Url, UrlError
from drivers.wire.cobs import CobsDecoder
from drivers.wire_source import WireSource

CODECS = {"cobs": CobsDecoder}


class SerialTransport:
    """A serial port, or a pty that stands for one (POSIX).

    select and os.read take half the time of pyserial's own read, which asks the driver for the
    number of waiting bytes each time.
    """

    def __init__(self, path: str, baud: int) -> None:
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=1.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError, termios.error) as error:
            raise SourceError(
                f"cannot open serial port {path}: {error}; is the device plugged in (or "
                f"`markerbridge simulate ... --to serial:{path}` running), and may you read it?"
            ) from error

    def receive(self, timeout: float) -> bytes:
        try:
            ready, _, _ = select.select([self._port.fileno()], [], [], timeout)
            if not ready:
                return b""
            data = os.read(self._port.fileno(), 65_536)
        except (OSError, ValueError, serial.SerialException) as error:
            raise TransportLost(str(error)) from error
        if not data:  # ready without data: the device is gone
            raise TransportLost("end of file")
        return data

    def send(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (OSError, serial.SerialException, termios.error) as error:
            raise TransportLost(str(error)) from error

    def close(self) -> None:
        self._port.close()


def open_serial(url: Url, clock: Clock) -> Source:
    """The source at a serial address. Raises UrlError or SourceError."""
    path = url.file_path()
    baud = url.take("baud", 921_600, int)
    codec = url.take("codec", "cobs", str)
    url.finish()
    if codec not in CODECS:
        raise UrlError(f"'{url.text}': unknown codec {codec} (known: {', '.join(CODECS)})")
    return WireSource(url.text, lambda: SerialTransport(path, baud), CODECS[codec](), clock)
