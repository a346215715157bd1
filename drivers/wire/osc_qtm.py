"""Qualisys Track Manager's OSC output: a bundle per frame.

    /qtm/data        7 i: time in microseconds (high and low word), SMPTE time code, frame number,
                     drop rate, out-of-sync rate, count of components
    /qtm/3d/<label>  f f f millimetres, and f residual where it is asked for; NaN where it is lost

As in "QTM Real-time Server Protocol", Open Sound Control (docs.qualisys.com/qtm-rt-protocol).
QTM sends nothing until it is asked on its UDP port 22225, in messages to /qtm of one string.
"""

from __future__ import annotations

import logging
import math
import re
import struct
from urllib.parse import urlsplit

from drivers.url import Url
from drivers.wire.assembler import take_rate
from drivers.wire.osc import OscMessage, arguments, build, label_of, sized
from drivers.wire.osc_markers import (
    MarkerDecoder,
    MarkerEncoder,
    Position,
    Slot,
    in_address,
    position_of,
)

FRAME = "c3d"  # millimetres, Z up

CONTROL_PORT = 22225
_MARKER = "/qtm/3d/"
_HEAD = "/qtm/data"
# Until protocol 1.10 the time was one h. Whatever is added later (1.17 speaks of an IRIG time
# code), the frame number has three more behind it.
_HEAD_TYPES = re.compile("(ii|h)i{5,}")
_HEAD_VALUES = struct.Struct(">QIIIII")

log = logging.getLogger(__name__)


class QtmDecoder(MarkerDecoder):
    """Counts, beside what every MarkerDecoder counts, QTM's `answers`, `errors` and `no_data` (no
    measurement is running).

    control: host and port where QTM listens, if it is to be asked for its markers.
    """

    def __init__(self, rate: float | None = None, control: tuple[str, int] | None = None) -> None:
        self.control = control
        super().__init__(rate)

    def reset(self) -> None:
        super().reset()
        self._complained = False

    @staticmethod
    def commands(port: int) -> list[bytes]:
        """What makes QTM send its markers to this UDP port of ours: datagrams, in order."""
        return [_command(f"Connect {port}"), _command("StreamFrames AllFrames 3D")]

    @staticmethod
    def farewell() -> list[bytes]:
        """What makes it stop."""
        return [_command("StreamFrames Stop"), _command("Disconnect")]

    def _read(self, message: OscMessage) -> tuple[str, Position] | None:
        address = message.address
        if address.startswith(_MARKER):
            if len(message.types) > 4:
                raise ValueError("a marker is three numbers and a residual")
            label = label_of(address[len(_MARKER) :])
            return label, position_of(message.types[:3], arguments(message)[:3])
        if address == _HEAD:
            self._read_head(message)
        elif address == "/qtm/no_data":
            self.counters["no_data"] += 1
        elif address == "/qtm/cmd_res":
            self.counters["answers"] += 1
        elif address == "/qtm/error":
            self._read_error(message)
        else:
            self.counters["foreign"] += 1
        return None

    def _read_head(self, message: OscMessage) -> None:
        if not _HEAD_TYPES.fullmatch(message.types):
            raise ValueError("head is seven ints")
        values = arguments(message)
        if message.types[0] == "h":
            microseconds = values[0]
        else:
            microseconds = (values[0] << 32) + (values[1] & 0xFFFFFFFF)
        self._time, self._index = microseconds / 1e6, values[-4]

    def _read_error(self, message: OscMessage) -> None:
        self.counters["errors"] += 1
        if not self._complained:
            log.warning("QTM says: %s", " ".join(map(repr, arguments(message)))[:200])
            self._complained = True


class QtmEncoder(MarkerEncoder):
    """As QTM sends `StreamFrames AllFrames 3D`."""

    _data = sized(build(_HEAD, *[("i", 0)] * 7))[: -_HEAD_VALUES.size]

    def _slot(self, label: str, row: int) -> Slot:
        lost = build(_MARKER + in_address(label), *[("f", math.nan)] * 3)
        return Slot(lost, lost=lost)

    def _head(self, index: int, t_device: float) -> list[bytes]:
        time = round(t_device * 1e6) & 0xFFFFFFFFFFFFFFFF
        values = (0, index & 0x7FFFFFFF, 0, 0, len(self._slots))
        return [self._data + _HEAD_VALUES.pack(time, *values)]


def _command(text: str) -> bytes:
    return build("/qtm", ("s", text))


def open_decoder(url: Url) -> QtmDecoder:
    """The host's side. Options: `rate` in Hz, `control` (host or host:port where QTM listens)."""
    return QtmDecoder(take_rate(url), url.take("control", None, _parse_control))


def _parse_control(text: str) -> tuple[str, int]:
    parts = urlsplit(f"//{text}")
    if not parts.hostname or parts.path or parts.port == 0:
        raise ValueError("write the host that QTM runs on, for example control=192.168.1.20")
    return parts.hostname, parts.port or CONTROL_PORT


def open_encoder(url: Url) -> QtmEncoder:
    """QTM's side; it has no options."""
    return QtmEncoder()
