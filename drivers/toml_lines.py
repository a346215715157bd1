"""Where a key of a TOML file stands, for errors that name the line."""

from __future__ import annotations

import tomllib
from typing import Any

_OPEN = ("", "\n]", "\n]]", "\n]]]")  # what ends an array that goes on over the next lines


def line_of(text: str, path: tuple[str | int, ...]) -> int | None:
    """The line, counted from 1, where `path` begins; None where the text does not hold it.

    path: keys and indices from the root, for example `("sinks", 1)` or `("fault", 0, "kind")`; the
    line of a table is that of its header, or of its first key where it has none.

    The first lines of the text that can be read are read again and again, one line more each
    time, until they hold the path: that way there is no second grammar to get wrong.
    """
    lines = text.replace("\r\n", "\n").split("\n")
    whole = 0  # lines up to the end of the last statement or element of an array
    for count in range(1, len(lines) + 1):
        found = _read("\n".join(lines[:count]))
        if found is None:
            continue
        if _holds(found, path):
            return whole + 1
        whole = count
    return None


def _read(text: str) -> dict[str, Any] | None:
    for end in _OPEN:
        try:
            return tomllib.loads(text + end)
        except tomllib.TOMLDecodeError:
            continue
    return None


def _holds(table: Any, path: tuple[str | int, ...]) -> bool:
    for step in path:
        if isinstance(step, str):
            if not isinstance(table, dict) or step not in table:
                return False
        elif not isinstance(table, list) or not 0 <= step < len(table):
            return False
        table = table[step]
    return True
