"""Datagrams to one receiver; whether anybody listens makes no difference."""

from __future__ import annotations

import ipaddress
import socket
from typing import Any

from bridge.sinks.sink import SinkError
from drivers.url import Url

MAX_DATAGRAM = 1472  # bytes: one Ethernet packet


class UdpOut:
    """A UDP socket to one address. `limit` is the largest datagram worth sending there."""

    def __init__(self, url: Url, default_port: int) -> None:
        """Raises SinkError where the host is unknown."""
        host, port = url.address(default_port)
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
        except OSError as error:
            raise SinkError(f"{url.text}: cannot send to {host}: {error}") from error
        self._address: Any = address
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        loopback = ipaddress.ip_address(address[0]).is_loopback
        self.limit = 65_000 if loopback else MAX_DATAGRAM

    def send(self, datagram: bytes | bytearray) -> None:
        self._socket.sendto(datagram, self._address)

    def close(self) -> None:
        self._socket.close()
