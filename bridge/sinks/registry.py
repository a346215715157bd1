"""Sink addresses to sinks: one table, imported when an address asks for it."""

from __future__ import annotations

from importlib import import_module
from typing import Protocol, cast

from bridge.sinks.sink import Sink, SinkContext
from drivers.url import Url, UrlError

SINKS = {
    "vmc": "bridge.sinks.vmc:VmcSink",
    "vrchat": "bridge.sinks.vrchat:VrchatSink",
    "vmt": "bridge.sinks.vmt:VmtSink",
    "qtm-osc": "bridge.sinks.qtm_osc:QtmOscSink",
    "osc": "bridge.sinks.osc:OscSink",
    "c3d": "bridge.sinks.c3d:C3dSink",
    "view": "bridge.sinks.view:ViewSink",
    "log": "bridge.sinks.log:LogSink",
    "mqtt": "bridge.sinks.mqtt:MqttSink",
}


class _Opener(Protocol):
    def __call__(self, url: Url, context: SinkContext) -> Sink: ...


def open_sink(address: str, context: SinkContext) -> Sink:
    """Opens a sink by its address, for example `vmc://127.0.0.1:39539?rate=120`.

    Raises UrlError for an address that cannot be meant, SinkError where it cannot be opened,
    AddressError where its host is unknown.
    """
    url = Url.parse(address)
    if url.scheme not in SINKS:
        raise UrlError(f"'{address}' is no sink: known are {', '.join(SINKS)}")
    module, _, name = SINKS[url.scheme].partition(":")
    return cast(_Opener, getattr(import_module(module), name))(url, context)
