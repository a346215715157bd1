"""A session on the terminal: a dashboard, plain lines in a pipe, a summary at the end."""

from __future__ import annotations

import contextlib
import logging
import queue
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler, QueueListener
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.logging import RichHandler
from rich.text import Text

from bridge.dashboard import LOSSES, Dashboard, missing_truth
from bridge.repeating import repeating
from bridge.statistics import Ages
from bridge.troubles import LOST, instead, troubles
from drivers.errors import MarkerbridgeError

if TYPE_CHECKING:
    from bridge.session import Status

LIVE_EVERY = 0.25  # s
LATELY = 3.0  # s over which the dashboard's rates are told
WORST = 16  # markers that are named at the end, those missing most
LINE_EVERY = 5.0  # s, where the output is no terminal


@contextmanager
def shown(
    console: Console, status: Callable[[], Status], title: str, line_every: float = LINE_EVERY
) -> Iterator[None]:
    """Shows a running session until the block ends; line_every 0: only where it is a terminal.

    Where nothing can be shown (the terminal is gone, the disk of the log is full) it goes on.
    """
    live = Live(console=console, auto_refresh=False, transient=True) if _is_live(console) else None
    # The newest status, and those before it that rates and troubles are told against.
    known: deque[Status] = deque([status()], maxlen=1 + round(LATELY / LIVE_EVERY) if live else 2)
    size = console.size

    def show() -> None:
        nonlocal size
        known.append(status())
        before = known[0]
        with contextlib.suppress(OSError):
            if live:
                if console.size != size:  # the terminal has broken the lines that stand there anew
                    size = console.size
                    console.clear()
                live.update(Dashboard(title, known[-1], before), refresh=True)
            else:
                console.print(Text(line(known[-1], before)), soft_wrap=True)

    if live:
        with contextlib.suppress(OSError):
            live.start()
    try:
        with repeating(show, LIVE_EVERY if live else line_every, "terminal"):
            yield
    finally:
        if live:
            with contextlib.suppress(OSError):
                live.stop()


def _is_live(console: Console) -> bool:
    """Whether what was printed can be drawn anew: not in a pipe, though it be told to have colours,
    and not on a dumb terminal.
    """
    return console.is_interactive and console.file.isatty()


def log_to(console: Console, level: str = "info") -> None:
    """The log goes where the dashboard is, so that it does not tear it; a line each in a pipe."""
    handler: logging.Handler = logging.StreamHandler()
    form = "%(asctime)s markerbridge: %(levelname)s: %(message)s"
    if _is_live(console):
        handler = RichHandler(
            console=console, show_path=False, markup=False, log_time_format="%H:%M:%S"
        )
        form = "%(message)s"
    logging.basicConfig(
        level=level.upper(), format=form, datefmt="%H:%M:%S", handlers=[handler], force=True
    )


@contextmanager
def log_aside() -> Iterator[None]:
    """Until the block ends, the log is written by a thread of its own: whoever says something while
    frames wait for them does not wait for a terminal that is frozen (Ctrl-S), or for a full pipe.
    """
    root, lines = logging.getLogger(), queue.SimpleQueue[logging.LogRecord]()
    handlers, root.handlers = root.handlers, [QueueHandler(lines)]
    writer = QueueListener(lines, *handlers)
    writer.start()
    try:
        yield
    finally:
        writer.stop()  # once all is written
        root.handlers = handlers


def summarise(console: Console, status: Status, title: str) -> None:
    """The state of a session once more, at its end, where it can be shown."""
    with contextlib.suppress(OSError):
        if _is_live(console):
            console.print(Dashboard(title, status, ended=True))
            return
        console.print(Text(title), soft_wrap=True)
        for name, value in _facts(status):
            console.print(Text(f"  {name}: {value}"), soft_wrap=True)


