"""Files that appear whole or not at all, and JSON that a machine reads."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import MarkerbridgeError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A name beside `path` to write to; moved to `path` at the end, removed after an error."""
    # Some libraries go by the ending, and only in small letters.
    part = path.with_name(f".part-{path.stem}{path.suffix.lower()}")
    try:
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def numbered(path: Path, number: int) -> Path:
    """The name of part `number` of a recording: `out.c3d`, then `out-2.c3d` and so on."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def of_performer(path: Path, performer: str) -> Path:
    """The name of one performer's recording: `out-ann.c3d`; as it is where there is one alone."""
    return path.with_name(f"{path.stem}-{performer}{path.suffix}") if performer else path


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file whole or not at all. Raises MarkerbridgeError where that cannot be."""
    try:
        with whole_file(path) as part:
            part.write_bytes(content)
    except OSError as error:
        raise MarkerbridgeError(f"cannot write {path}: {error.strerror}") from error


def write_json(path: Path, found: Mapping[str, Any]) -> None:
    """Writes JSON. Raises MarkerbridgeError where that cannot be."""
    # In place and not whole or not at all: it may be /dev/stdout.
    try:
        path.write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise MarkerbridgeError(f"cannot write {path}: {error.strerror}") from error
