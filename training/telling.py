"""What a command tells of its run: on stderr as it goes, and later in records and reports, which
name no path of the machine that it ran on.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

LEFT_OUT = "left out: "  # how a warning begins that goes on with the file and why


class Notices:
    """Prints warnings to stderr, and keeps them."""

    def __init__(self) -> None:
        self.console = Console(stderr=True)
        self._warnings: list[str] = []

    def warn(self, text: str) -> None:
        self._warnings.append(text)
        self.say(text, style="yellow")

    def say(self, text: str, style: str | None = None) -> None:
        self.console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    @property
    def left_out(self) -> list[tuple[str, str]]:
        """Of each `left out: FILE: WHY` the two."""
        found = [text.removeprefix(LEFT_OUT) for text in self._warnings if LEFT_OUT in text]
        return [(what, why) for what, _, why in (text.partition(": ") for text in found)]


def command_line(command: str, argv: Sequence[str], options: argparse.Namespace) -> str:
    """The command as it was given, but with the names alone of the files and folders in it."""
    paths = {value for value in vars(options).values() if isinstance(value, Path)}

    def told(word: str) -> str:
        option, equals, value = word.partition("=")
        if equals and option.startswith("--"):
            return f"{option}={told(value)}"
        return Path(word).resolve().name if Path(word) in paths else word

    return shlex.join(["markerbridge", command, *map(told, argv)])
