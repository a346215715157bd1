"""OSC 1.0 packets taken apart with every length checked before it is used, and built.

python-osc's parser loops, hangs or raises on some hostile packets (docs/decisions/0003-osc.md),
so packets from the network go through this one; python-osc builds the messages we send.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

from pythonosc.osc_message_builder import OscMessageBuilder

MAX_DEPTH = 4
MAX_MESSAGES = 1024  # of a packet: as many as 64 KiB hold would keep a core busy
MAX_ARGUMENTS = 4096  # of a message
MAX_ADDRESS = 256  # bytes, padding included
LONGEST_LABEL = 255  # characters

_BUNDLE = b"#bundle\0"
_IMMEDIATELY = b"\0\0\0\0\0\0\0\1"
# What a receiver would match other addresses with. Spaces, # and commas are forbidden too, but
# markers and bodies are named "Rigid Body 1" all the same.
_PATTERN = re.compile(r"[*?\[\]{}]")
_SIZE = struct.Struct(">i")
_FORMATS = str.maketrans("ifdht", "ifdqQ")  # of type tags, for struct
_CONSTANTS = {"T": True, "F": False, "N": None, "I": math.inf}


class OscError(ValueError):
    """A packet that is not OSC; the message says where it went wrong."""


class OscMessage(NamedTuple):
    """Address, type tags without the comma, and the argument bytes (a multiple of 4 long)."""

    address: str
    types: str
    data: bytes


def messages(packet: bytes) -> list[OscMessage]:
    """All messages of a packet, those of bundles in order; time tags are not obeyed.

    Raises OscError for anything that is not a well-formed message or bundle, and for more than
    1,024 messages.
    """
    found: list[OscMessage] = []
    _collect(packet, 0, found)
    return found


def is_bundle(packet: bytes) -> bool:
    """Whether what a packet holds was sent together."""
    return packet.startswith(_BUNDLE)


def _collect(packet: bytes, depth: int, found: list[OscMessage]) -> None:
    if not packet or len(packet) % 4:
        raise OscError(f"length {len(packet)} is no positive multiple of 4")
    if not packet.startswith(_BUNDLE):
        if len(found) == MAX_MESSAGES:
            raise OscError(f"more than {MAX_MESSAGES} messages")
        found.append(_message(packet))
        return
    if depth == MAX_DEPTH:
        raise OscError(f"bundles nested deeper than {MAX_DEPTH}")
    if len(packet) < 16:
        raise OscError("bundle without a time tag")
    at = 16
    while at < len(packet):
        (size,) = _SIZE.unpack_from(packet, at)
        at += 4
        if size <= 0 or size % 4 or at + size > len(packet):
            raise OscError(f"bundle element of size {size}, {len(packet) - at} bytes left")
        _collect(packet[at : at + size], depth + 1, found)
        at += size


def _message(packet: bytes) -> OscMessage:
    at = _after_string(packet, 0)
    at_data = _after_string(packet, at)
    # Every frame brings the same addresses and type tags again: each is looked at but once.
    if at > MAX_ADDRESS or at_data - at > MAX_ARGUMENTS:
        raise OscError("address or type tags too long")
    return OscMessage(_address(packet[:at]), _types(packet[at:at_data]), packet[at_data:])


@lru_cache(maxsize=1024)
def _address(field: bytes) -> str:
    address = _text(field)
    if not address.startswith("/") or _PATTERN.search(address):
        raise OscError("address does not start with / or holds pattern characters")
    return address


@lru_cache(maxsize=256)
def _types(field: bytes) -> str:
    types = _text(field)
    if not types.startswith(","):
        raise OscError("no type tags")
    return types[1:]


def _after_string(data: bytes, at: int) -> int:
    """Where the string at `at` ends with its padding; strings are padded to a multiple of 4."""
    end = data.find(b"\0", at)
    if end < 0:
        raise OscError("string without an end")
    return (end // 4 + 1) * 4


def _text(field: bytes) -> str:
    text = field.rstrip(b"\0")
    if b"\0" in text or len(field) - len(text) > 4:
        raise OscError("string is not padded with zeros")
    try:
        return text.decode("utf-8")  # OSC says ASCII; users name their markers as they like
    except UnicodeDecodeError as error:
        raise OscError("string is not UTF-8") from error


def arguments(message: OscMessage) -> list[Any]:
    """The arguments in order, each of the type that its tag says.

    Raises OscError for unknown types or another length.
    """
    values: list[Any] = []
    data, at = message.data, 0
    for step in _plan(message.types):
        if isinstance(step, struct.Struct):
            if at + step.size > len(data):
                raise OscError("arguments shorter than the type tags say")
            values += step.unpack_from(data, at)
            at += step.size
        elif step == "s":
            after = _after_string(data, at)
            values.append(_text(data[at:after]))
            at = after
        elif step == "b":
            if at + 4 > len(data):
                raise OscError("blob without a size")
            (size,) = _SIZE.unpack_from(data, at)
            if size < 0 or at + 4 + size > len(data):
                raise OscError(f"blob of size {size}")
            values.append(data[at + 4 : at + 4 + size])
            at += 4 + (size + 3) // 4 * 4
        elif step in _CONSTANTS:
            values.append(_CONSTANTS[step])
        else:
            raise OscError(f"unknown type tag {step!r}")
    if at != len(data):
        raise OscError("arguments longer than the type tags say")
    return values


@lru_cache(maxsize=64)
def _plan(types: str) -> tuple[struct.Struct | str, ...]:
    """How to read arguments: numbers that follow each other are read at once."""
    return tuple(
        struct.Struct(">" + numbers.translate(_FORMATS)) if numbers else other
        for numbers, other in re.findall(r"([ifdht]+)|(.)", types, re.DOTALL)
    )


def label_of(text: object) -> str:
    """A label from the wire. Raises ValueError where it cannot be one."""
    if not isinstance(text, str) or not 0 < len(text) <= LONGEST_LABEL or not text.isprintable():
        raise ValueError("no label")
    return text


def build(address: str, *values: tuple[str, int | float | str]) -> bytes:
    """A message; each value is written with its type tag, for example ("f", 1.0)."""
    builder = OscMessageBuilder(address)
    for tag, value in values:
        builder.add_arg(value, tag)
    return builder.build().dgram


def build_bundle(elements: Iterable[bytes]) -> bytes:
    """A bundle to be obeyed immediately, of messages that have their size before them (`sized`)."""
    return _BUNDLE + _IMMEDIATELY + b"".join(elements)


def sized(message: bytes) -> bytes:
    """A message as an element of a bundle."""
    return _SIZE.pack(len(message)) + message
