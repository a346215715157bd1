"""A few letters drawn as strokes: Open3D's plain window has no text of its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# On a grid 4 wide and 6 high: polylines of x and y, parted by blanks.
_GLYPHS = {
    " ": "",
    "0": "103041453616050110",
    "1": "152620",
    "2": "05163645440040",
    "3": "051636454433 1333 334241301001",
    "4": "30360242",
    "5": "460603334241301001",
    "6": "4536160501103041423303",
    "7": "064610",
    "8": "13040516364544331302011030414233",
    "9": "0110304145361605041343",
    "M": "0006234640",
    "R": "00063645443303 2340",
    "S": "453616050413334241301001",
    "m": "0004 03142320 23344340",
}
ADVANCE = 5.6  # grid units from one letter to the next


def strokes(text: str) -> Array:
    """Straight strokes (S, 2, 2) that write `text`, one unit high, starting at the origin."""
    found: list[tuple[tuple[float, float], tuple[float, float]]] = []
    for place, letter in enumerate(text):
        for line in _GLYPHS[letter].split():
            pairs = zip(line[::2], line[1::2], strict=True)
            found += pairwise((int(x) + ADVANCE * place, int(y)) for x, y in pairs)
    return np.array(found, np.float64).reshape(-1, 2, 2) / 6


def width(text: str) -> float:
    """How long `text` is, in units of its height."""
    return (ADVANCE * len(text) - (ADVANCE - 4)) / 6
