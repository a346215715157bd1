"""Progress of long work on stderr: a bar with the time left, or plain lines in a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

Advance = Callable[[str, float], None]  # what was done, and how many units of work it was


@contextmanager
def progress(console: Console, total: float) -> Iterator[Advance]:
    """Yields a function to call after each piece of work; all pieces together are `total` units."""
    if not console.is_terminal:
        spent = 0.0

        def say(what: str, units: float) -> None:
            nonlocal spent
            spent += units
            console.print(f"{100 * spent / total:3.0f} % {what}", highlight=False, soft_wrap=True)

        yield say
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=total)
        yield lambda what, units: bar.update(task, advance=units, description=what)
