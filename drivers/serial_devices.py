"""Serial ports: which there are, and what is being sent on them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.serial_port import PortError, SerialTransport, listed_ports
from drivers.transport import Received, TransportLost
from drivers.url import Url
from drivers.wire.guess import Guess, guess_wire, wires
from drivers.wire.registry import take_decoder

BAUDS = (921_600, 115_200, 57_600, 38_400, 9_600)  # the likely ones, ours first
BY_ID = Path("/dev/serial/by-id")
DEFAULTS = {"codec": "cobs", "baud": "921600"}  # what an address need not name
PATIENCE = 0.3  # s: a port is read so long at a time


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port. by_id: its path that stays the same whatever else is plugged in."""

    path: str
    maker: str = ""
    product: str = ""
    serial_number: str = ""
    by_id: str = ""


@dataclass(frozen=True, slots=True)
class Identity:
    """What was heard on a port. address: how to open it, where the codec could be told. trouble:
    why it could not be listened to. heard: bytes by rate.
    """

    port: Port
    address: str = ""
    trouble: str = ""
    heard: dict[int, int] = field(default_factory=dict)


def ports(given: Iterable[str] = ()) -> list[Port]:
    """Those named, else all that the system knows."""
    links = {os.path.realpath(link): str(link) for link in BY_ID.glob("*")}
    known = {str(port.device): _port(port, links) for port in listed_ports()}
    named = list(given)
    if not named:
        return list(known.values())
    return [known.get(os.path.realpath(path), Port(path)) for path in named]


def _port(port: Any, links: dict[str, str]) -> Port:
    return Port(
        str(port.device),
        port.manufacturer or "",
        port.product or "",
        port.serial_number or "",
        links.get(os.path.realpath(port.device), ""),
    )


def identify_all(found: list[Port], seconds: float, clock: Clock = SYSTEM_CLOCK) -> list[Identity]:
    """Listens to all of them at once, at each likely rate for so many seconds at most."""
    if not found:
        return []
    with ThreadPoolExecutor(len(found), "port") as threads:
        return list(threads.map(lambda port: identify(port, seconds, clock), found))


def identify(port: Port, seconds: float, clock: Clock = SYSTEM_CLOCK) -> Identity:
    """Listens at each likely rate until the bytes make sense, and says hello in all codecs."""
    heard: dict[int, int] = {}
    # A pseudo-terminal has no rate: one is as good as another.
    is_pty = os.path.realpath(port.path).startswith("/dev/pts/")
    for baud in BAUDS[:1] if is_pty else BAUDS:
        try:
            received = _listen(port.path, baud, seconds, clock)
        except PortError as error:
            return Identity(port, trouble=error.reason, heard=heard)
        except TransportLost as error:
            return Identity(port, trouble=f"it went away: {error}", heard=heard)
        heard[baud] = sum(len(entry.data) for entry in received)
        guess = guess_wire("serial", received)
        if guess:
            return Identity(port, address=_address(port.path, baud, guess), heard=heard)
    return Identity(port, heard=heard)


def _listen(path: str, baud: int, seconds: float, clock: Clock) -> list[Received]:
    """What comes in so many seconds. Raises PortError or TransportLost."""
    hellos = {_hello(options) for options in wires("serial")} - {b""}
    transport = SerialTransport(path, baud, clock)
    received = []
    try:
        end = clock.now() + seconds
        for hello in sorted(hellos):
            transport.send(hello)
        while (left := end - clock.now()) > 0:
            entry = transport.receive(min(left, PATIENCE))
            if entry is not None:
                received.append(entry)
    finally:
        transport.close()
    return received


def _hello(options: dict[str, str]) -> bytes:
    decoder, _ = take_decoder(Url.parse(f"serial:?{urlencode(options)}"))
    return decoder.hello


def _address(path: str, baud: int, guess: Guess) -> str:
    options = {**guess.options, "baud": str(baud)}
    written = [f"{name}={value}" for name, value in options.items() if DEFAULTS.get(name) != value]
    return f"serial:{path}" + (f"?{'&'.join(written)}" if written else "")
