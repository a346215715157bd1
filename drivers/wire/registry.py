"""Names of codecs (serial) and dialects (OSC) to the modules that read and write them.

Each module has `open_decoder(url)`, `open_encoder(url)`, which take the wire's own options off the
address, and `FRAME`, the name of the coordinates that this wire usually carries.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Protocol, cast

from drivers.convention import Convention
from drivers.coordinates import FRAMES
from drivers.url import Url
from drivers.wire.codec import Decoder, Encoder

CODECS = {
    "cobs": "drivers.wire.cobs",
    "slip-osc": "drivers.wire.slip",
    "lines": "drivers.wire.lines",
    "fastrak": "drivers.wire.fastrak",
}
DIALECTS = {
    "native": "drivers.wire.osc_native",
    "qtm": "drivers.wire.osc_qtm",
    "natnet": "drivers.wire.osc_natnet",
    "vmc": "drivers.wire.osc_vmc",
    "vrchat": "drivers.wire.osc_vrchat",
}


class Wire(Protocol):
    """A module that reads and writes a wire."""

    FRAME: str

    def open_decoder(self, url: Url) -> Decoder: ...

    def open_encoder(self, url: Url) -> Encoder: ...


def take_decoder(url: Url) -> tuple[Decoder, Convention]:
    """What reads the wire that an address names, and how its world is. Raises UrlError."""
    wire = _take_wire(url)
    return wire.open_decoder(url), Convention.take(url, FRAMES[wire.FRAME])


def take_encoder(url: Url) -> tuple[Encoder, Convention]:
    """What writes the wire that an address names, and how its world is. Raises UrlError."""
    wire = _take_wire(url)
    return wire.open_encoder(url), Convention.take(url, FRAMES[wire.FRAME])


def _take_wire(url: Url) -> Wire:
    if url.scheme == "serial":
        return cast(Wire, import_module(url.take("codec", CODECS["cobs"], _among(CODECS))))
    return take_dialect(url)


def take_dialect(url: Url) -> Wire:
    """The OSC dialect that an address names. Raises UrlError."""
    return cast(Wire, import_module(url.take("dialect", DIALECTS["native"], _among(DIALECTS))))


def _among(table: dict[str, str]) -> Callable[[str], str]:
    def find(name: str) -> str:
        if name not in table:
            raise ValueError(f"known are {', '.join(table)}")
        return table[name]

    return find
