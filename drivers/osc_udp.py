"""Marker streams over OSC: `osc://127.0.0.1:9100?dialect=native`."""

from __future__ import annotations

import logging
import select
import socket

from drivers.clock import Clock
from drivers.frame import Source, SourceError
from drivers.transport import Received, TransportLost
from drivers.url import Url
from drivers.wire.registry import take_decoder
from drivers.wire_source import WireSource, reorder_of

RECEIVE_BUFFER = 4 << 20  # bytes: a second of any stream, should the reader be held up

log = logging.getLogger(__name__)


class UdpTransport:
    """A bound UDP socket; each `receive` is one datagram. Port 0 lets the system choose `port`."""

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self._clock = clock
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

    def receive(self, timeout: float) -> Received | None:
        try:
            ready, _, _ = select.select([self._socket], [], [], timeout)
            if not ready:
                return None
            data, (host, port, *_) = self._socket.recvfrom(65_536)
        except (OSError, ValueError) as error:
            raise TransportLost(str(error)) from error
        return Received(data, self._clock.now(), f"{host}:{port}")

    def send(self, data: bytes) -> None:
        """Nothing: OSC senders do not listen."""

    def close(self) -> None:
        self._socket.close()


class OscSource(WireSource):
    """A WireSource on a UDP port; `port` is the one the system gave where 0 was asked for."""

    port: int

    def __init__(self, url: Url, clock: Clock) -> None:
        host, port = url.address()
        decoder, convention = take_decoder(url)
        reorder = reorder_of(url)
        url.finish()

        def connect() -> UdpTransport:
            transport = UdpTransport(host, port, clock)
            self.port = transport.port
            return transport

        super().__init__(url.text, connect, decoder, clock, convention=convention, reorder=reorder)


def open_osc(url: Url, clock: Clock) -> Source:
    """The source at an OSC address. Raises UrlError or SourceError."""
    return OscSource(url, clock)