def answer(text: str) -> None:
    """Writes what a command was asked for to standard output, with a line end.

    Raises MarkerbridgeError where that cannot be.
    """
    try:
        if sys.stdout is None:
            raise OSError("it is closed")
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Python would try once more at its end, and complain.
        sys.stdout = None
        raise MarkerbridgeError(f"cannot write to standard output: {error}") from error


def line(status: Status, before: Status | None = None) -> str:
    """The state of a session in one line; `before`: the one that the line before told."""
    parts = [trouble.words for trouble in troubles(status, before)[:1]]
    parts += [f"{name} {value}" for name, value in _short_facts(status)]
    return time.strftime("%H:%M:%S ") + " | ".join(parts)


def _short_facts(status: Status) -> Iterator[tuple[str, str]]:
    nominal = f" of {status.layout_rate:g}" if status.layout_rate else ""
    yield "poses", f"{status.frames:,} at {status.rate:.1f}{nominal} Hz"
    if status.silent < LOST:
        yield from _short_facts_of_now(status)
    if status.missing_indices:
        yield "frames lost", f"{status.missing_indices:,}"
    if unsent := sum(sink["dropped"] + sink["errors"] for sink in status.sinks.values()):
        yield "poses unsent", f"{unsent:,}"


def _short_facts_of_now(status: Status) -> Iterator[tuple[str, str]]:
    age = status.ages["estimate"]
    yield "age", f"{_ms(age.now)}, p99 {_ms(age.p99)}"
    away = [label for label, marker in status.markers.items() if marker.state != "measured"]
    if status.markers:
        yield "without" if away else "all", ", ".join(away) or f"{len(status.markers)} markers"
    if status.rms_now_mm is not None:
        yield "RMS", f"{status.rms_now_mm:.0f} mm"
    elif status.truth is not None and status.frames:
        yield "no RMS:", missing_truth(status.truth)


def _facts(status: Status) -> Iterator[tuple[str, str]]:
    """All that a session did, for its end."""
    source = dict(status.source)
    received = source.pop("frames", 0)
    yield "running", f"{status.seconds:.0f} s"
    lost = f", {status.missing_indices} never came" if status.missing_indices else ""
    yield "frames in", f"{received}{lost if received else instead(status, None)}"
    yield "poses out", f"{status.frames}"
    for name, words in (
        ("delay", "delay on the line"),
        ("parse", "until it is read"),
        ("queue", "wait in the queue"),
        ("estimate", "age of the pose"),
    ):
        if status.ages[name].count:
            yield words, _ages(status.ages[name])
    share = status.imputed_samples / max(1, status.frames)
    most = sorted(status.markers.items(), key=lambda item: -item[1].missing)[:WORST]
    missing = {label: at.missing / max(1, status.frames) for label, at in most}
    worst = ", ".join(f"{label} {part:.1%}" for label, part in missing.items() if part)
    each = f": {worst} of the time" if worst else ""
    yield "markers imputed", f"{status.imputed_samples}, {share:.2f} a frame{each}"
    if status.lost_frames:
        yield "frames without markers", f"{status.lost_frames}"
    if status.rms_mm is not None:
        yield "RMS to the truth", f"{status.rms_mm:.1f} mm"
    elif status.truth is not None and status.frames:
        yield "RMS to the truth", missing_truth(status.truth)
    for name, sink in status.sinks.items():
        trouble = "".join(f", {sink[key]} {word}" for key, word in LOSSES.items() if sink[key])
        last = f" (the last: {sink['last_error']})" if sink["last_error"] else ""
        ages = f", age {_ages(sink['age'])}" if sink["age"].count else ""
        yield f"to {name}", f"{sink['sent']} poses{trouble}{last}{ages}"
    counts = ", ".join(f"{name} {count}" for name, count in sorted(source.items()) if count)
    yield "on the wire", counts or "nothing"


def _ages(ages: Ages) -> str:
    return f"p50 {_ms(ages.p50)}, p99 {_ms(ages.p99)}, max {_ms(ages.max)}"


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1000:.2f} ms"
