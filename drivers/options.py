"""Values on the command line, read with an error in the user's words."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def checked(read: Callable[[str], T]) -> Callable[[str], T]:
    """`read` as an argparse type: a ValueError's own text is what the user sees."""

    def check(text: str) -> T:
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return check


def parse_seconds(text: str) -> float:
    """`10s` as 10.0. Raises ValueError."""
    number = text.strip().removesuffix("s")
    if number == text.strip():
        raise ValueError(f"'{text}' is no time: write for example 10s")
    return positive(number)


def seed(text: str) -> int:
    """A whole number from 0 that every generator of random numbers takes. Raises ValueError."""
    if not (text.isdecimal() and int(text) < 2**32):
        raise ValueError(f"'{text}' is no whole number from 0 to {2**32 - 1}")
    return int(text)


def positive(text: str) -> float:
    """A number above 0. Raises ValueError."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise ValueError(f"'{text}' is no number above 0")
    return value
