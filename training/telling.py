"""What records and reports tell of a run, without a path of the machine that it ran on."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

_LEFT_OUT = "left out: "


def command_line(command: str, argv: Sequence[str]) -> str:
    """The command as it was given, but with the names alone of files and folders."""
    return shlex.join(["markerbridge", command, *map(_without_folder, argv)])


def left_out(warnings: Sequence[str], folders: Sequence[Path | None]) -> list[tuple[str, str]]:
    """Of each `left out: FOLDER/FILE: WHY` the file, without the folder that it is in, and why."""
    found = []
    for warning in warnings:
        if warning.startswith(_LEFT_OUT):
            for folder in folders:
                warning = warning.replace(f"{folder}/", "")
            what, _, why = warning.removeprefix(_LEFT_OUT).partition(": ")
            found.append((what, why))
    return found


def _without_folder(word: str) -> str:
    option, equals, value = word.partition("=")
    if equals and option.startswith("--"):
        return f"{option}={_without_folder(value)}"
    return Path(word).resolve().name if "/" in word else word
