"""Marker streams over OSC: `osc://127.0.0.1:9100?dialect=native`."""

from __future__ import annotations

import errno
import ipaddress
import logging
import select
import socket
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from drivers.clock import Clock
from drivers.frame import Source, SourceError
from drivers.ownership import OwnedSource
from drivers.transport import Received, TransportLost
from drivers.url import Url
from drivers.wire.osc_qtm import QtmDecoder
from drivers.wire.registry import take_decoder
from drivers.wire_source import reorder_of

RECEIVE_BUFFER = 4 << 20  # bytes: a second of any stream, should the reader be held up
AT_ONCE = 64  # refused datagrams skipped in one `receive`: a flood of them must not hold it up
REMEMBERED = 1024  # hosts of which is known whether they are allowed
WARNED = 16  # other senders that are named in the log

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

log = logging.getLogger(__name__)


class UdpTransport:
    """A bound UDP socket; each `receive` is one datagram. Port 0 lets the system choose `port`.

    allow: whose datagrams are read; everybody's where it is None. Those of others are counted as
    `refused`. receive_buffer: bytes that the system granted.
    """

    def __init__(
        self,
        host: str,
        port: int,
        clock: Clock,
        allow: Sequence[Network] | None = None,
        counters: Counter[str] | None = None,
    ) -> None:
        """Raises SourceError where the port cannot be listened on."""
        self._clock = clock
        self._allow = allow
        self._allowed: dict[str, bool] = {}
        self._counters: Counter[str] = Counter() if counters is None else counters
        self._peer: Any = None
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)
            # IPv4 where a name such as localhost has both, as senders take it.
            family, kind, protocol, _, address = min(
                found, key=lambda one: one[0] == socket.AF_INET6
            )
            self._socket = socket.socket(family, kind, protocol)
        except (OSError, UnicodeError) as error:  # the latter for 192.168.1..20
            raise SourceError(f"cannot listen on UDP {host}:{port}: {error}") from error
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            self._socket.bind(address)
        except OSError as error:
            self._socket.close()
            why = {
                errno.EADDRINUSE: "another program uses it: choose another port",
                errno.EADDRNOTAVAIL: "this machine has no such address: 0.0.0.0 is all it has",
                errno.EACCES: "ports below 1024 are the system's: choose another",
            }.get(error.errno or 0, str(error))
            raise SourceError(f"cannot listen on UDP {host}:{port}: {why}") from error
        self.host: str = self._socket.getsockname()[0]
        self.port: int = self._socket.getsockname()[1]
        self.receive_buffer = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        if self.receive_buffer < RECEIVE_BUFFER:
            log.warning(
                "UDP %s:%d: receive buffer of %d KiB granted, %d asked for; a long stall may lose "
                "packets (sysctl -w net.core.rmem_max=%d)",
                *(host, self.port, self.receive_buffer >> 10, RECEIVE_BUFFER >> 10),
                RECEIVE_BUFFER,
            )

    def receive(self, timeout: float) -> Received | None:
        try:
            ready, _, _ = select.select([self._socket], [], [], timeout)
            for _ in range(AT_ONCE if ready else 0):
                data, (host, port, *_) = self._socket.recvfrom(65_536)
                if self._is_allowed(host):
                    sender = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
                    return Received(data, self._clock.now(), sender)
                self._counters["refused"] += 1
        except BlockingIOError:
            return None
        except (OSError, ValueError) as error:
            raise TransportLost(str(error)) from error
        return None

    def find_peer(self, host: str, port: int) -> None:
        """Where `send` sends to. Raises SourceError where it cannot be found or reached."""
        try:
            self._peer = socket.getaddrinfo(
                host, port, self._socket.family, socket.SOCK_DGRAM, flags=socket.AI_V4MAPPED
            )[0][4]
        except (OSError, UnicodeError) as error:
            raise SourceError(f"cannot find {host}: {error}") from error
        if _address(self.host).is_loopback and not _address(self._peer[0]).is_loopback:
            raise SourceError(
                f"{host} cannot send to {self.host}: listen on 0.0.0.0, or on this machine's own "
                "address"
            )

    def send(self, data: bytes) -> None:
        """To the peer; nothing where there is none: most OSC senders do not listen."""
        if self._peer:
            try:
                self._socket.sendto(data, self._peer)
            except OSError as error:
                raise TransportLost(str(error)) from error

    def close(self) -> None:
        self._socket.close()

    def _is_allowed(self, host: str) -> bool:
        if self._allow is None:
            return True
        if host not in self._allowed:
            if len(self._allowed) >= REMEMBERED:
                self._allowed.clear()
            address = _address(host)
            self._allowed[host] = any(address in network for network in self._allow)
        return self._allowed[host]


