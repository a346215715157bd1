"""The constants of an ONNX file, which onnxruntime uses but does not tell.

Of the format (protobuf, onnx.proto) no more than that: a model's graph (field 7), its initializers
(field 5), and their shape, type, name and raw bytes (fields 1, 2, 8 and 9).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

_GRAPH, _INITIALIZER = 7, 5
_SHAPE, _TYPE, _NAME, _RAW = 1, 2, 8, 9
_TYPES: dict[int, np.dtype[Any]] = {1: np.dtype("<f4"), 7: np.dtype("<i8")}
_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # how a field is written


Constant = npt.NDArray[Any]
Constants = dict[str, Constant]


def constants(path: Path) -> Constants:
    """All float32 and int64 constants of a model's graph, by name. Raises ValueError, OSError."""
    found: Constants = {}
    try:
        for graph in _under(memoryview(path.read_bytes()), _GRAPH):
            for tensor in _under(graph, _INITIALIZER):
                found |= _tensor(tensor)
    except IndexError as error:
        raise ValueError("the file is cut") from error
    return found


def _tensor(tensor: memoryview) -> Constants:
    """A tensor by its name; nothing where it is of another type."""
    shape: list[int] = []
    kind, name, raw = 0, "", memoryview(b"")
    for field, value in _fields(tensor):
        if field == _SHAPE:
            shape += [value] if isinstance(value, int) else _varints(value)
        elif field == _TYPE and isinstance(value, int):
            kind = value
        elif field == _NAME and isinstance(value, memoryview):
            name = bytes(value).decode()
        elif field == _RAW and isinstance(value, memoryview):
            raw = value
    if kind not in _TYPES or len(raw) != _TYPES[kind].itemsize * math.prod(shape):
        return {}
    return {name: np.frombuffer(raw, _TYPES[kind]).reshape(shape).copy()}


def _under(data: memoryview, field: int) -> Iterator[memoryview]:
    for number, value in _fields(data):
        if number == field and isinstance(value, memoryview):
            yield value


def _fields(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        field, written = tag >> 3, tag & 7
        if written == _VARINT:
            value, at = _varint(data, at)
            yield field, value
            continue
        if written == _BYTES:
            size, at = _varint(data, at)
        elif written in (_EIGHT, _FOUR):
            size = 8 if written == _EIGHT else 4
        else:
            raise ValueError(f"a field is written in an unknown way ({written})")
        if at + size > len(data):
            raise ValueError("a field is longer than the file")
        yield field, data[at : at + size]
        at += size


def _varints(data: memoryview) -> list[int]:
    found, at = [], 0
    while at < len(data):
        value, at = _varint(data, at)
        found.append(value)
    return found


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while shift < 64:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not data[at - 1] & 0x80:
            return value, at
    raise ValueError("a number is longer than any")
