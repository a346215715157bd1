"""Virtual Motion Capture protocol: trackers, controllers and headset of a performer.

    /VMC/Ext/Tra/Pos, /VMC/Ext/Con/Pos, /VMC/Ext/Hmd/Pos
                    s serial number (the label), f f f metres, f f f f rotation
    /VMC/Ext/T      f seconds
    /VMC/Ext/OK     i 1 when it is ready, and up to three more

As on protocol.vmc.info; what else a performer sends (bones, faces) is of no use here. A lost device
is not sent.
"""

from __future__ import annotations

import math
import struct

from drivers.url import Url
from drivers.wire.assembler import take_rate
from drivers.wire.osc import OscMessage, arguments, build, label_of, sized
from drivers.wire.osc_markers import (
    MarkerDecoder,
    MarkerEncoder,
    Position,
    Slot,
    position_of,
)

FRAME = "unity"  # metres, Y up, left-handed

_DEVICES = frozenset(f"/VMC/Ext/{device}/Pos" for device in ("Tra", "Con", "Hmd"))
_TIME = "/VMC/Ext/T"
_OK = "/VMC/Ext/OK"


class VmcDecoder(MarkerDecoder):
    """Counts, beside what every MarkerDecoder counts, `not_ready` (the performer says so)."""

    def _read(self, message: OscMessage) -> tuple[str, Position] | None:
        address = message.address
        if address in _DEVICES:
            values = arguments(message)
            if len(values) != 8:
                raise ValueError("a device is its serial number and seven numbers")
            return label_of(values[0]), position_of(message.types[1:4], values[1:4])
        if address == _TIME:
            (time,) = arguments(message)
            self._time = time if isinstance(time, float) and math.isfinite(time) else math.nan
        elif address == _OK:
            if arguments(message)[:1] == [0]:
                self.counters["not_ready"] += 1
        else:
            self.counters["foreign"] += 1
        return None


class VmcEncoder(MarkerEncoder):
    """A performer with nothing but trackers: ready, the time, and a message for each tracker."""

    _ready = sized(build(_OK, ("i", 1))) + sized(build(_TIME, ("f", 0.0)))[:-4]

    def _slot(self, label: str, row: int) -> Slot:
        no_rotation = [("f", value) for value in (0.0, 0.0, 0.0, 1.0)]
        position = [("f", 0.0)] * 3
        return Slot(build("/VMC/Ext/Tra/Pos", ("s", label), *position, *no_rotation), behind=16)

    def _head(self, index: int, t_device: float) -> list[bytes]:
        return [self._ready + struct.pack(">f", t_device)]


def open_decoder(url: Url) -> VmcDecoder:
    """The host's side. Option: `rate` in Hz."""
    return VmcDecoder(take_rate(url))


def open_encoder(url: Url) -> VmcEncoder:
    """The performer's side; it has no options."""
    return VmcEncoder()