class OscSource(OwnedSource):
    """A source on a UDP port; `port` is the one the system gave where 0 was asked for.

    Counts packets `refused` (of senders that the option allow does not name), and commands that the
    system did not send (`unsent`).
    """

    port: int
    receive_buffer: int  # bytes that the system granted

    def __init__(self, url: Url, clock: Clock) -> None:
        host, port = url.address()
        decoder, convention = take_decoder(url)
        reorder = reorder_of(url)
        allow = url.take("allow", None, parse_networks)
        url.finish()
        self._qtm = decoder if isinstance(decoder, QtmDecoder) and decoder.control else None
        self._warned: set[str] = set()

        def connect() -> UdpTransport:
            transport = UdpTransport(host, port, clock, allow, self.counters)
            self.port, self.receive_buffer = transport.port, transport.receive_buffer
            if self._qtm and self._qtm.control:
                try:
                    transport.find_peer(*self._qtm.control)
                except SourceError:
                    transport.close()
                    raise
            if allow is None and _address(transport.host).is_unspecified:
                self._warn(
                    "%s: listens to everybody who reaches this machine; the option "
                    "allow=ADDRESS,NETWORK/BITS,... names whom to listen to",
                    url.text,
                )
            return transport

        super().__init__(url.text, connect, decoder, clock, convention=convention, reorder=reorder)

    def _say_hello(self) -> None:
        if self._qtm:
            self._tell(self._qtm.commands(self.port))

    def _say_refused(self, owner: str, sender: str) -> None:
        self._warn(
            "%s: listens to %s; %s sends to this port too, which is not read: stop one of them, "
            "name whom to listen to (option allow), or give each a port",
            *(self.name, owner, sender),
        )

    def _tell(self, commands: Iterable[bytes]) -> None:
        if self._transport is None:
            return
        try:
            for command in commands:
                self._transport.send(command)
        except TransportLost as error:  # the network is; the socket goes on
            self.counters["unsent"] += 1
            self._warn("%s: cannot send to QTM: %s", self.name, error)

    def _warn(self, text: str, *values: object) -> None:
        """Says it once, and no more than some things altogether."""
        said = text % values
        if said not in self._warned and len(self._warned) < WARNED:
            self._warned.add(said)
            log.warning(text, *values)

    def close(self) -> None:
        if self._qtm:
            self._tell(self._qtm.farewell())
        super().close()


def parse_networks(text: str) -> tuple[Network, ...]:
    """`ADDRESS,NETWORK/BITS,...`. Raises ValueError."""
    networks = []
    for entry in text.split(","):
        try:
            networks.append(ipaddress.ip_network(entry.strip(), strict=False))
        except ValueError:
            raise ValueError(
                f"'{entry}' is no address and no network: write for example "
                "192.168.1.20,192.168.2.0/24"
            ) from None
    return tuple(networks)


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The address of a sender; that of an IPv4 sender as such on an IPv6 socket too."""
    address = ipaddress.ip_address(host.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def open_osc(url: Url, clock: Clock) -> Source:
    """The source at an OSC address. Raises UrlError or SourceError."""
    return OscSource(url, clock)
