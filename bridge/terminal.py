"""A session on the terminal: a live table, plain lines in a pipe, a summary at the end."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.live import Live
from rich.logging import RichHandler
from rich.table import Table
from rich.text import Text

from bridge.repeating import repeating
from bridge.session import Status
from drivers.errors import MarkerbridgeError

LIVE_EVERY = 0.25  # s
LINE_EVERY = 5.0  # s, where the output is no terminal


@contextmanager
def shown(
    console: Console, status: Callable[[], Status], title: str, line_every: float = LINE_EVERY
) -> Iterator[None]:
    """Shows a running session until the block ends; line_every 0: only where it is a terminal.

    Where nothing can be shown (the terminal is gone, the disk of the log is full) it goes on.
    """
    live = (
        Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
    )

    def show() -> None:
        with contextlib.suppress(OSError):
            if live:
                live.update(table(status(), title), refresh=True)
            else:
                console.print(Text(line(status())), soft_wrap=True)

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


def log_to(console: Console, level: str = "info") -> None:
    """The log goes where the table is, so that it does not tear it; a line each in a pipe."""
    handler: logging.Handler = logging.StreamHandler()
    form = "%(asctime)s markerbridge: %(levelname)s: %(message)s"
    if console.is_terminal:
        handler = RichHandler(console=console, show_time=False, show_path=False, markup=False)
        form = "%(message)s"
    logging.basicConfig(
        level=level.upper(), format=form, datefmt="%H:%M:%S", handlers=[handler], force=True
    )


def summarise(console: Console, status: Status, title: str) -> None:
    """The state of a session once more, at its end, where it can be shown."""
    with contextlib.suppress(OSError):
        if console.is_terminal:
            console.print(table(status, title))
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


def table(status: Status, title: str) -> Table:
    """The state of a session, a row a fact."""
    view = Table(
        title=Text(title, "italic"), title_justify="left", show_header=False, pad_edge=False
    )
    view.add_column(style="cyan", overflow="fold")
    view.add_column(overflow="fold")
    for name, value in _facts(status):
        view.add_row(Text(name), Text(value))
    return view


def line(status: Status) -> str:
    """The state of a session in one line."""
    return time.strftime("%H:%M:%S ") + " | ".join(
        f"{name} {value}" for name, value in _facts(status) if name != "on the wire"
    )


def _facts(status: Status) -> Iterator[tuple[str, str]]:
    source = dict(status.source)
    received = source.pop("frames", 0)
    nominal = f" of {status.layout_rate:g}" if status.layout_rate else ""
    yield "running", f"{status.seconds:.0f} s"
    lost = f", {status.missing_indices} never came" if status.missing_indices else ""
    yield "frames in", f"{received}{lost}{'' if received else _unread(source)}"
    yield "poses out", f"{status.frames}"
    yield "rate", f"{status.rate:.1f}{nominal} Hz"
    ages = f"p50 {_ms(status.age_p50)}, p99 {_ms(status.age_p99)}"
    yield "age of the pose", f"now {_ms(status.age_now)}, {ages}"
    if status.delay_now is not None:
        delays = f"p50 {_ms(status.delay_p50)}, p99 {_ms(status.delay_p99)}"
        yield "delay on the line", f"now {_ms(status.delay_now)}, {delays}"
    share = status.imputed_samples / max(1, status.frames)
    now = f" (now {', '.join(status.imputed_now)})" if status.imputed_now else ""
    yield "markers imputed", f"{status.imputed_samples}, {share:.2f} a frame{now}"
    if status.lost_frames:
        yield "frames without markers", f"{status.lost_frames}"
    if status.rms_mm is not None and status.rms_now_mm is not None:
        yield "RMS to the truth", f"{status.rms_mm:.1f} mm (now {status.rms_now_mm:.0f} mm)"
    elif status.truth is not None and status.frames:
        came = status.truth.get("frames", 0)
        found = f"none of {came} true poses fits a frame" if came else "no true pose has come"
        yield "RMS to the truth", found
    for name, sink in status.sinks.items():
        trouble = "".join(
            f", {sink[key]} {word}"
            for key, word in (
                ("dropped", "dropped"),
                ("rate_limited", "over its rate"),
                ("errors", "failed"),
            )
            if sink[key]
        )
        ages = f", age p50 {_ms(sink['age_p50'])}, p99 {_ms(sink['age_p99'])}"
        yield f"to {name}", f"{sink['sent']} poses{trouble}{ages if sink['sent'] else ''}"
    counts = ", ".join(f"{name} {count}" for name, count in sorted(source.items()) if count)
    yield "on the wire", counts or "nothing yet"


def _unread(source: Mapping[str, int]) -> str:
    """What came, where no frame did."""
    if count := source.get("bytes"):
        return f", though {count:,} bytes came: `markerbridge doctor` tells why"
    if count := source.get("refused"):
        return f", though {count:,} packets came, of senders that the option allow does not name"
    return ""


def _ms(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds * 1000:.2f} ms"
