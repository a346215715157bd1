"""OptiTrack's markers and rigid bodies, as two programs make OSC of Motive's NatNet stream.

NatNet2OSCbridge (github.com/hku-ect), a bundle per frame:

    /marker            i number, f f f metres
    /rigidBody/<name>  i number, s name, 7 f position and rotation, 6 f velocities or none, and
                       i 1 while it is tracked; or all bodies at /rigidBody

NatNetThree2OSC and NatNetFour2OSC (github.com/tecartlab, immersive-arts), one by one or bundled:

    /frame/start       i frame number
    /frame/timestamp   i milliseconds
    /marker            i number, s "position", f f f; or /marker/<number>/position f f f
    /rigidbody         i number, s "position", f f f; or /rigidbody/<number>/position f f f, or
                       /rigidbody/<number>/transformation 7 f; not sent while it is not tracked
    /frame/end         i frame number

A marker's label is its number, a body's its name, or `body` and its number.
"""

from __future__ import annotations

import math
import re

from drivers.url import Url
from drivers.wire.assembler import take_rate
from drivers.wire.osc import OscMessage, arguments, build, label_of
from drivers.wire.osc_markers import (
    MarkerDecoder,
    MarkerEncoder,
    Position,
    Slot,
    in_address,
    position_of,
)

FRAME = "opengl"  # metres, Y up, as Motive streams unless it is told otherwise

LOST = (math.nan, math.nan, math.nan)
_BODY = re.compile("/rigidBody(/.*)?")
_BODY_TYPES = re.compile("isf{7}(f{6})?i?")
_NUMBERED = re.compile(r"/(marker|rigidbody)/(-?\d{1,10})/(position|transformation)")
_NUMBER = re.compile("0|[1-9][0-9]{0,8}")
# Of the same programs, and of no use here: residuals, rotations, whether a body is tracked.
_UNUSED = re.compile("/(marker|rigidbody|frame)/.*")


class NatNetDecoder(MarkerDecoder):
    """Motive's rigid bodies count as markers, at their pivots."""

    def _read(self, message: OscMessage) -> tuple[str, Position] | None:
        address = message.address
        if address in ("/marker", "/rigidbody"):
            return _read_numbered(message)
        if _BODY.fullmatch(address):
            return _read_named(message)
        if found := _NUMBERED.fullmatch(address):
            kind, number, _ = found.groups()
            return _label(kind, int(number)), _position(message, 0)
        if address == "/frame/start":
            self._index = _whole_number(message)
        elif address == "/frame/timestamp":
            self._time = _whole_number(message) / 1e3
        elif address == "/frame/end":
            self._ended = True
        elif not _UNUSED.fullmatch(address):
            self.counters["foreign"] += 1
        return None


def _read_named(message: OscMessage) -> tuple[str, Position]:
    if not _BODY_TYPES.fullmatch(message.types):
        raise ValueError("a body is its number, its name and 7 or 13 numbers")
    values = arguments(message)
    lost = message.types[-1] == "i" and values[-1] == 0
    return label_of(values[1]), LOST if lost else values[2:5]


def _read_numbered(message: OscMessage) -> tuple[str, Position] | None:
    """A marker or body with its number first, and in some programs a word for what follows."""
    number, *more = arguments(message)
    if message.types[0] != "i":
        raise ValueError("a marker begins with its number")
    label = _label(message.address[1:], number)
    if message.types[1:2] != "s":
        return label, _position(message, 1)
    return (label, _position(message, 2)) if more[0] == "position" else None


def _label(kind: str, number: int) -> str:
    return str(number) if kind == "marker" else f"body{number}"


def _position(message: OscMessage, at: int) -> Position:
    return position_of(message.types[at : at + 3], arguments(message)[at : at + 3])


def _whole_number(message: OscMessage) -> int:
    if message.types not in ("i", "h"):
        raise ValueError("one whole number")
    return int(arguments(message)[0])


class NatNetEncoder(MarkerEncoder):
    """As NatNet2OSCbridge sends it, without velocities: labels that are numbers as markers, others
    as bodies. There is no frame number and no time.
    """

    def _slot(self, label: str, row: int) -> Slot:
        position = [("f", 0.0)] * 3
        if _NUMBER.fullmatch(label):
            return Slot(build("/marker", ("i", int(label)), *position))
        address = "/rigidBody/" + in_address(label)
        no_rotation = [("f", value) for value in (0.0, 0.0, 0.0, 1.0)]

        def body(tracked: int) -> bytes:
            values = (*position, *no_rotation, ("i", tracked))
            return build(address, ("i", row + 1), ("s", label), *values)

        return Slot(body(1), behind=20, lost=body(0))


def open_decoder(url: Url) -> NatNetDecoder:
    """The host's side. Option: `rate` in Hz."""
    return NatNetDecoder(take_rate(url))


def open_encoder(url: Url) -> NatNetEncoder:
    """The bridge's side; it has no options."""
    return NatNetEncoder()
