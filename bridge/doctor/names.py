"""Which foreign label means which marker, by its name."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

_SEPARATOR = re.compile(r"[^A-Z0-9]")
_SIDE_FIRST = re.compile(r"(LEFT|RIGHT|[LR](?=[^A-Z0-9]))[^A-Z0-9]*(.+)")
_SIDE_LAST = re.compile(r"(.+?)[^A-Z0-9]+(LEFT|RIGHT|L|R)")


def by_name(wanted: Sequence[str], foreign: Sequence[str]) -> dict[str, str]:
    """Foreign label to ours, for those of `wanted` that one of `foreign` names: in other case, with
    a prefix (`ann:LFHD`, `Q_LFHD`) or with the side as a word of its own (`L_WRB`, `WRB_Left`).

    Where several do (two performers), that of the prefix that names the most, then the first.
    """
    prefixes = {
        (label, ours): prefix
        for label in foreign
        for ours in wanted
        if (prefix := _prefix(label, ours)) is not None
    }
    common = Counter(prefixes.values())
    found: dict[str, str] = {}
    for label, ours in sorted(prefixes, key=lambda pair: -common[prefixes[pair]]):
        if label not in found and ours not in found.values():
            found[label] = ours
    return found


def _prefix(label: str, ours: str) -> str | None:
    """What stands before the marker's name in a label; None where it does not name this marker."""
    text = label.upper()
    # FIRELBO names no elbow: a prefix ends in something that is neither letter nor digit.
    for start in (0, *(match.end() for match in _SEPARATOR.finditer(text))):
        if _plain(text[start:]) == ours:
            return text[:start]
    return None


def _plain(name: str) -> str:
    """`L_WRB`, `LEFTWRB` and `WRB.LEFT` as `LWRB`."""
    if parts := _SIDE_FIRST.fullmatch(name):
        name = parts[1][0] + parts[2]
    elif parts := _SIDE_LAST.fullmatch(name):
        name = parts[2][0] + parts[1]
    return _SEPARATOR.sub("", name)
