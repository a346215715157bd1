"""Marker streams over OSC: `osc://127.0.0.1:9100?dialect=native`."""

from __future__ import annotations

import logging
import select
import socket

from drivers.clock import Clock
from drivers.frame import Source, SourceError
from drivers.transport import TransportLost
from drivers.url import Url, UrlError
from drivers.wire.osc_native import NativeOscDecoder
from drivers.wire_source import WireSource

DIALECTS = {"native": NativeOscDecoder}
RECEIVE_BUFFER = 4 << 20  # bytes: a second of any stream, should the reader be held up

log = logging.getLogger(__name__)


class UdpTransport:
    """A bound UDP socket; each `receive` is one datagram. Port 0 lets the system choose `port`."""

    def __init__(self, host: str, port: int) -> None:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE
            )[0]
            self._socket = socket.socket(family, kind, protocol)
        except OSError as error:
            raise SourceError(f"cannot listen on UDP {host}:{port}: {error}") from error
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            raise SourceError(
                f"cannot listen on UDP {host}:{port}: {error}; is another program using it?"
            ) from error
        self.port: int = self._socket.getsockname()[1]
        granted = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if granted < RECEIVE_BUFFER:
            log.warning(
                "UDP %s:%d: receive buffer of %d KiB granted, %d asked for; a long stall may lose "
                "packets (sysctl -w net.core.rmem_max=%d)",
                *(host, self.port, granted >> 10, RECEIVE_BUFFER >> 10, RECEIVE_BUFFER),
            )

    def receive(self, timeout: float) -> bytes:
        try:
            ready, _, _ = select.select([self._socket], [], [], timeout)
            return self._socket.recv(65_536) if ready else b""
        except (OSError, ValueError) as error:
            raise TransportLost(str(error)) from error

    def send(self, data: bytes) -> None:
        """Nothing: OSC senders do not listen."""

    def close(self) -> None:
        self._socket.close()


class OscSource(WireSource):
    """A WireSource on a UDP port; `port` is the one the system gave where 0 was asked for."""

    port: int

    def __init__(self, url: Url, clock: Clock) -> None:
        host, port = url.address()
        dialect = url.take("dialect", "native", str)
        url.finish()
        if dialect not in DIALECTS:
            raise UrlError(
                f"'{url.text}': unknown dialect {dialect} (known: {', '.join(DIALECTS)})"
            )

        def connect() -> UdpTransport:
            transport = UdpTransport(host, port)
            self.port = transport.port
            return transport

        super().__init__(url.text, connect, DIALECTS[dialect](), clock)


def open_osc(url: Url, clock: Clock) -> Source:
    """The source at an OSC address. Raises UrlError or SourceError."""
    return OscSource(url, clock)
