"""The figures of an evaluation as tables in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from training.hiding import AFTER
from training.missing_study import EXPERIMENTS, TITLES, methods_of

_COLUMNS = (
    ("rms_mm", "RMS mm", ".1f"),
    ("rms_all_mm", "all 41", ".1f"),
    ("jerk_mm", "jerk mm", ".2f"),
    ("roughness", "rough", ".2f"),
    ("nn_rms_mm", "NN RMS", ".1f"),
    ("nn_jerk_mm", "NN jerk", ".2f"),
    ("rms_ratio", "RMS/NN", ".3f"),
    ("jerk_ratio", "jerk/NN", ".3f"),
)
_WIDTH = 140  # of the table in a pipe, where no terminal sets it


def print_evaluation(found: dict[str, Any]) -> None:
    """Prints what `training.evaluation.report` gives, and what the command adds to it."""
    table = Table(box=SIMPLE, pad_edge=False)
    table.add_column("sequence", overflow="fold")
    for title in ("frames", *(title for _, title, _ in _COLUMNS)):
        table.add_column(title, justify="right", no_wrap=True)
    for row in found["sequences"]:
        table.add_row(row["file"], str(row["frames"]), *_cells(row))
    table.add_section()
    total = sum(row["frames"] for row in found["sequences"])
    table.add_row("mean", str(total), *_cells(found["mean"]), style="bold")
    console = Console()
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(table)
    within = [found["sigma"][f"within_{n}"]["mean"] for n in (1, 2)]
    if None not in within:
        one, two = (f"{100 * share:.0f} %" for share in within)
        console.print(
            f"coordinate errors within one sigma: {one}, within two: {two}", highlight=False
        )
    hidden = found.get("hidden")
    if hidden:
        _print_hidden(console, hidden)
    if "missing_study" in found:
        _print_missing(console, found["missing_study"])
    latency = found["latency_us"]
    if latency["p50"] is not None:
        console.print(
            f"one frame takes {latency['p50']:.0f} µs (p50), {latency['p99']:.0f} µs (p99)",
            highlight=False,
        )


def _print_hidden(console: Console, hidden: dict[str, Any]) -> None:
    if hidden["too_short"]:
        console.print(f"too short to hide a marker in: {', '.join(hidden['too_short'])}")
    if not hidden["windows"]:
        return
    rows = hidden["markers"]
    if len(rows) > 1:
        rows = [*rows, hidden["mean"]]
    table = Table(box=SIMPLE, pad_edge=False, title=f"Hidden for {hidden['seconds']:g} s")
    table.caption = (
        f"After so long its error and (RMS of the unworn markers), mm; coordinate errors within "
        f"one and two sigma, %. Back: largest velocity error of any marker in the {AFTER:g} s from "
        "its return on, mm per 1/120 s: mean, 99th percentile and maximum over "
        f"{hidden['windows']} times; blend: the maximum against velocities with nothing hidden."
    )
    table.add_column("marker")
    ages = [f"{at['age_s']:g} s" for at in rows[0]["ages"]]
    sigmas, ends = ("1 σ", "2 σ"), ("mean", "p99", "max")
    for title in (*ages, *sigmas, *(f"back {end}" for end in ends), "blend"):
        table.add_column(title, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            row["marker"],
            *(
                f"{_cell(at['error_mm'], '.0f')} ({_cell(at['unworn_rms_mm'], '.1f')})"
                for at in row["ages"]
            ),
            *(_cell(row[f"within_{n}"], ".0%") for n in (1, 2)),
            *(_cell(row["returning"][f"{end}_mm"], ".1f") for end in ends),
            _cell(row["blending"]["max_mm"], ".1f"),
        )
    nothing = [_cell(hidden["unhidden"][f"{end}_mm"], ".1f") for end in ends]
    table.add_row("nothing", *[""] * (len(ages) + len(sigmas)), *nothing)
    console.print(table, highlight=False)


def _print_missing(console: Console, scores: Sequence[dict[str, Any]]) -> None:
    table = Table(box=SIMPLE, pad_edge=False, title="RMS mm (jerk mm) with tracked markers missing")
    table.add_column("what is missing")
    for title in ("", *methods_of(one["method"] for one in scores)):
        table.add_column(title, justify="right", no_wrap=True)
    for experiment, values in EXPERIMENTS.items():
        for value in values:
            cells = [
                f"{_cell(one['rms_mm'], '.1f')} ({_cell(one['jerk_mm'], '.2f')})"
                for one in scores
                if (one["experiment"], one["value"]) == (experiment, value)
            ]
            if not cells:
                continue  # more markers than are tracked
            table.add_row(TITLES[experiment] if value == values[0] else "", f"{value}", *cells)
        table.add_section()
    console.print(table)


def _cells(row: dict[str, float | None]) -> Sequence[str]:
    return [_cell(row[name], form) for name, _, form in _COLUMNS]


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
