"""Files that appear whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file whole or not at all. Raises MarkerbridgeError where that cannot be."""
    try:
        with whole_file(path) as part:
            part.write_bytes(content)
    except OSError as error:
        raise MarkerbridgeError(f"cannot write {path}: {error.strerror}") from error
