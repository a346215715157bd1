"""Source addresses to sources: one table, imported when an address asks for it."""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.frame import Source
from drivers.url import Url, UrlError

SOURCES = {
    "serial": "drivers.serial_port:open_serial",
    "osc": "drivers.osc_udp:open_osc",
    "c3d": "drivers.c3d_file:open_c3d",
    "log": "drivers.log_source:open_log",
}


class _Opener(Protocol):
    def __call__(self, url: Url, clock: Clock) -> Source: ...


def open_source(address: str, clock: Clock = SYSTEM_CLOCK) -> Source:
    """Opens a source by its address, for example `serial:/dev/ttyUSB0?baud=921600&codec=cobs`.

    Raises UrlError for an address that cannot be meant, SourceError where it cannot be opened.
    """
    url = Url.parse(address)
    if url.scheme not in SOURCES:
        raise UrlError(f"'{address}' is no source: known are {', '.join(SOURCES)}")
    module, _, function = SOURCES[url.scheme].partition(":")
    return cast(_Opener, getattr(import_module(module), function))(url, clock)
