"""What `markerbridge select-markers` prints."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from training.marker_wishes import Markers
from training.search_study import SearchStudy
from training.selection_study import SelectionStudy
from training.set_comparison import SetScores

_SETS = 10  # most frequent sets


def print_selection(study: SelectionStudy, compared: Sequence[SetScores]) -> None:
    """The shares of the runs, and how the sets do that were compared, the automatic one first."""
    console = Console()
    shares = _table("marker", "runs %")
    for label, share in study.shares.items():
        shares.add_row(label, f"{100 * share:.1f}")
    console.print(shares)
    sets = _table(f"the {_SETS} most frequent sets", "runs %")
    for markers, share in list(study.sets.items())[:_SETS]:
        sets.add_row(", ".join(markers), f"{100 * share:.1f}")
    console.print(sets)
    if compared:
        scores = _table("on what is left out in turn", "RMS mm", "all 41", "jerk mm")
        for number, one in enumerate(compared):
            scores.add_row(
                ", ".join(one.principal) + (" (automatic)" if number == 0 else ""),
                *map(_two_digits, _means(one)),
            )
        console.print(scores)
    _print_chosen(study.chosen.markers)


def print_search(study: SearchStudy) -> None:
    """How much each further marker brings, and how the best sets do beside others."""
    console = Console()
    sizes = _table("least error found with so many markers", "number", "closed form mm")
    for one in study.by_size:
        sizes.add_row(", ".join(one.markers) or "-", f"{len(one.markers)}", f"{one.error_mm:.2f}")
    console.print(sizes)
    sets = _table("on what is left out in turn", "closed form mm", "RMS mm", "all 41", "jerk mm")
    for name, one in study.sets.items():
        tried = study.scores.get(one.markers)
        means = (None,) * 3 if tried is None else _means(tried)
        sets.add_row(
            f"{', '.join(one.markers)} ({name})", *map(_two_digits, (one.error_mm, *means))
        )
    console.print(sets)
    _print_chosen(study.principal)
    if study.wishes.alone:
        console.print(f"body frame: {', '.join(study.wishes.references)}", highlight=False)


def _print_chosen(markers: Markers) -> None:
    Console().print(f"principal markers: {', '.join(markers)}", highlight=False, soft_wrap=True)


def _means(scores: SetScores) -> tuple[float | None, ...]:
    return scores.mean.rms_mm, scores.mean.rms_all_mm, scores.mean.jerk_mm


def _two_digits(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _table(first: str, *others: str) -> Table:
    table = Table(box=SIMPLE, pad_edge=False)
    table.add_column(first, overflow="fold")
    for title in others:
        table.add_column(title, justify="right", no_wrap=True)
    return table
