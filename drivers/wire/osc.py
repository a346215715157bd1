"""OSC 1.0 packets taken apart with every length checked before it is used.

python-osc's parser loops, hangs or raises on some hostile packets (docs/decisions/0003-osc.md),
so packets from the network go through this one; python-osc builds the packets we send.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

MAX_DEPTH = 4
_BUNDLE = b"#bundle\0"
_PATTERN = frozenset(b" #*,?[]{}")
_SIZES = {"i": 4, "f": 4, "d": 8, "h": 8, "t": 8, "T": 0, "F": 0, "N": 0, "I": 0}
_READ = {"i": ">i", "f": ">f", "d": ">d", "h": ">q", "t": ">Q"}


class OscError(ValueError):
    """A packet that is not OSC; the message says where it went wrong."""


@dataclass(frozen=True, slots=True)
class OscMessage:
    """Address, type tags without the comma, and the argument bytes (a multiple of 4 long)."""

    address: str
    types: str
    data: bytes


def messages(packet: bytes) -> list[OscMessage]:
    """All messages of a packet, those of bundles in order; time tags are not obeyed.

    Raises OscError for anything that is not a well-formed message or bundle.
    """
    return list(_messages(packet, 0))


def _messages(packet: bytes, depth: int) -> Iterator[OscMessage]:
    if not packet or len(packet) % 4:
        raise OscError(f"length {len(packet)} is no positive multiple of 4")
    if not packet.startswith(_BUNDLE):
        yield _message(packet)
        return
    if depth == MAX_DEPTH:
        raise OscError(f"bundles nested deeper than {MAX_DEPTH}")
    if len(packet) < 16:
        raise OscError("bundle without a time tag")
    at = 16
    while at < len(packet):
        (size,) = struct.unpack_from(">i", packet, at)
        at += 4
        if size <= 0 or size % 4 or at + size > len(packet):
            raise OscError(f"bundle element of size {size}, {len(packet) - at} bytes left")
        yield from _messages(packet[at : at + size], depth + 1)
        at += size


def _message(packet: bytes) -> OscMessage:
    address, at = _string(packet, 0)
    if not address.startswith("/") or _PATTERN & set(address.encode("ascii")):
        raise OscError("address does not start with / or holds pattern characters")
    types, at = _string(packet, at)
    if not types.startswith(","):
        raise OscError("no type tags")
    return OscMessage(address, types[1:], packet[at:])


def _string(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise OscError("string without an end")
    after = (end // 4 + 1) * 4
    text = data[at:end]
    if not text.isascii() or after > len(data) or data[end:after].strip(b"\0"):
        raise OscError("string is not ASCII padded with zeros")
    return text.decode("ascii"), after


def arguments(message: OscMessage) -> list[int | float | str | bytes | bool | None]:
    """The arguments in order. Raises OscError for unknown types or another length."""
    values: list[int | float | str | bytes | bool | None] = []
    data, at = message.data, 0
    for tag in message.types:
        if tag == "s":
            text, at = _string(data, at)
            values.append(text)
        elif tag == "b":
            if at + 4 > len(data):
                raise OscError("blob without a size")
            (size,) = struct.unpack_from(">i", data, at)
            if size < 0 or at + 4 + size > len(data):
                raise OscError(f"blob of size {size}")
            values.append(data[at + 4 : at + 4 + size])
            at += 4 + (size + 3) // 4 * 4
        elif tag in _SIZES:
            if at + _SIZES[tag] > len(data):
                raise OscError("arguments shorter than the type tags say")
            values.append(
                struct.unpack_from(_READ[tag], data, at)[0] if tag in _READ else tag == "T"
            )
            at += _SIZES[tag]
        else:
            raise OscError(f"unknown type tag {tag!r}")
    if at != len(data):
        raise OscError("arguments longer than the type tags say")
    return values
