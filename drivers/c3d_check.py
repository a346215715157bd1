"""Whether a file can be a whole C3D file, before ezc3d reads it: on a cut one it may never return.

Header and parameter section as in the C3D file format's user guide (c3d.org).
"""

from __future__ import annotations

import math
import struct

_BLOCK = 512  # bytes
# Processor types, and where each keeps the sign of the header's scale (bytes 12 to 15): a negative
# scale means coordinates of 4 bytes, a positive one of 2.
_INTEL, _DEC, _MIPS = 84, 85, 86
_SIGN = {_INTEL: 15, _DEC: 13, _MIPS: 12}


def check_c3d(data: bytes) -> None:
    """Raises ValueError, saying what is wrong, where the bytes are no whole C3D file."""
    if len(data) < 2 * _BLOCK or data[1] != 0x50:
        raise ValueError("it does not begin as a C3D file does")
    start = (data[0] - 1) * _BLOCK
    if start < 0 or start + 4 > len(data):
        raise ValueError("it ends before its parameters")
    blocks, processor = data[start + 2], data[start + 3]
    if processor not in _SIGN:
        raise ValueError(f"unknown processor type {processor}")
    order = ">" if processor == _MIPS else "<"
    end = start + blocks * _BLOCK
    if end > len(data):
        raise ValueError("it ends within its parameters")
    _walk_parameters(data, start + 4, end, order)

    points, analog, first, last = struct.unpack_from(order + "4H", data, 2)
    (data_block,) = struct.unpack_from(order + "H", data, 16)
    size = 4 if data[_SIGN[processor]] & 0x80 else 2
    needed = (data_block - 1) * _BLOCK + max(0, last - first + 1) * (4 * points + analog) * size
    if data_block < 1 or needed > len(data):
        raise ValueError(f"it is cut short: {len(data)} bytes of {needed}")


def _walk_parameters(data: bytes, at: int, end: int, order: str) -> None:
    """Follows the section's entries to its end; each must lead forward and stay inside."""
    while at + 2 <= end:
        name = abs(struct.unpack_from("b", data, at)[0])
        if name == 0:
            return
        link = at + 2 + name
        if link + 2 > end:
            break
        (offset,) = struct.unpack_from(order + "H", data, link)
        after = link + offset if offset else end
        if data[at + 1] < 0x80:  # a parameter, not a group: its values must fit in
            kind, dimensions = struct.unpack_from("bB", data, link + 2)
            sizes = data[link + 4 : link + 4 + dimensions]
            if (
                kind not in (-1, 1, 2, 4)
                or dimensions > 7
                or (link + 4 + dimensions + abs(kind) * math.prod(sizes) > after)
            ):
                raise ValueError("its parameters hold more than their room")
        if offset == 0:
            return
        at = after
    raise ValueError("its parameters have no end")
