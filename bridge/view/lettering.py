"""Capitals drawn as strokes: Open3D's plain window has no text of its own."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bridge.view.mesh import Array

# On a grid 4 wide and 6 high: polylines of x and y, parted by blanks.
_GLYPHS = {
    " ": "",
    "+": "0343 2125",
    "-": "0343",
    ",": "1021",
    ".": "2021",
    "/": "0046",
    ":": "2122 2425",
    "<": "450341",
    ">": "054301",
    "←": "4303 250321",
    "→": "0343 254321",
    "↑": "2026 042644",
    "↓": "2620 022042",
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
    "A": "0004264440 0343",
    "B": "00063645443303 3342413000",
    "C": "4536160501103041",
    "D": "00062644422000",
    "E": "46060040 0333",
    "F": "460600 0333",
    "G": "45361605011030414323",
    "H": "0006 4640 0343",
    "I": "1030 1636 2026",
    "J": "4641301001",
    "K": "0006 460340",
    "L": "060040",
    "M": "0006234640",
    "N": "00064046",
    "O": "103041453616050110",
    "P": "00063645443303",
    "Q": "103041453616050110 2240",
    "R": "00063645443303 2340",
    "S": "453616050413334241301001",
    "T": "0646 2620",
    "U": "060110304146",
    "V": "062046",
    "W": "0610233046",
    "X": "0046 0640",
    "Y": "062346 2320",
    "Z": "06460040",
    "m": "0004 03142320 23344340",
    "s": "443404033342403000",
    "x": "0044 0440",
}
ADVANCE = 5.6  # grid units from one letter to the next


def strokes(text: str) -> Array:
    """Straight strokes (S, 2, 2) that write `text`, one unit high, starting at the origin.

    Small letters but m, s and x are written as capitals, others that it lacks are left blank.
    """
    found: list[tuple[tuple[float, float], tuple[float, float]]] = []
    for place, letter in enumerate(text):
        glyph = _GLYPHS.get(letter, _GLYPHS.get(letter.upper(), ""))
        for line in glyph.split():
            pairs = zip(line[::2], line[1::2], strict=True)
            found += pairwise((int(x) + ADVANCE * place, int(y)) for x, y in pairs)
    return np.array(found, np.float64).reshape(-1, 2, 2) / 6


def width(text: str) -> float:
    """How long `text` is, in units of its height."""
    return max(ADVANCE * len(text) - (ADVANCE - 4), 0.0) / 6
