"""What the doctor finds, and an address with the options that mend it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from urllib.parse import quote, unquote

_COORDINATES = frozenset({"frame", "axes", "unit"})
_READABLE = "/:,.*-_~#[]@"  # in an option's value they mean nothing but themselves


class Grade(IntEnum):
    """How bad it is; the worst comes first."""

    WRONG = 0  # the body will be wrong, or not there
    POOR = 1  # it works, but suffers
    NOTE = 2  # nothing to mend


@dataclass(frozen=True, eq=False)
class Finding:
    """One line. about: a word for machines. options: what to write into the source's address; an
    empty value takes an option out of it.
    """

    grade: Grade
    about: str
    text: str
    options: Mapping[str, str] = field(default_factory=dict)


def corrected(address: str, options: Mapping[str, str]) -> str:
    """The address with these options in place of its own; other worlds' coordinates replace each
    other: with `frame` go an old `axes` and `unit`. An option without a value goes.
    """
    base, _, query = address.partition("?")
    pairs = [tuple(part.partition("=")[::2]) for part in query.split("&") if part]
    replaced = set(options)
    if "frame" in options or "axes" in options:
        replaced |= _COORDINATES
    kept = [(name, value) for name, value in pairs if unquote(name) not in replaced]
    written = [(name, quote(value, safe=_READABLE)) for name, value in options.items() if value]
    joined = "&".join(f"{name}={value}" for name, value in [*kept, *written])
    return f"{base}?{joined}" if joined else base
