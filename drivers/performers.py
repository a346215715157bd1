"""Who is in a stream of several: their names, and labels that begin with these."""

from __future__ import annotations

import re
from collections.abc import Sequence


def parse_name(text: str) -> str:
    """A performer's name. Raises ValueError."""
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,32}", text):
        raise ValueError("a name is letters, digits, - and _, 32 at most")
    if re.search(r"-\d+$", text):  # take-ann-2.c3d is how ann's recording goes on
        raise ValueError("a name does not end with - and a number: that is part of a recording")
    return text


def parse_names(text: str) -> tuple[str, ...]:
    """`ann,bob`. Raises ValueError."""
    names = tuple(map(parse_name, text.split(",")))
    if len(set(names)) < len(names):
        raise ValueError("a performer is named twice")
    return names


def labels_of(labels: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """The labels of one, for each of them in turn: `ann:LFHD` is ann's LFHD."""
    return tuple(f"{name}:{label}" for name in names for label in labels)
