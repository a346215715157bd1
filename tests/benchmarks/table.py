"""The table of the benchmarks: what was measured, against what, and what was wanted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

HEAD = "| what | measured | ratio | target | floor | met |\n| --- | --- | --- | --- | --- | --- |"


@dataclass(frozen=True, slots=True)
class Goal:
    """What is wanted of a row's measure, or of its ratio, and the least that will do."""

    target: float
    floor: float
    of_ratio: bool = False
    higher: bool = False  # the more the better


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table. measured: in `unit`. ratio: to, or against, what `against` says. note:
    what a reader has to know besides.
    """

    what: str
    measured: float
    unit: str
    ratio: float | None = None
    against: str = ""
    goal: Goal | None = None
    note: str = ""

    @property
    def met(self) -> str:
        """`target`, `floor` or `missed`; nothing where nothing is wanted."""
        goal = self.goal
        if goal is None:
            return ""
        reached = self.ratio if goal.of_ratio else self.measured
        if reached is None:
            return "missed"
        for name, wanted in (("target", goal.target), ("floor", goal.floor)):
            if reached >= wanted if goal.higher else reached <= wanted:
                return name
        return "missed"

    def __str__(self) -> str:
        ratio = "" if self.ratio is None else f"{number(self.ratio)} × {self.against}"
        what = f"{self.what} ({self.note})" if self.note else self.what
        goal = self.goal
        unit = "×" if goal and goal.of_ratio else self.unit
        wanted = (
            [f"{number(one)} {unit}" for one in (goal.target, goal.floor)] if goal else ["", ""]
        )
        measured = f"{number(self.measured)} {self.unit}"
        return f"| {' | '.join([what, measured, ratio, *wanted, self.met])} |"


def number(value: float) -> str:
    """Three digits that count; whole from 1,000 on."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def as_json(parts: Mapping[str, Sequence[Row]]) -> dict[str, list[dict[str, Any]]]:
    """The rows of each part for machines; what was not measured, a NaN, is null."""
    return {
        part: [
            {name: None if value != value else value for name, value in asdict(row).items()}
            | {"met": row.met}
            for row in rows
        ]
        for part, rows in parts.items()
    }
