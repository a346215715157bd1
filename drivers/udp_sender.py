"""Datagrams to one address; whether anybody listens makes no difference."""

from __future__ import annotations

import ipaddress
import socket
from typing import Any

from drivers.errors import MarkerbridgeError

ETHERNET = 1472  # bytes: the largest datagram in one Ethernet packet
LOOPBACK = 65_000  # bytes: on this machine they may be as large as UDP allows


class AddressError(MarkerbridgeError):
    """A host that cannot be found."""


def addresses(host: str, port: int, kind: socket.SocketKind) -> list[Any]:
    """What getaddrinfo finds. Raises AddressError where the host is unknown, and for port 0."""
    if port == 0:
        raise AddressError(f"cannot send to {host}:0: ports are 1 to 65535")
    try:
        return socket.getaddrinfo(host, port, type=kind)
    except (OSError, UnicodeError) as error:
        raise AddressError(f"cannot send to {host}:{port}: {error}") from error


class UdpSender:
    """A UDP socket to host and port. `limit`: the largest datagram worth sending there, bytes."""

    def __init__(self, host: str, port: int) -> None:
        """Raises AddressError where the host is unknown, and for port 0, where nobody can be."""
        found = addresses(host, port, socket.SOCK_DGRAM)
        # A name such as localhost often has both: most receivers listen on IPv4 alone.
        family, kind, protocol, _, address = min(found, key=lambda one: one[0] == socket.AF_INET6)
        self._address: Any = address
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self.limit = LOOPBACK if ipaddress.ip_address(address[0]).is_loopback else ETHERNET

    def send(self, datagram: bytes | bytearray) -> None:
        """Raises OSError where the system refuses it, and where it would have to wait."""
        self._socket.sendto(datagram, socket.MSG_DONTWAIT, self._address)

    def close(self) -> None:
        self._socket.close()
