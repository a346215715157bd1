"""`markerbridge run`: a live session from one source to any number of sinks."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from rich.console import Console

from bridge import terminal
from bridge.estimator import PoseEstimator
from bridge.model import DEFAULT, Model, ModelInfo
from bridge.session import Session
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import Sink, SinkContext, SinkError, ViewError
from bridge.truth import Truth
from drivers.errors import MarkerbridgeError, UsageError
from drivers.options import checked, positive
from drivers.registry import open_source
from drivers.signals import stopping

log = logging.getLogger(__name__)


def main(argv: list[str]) -> int:
    """Runs the command; 0 when the session ended as it was asked to."""
    options = _parser().parse_args(argv)
    console = Console(stderr=True)
    terminal.log_to(console)
    model = Model(options.model)
    with (
        stopping() as stop,
        open_session(options.source, model, options.to, options.truth) as session,
    ):
        title = f"markerbridge run {options.source}"
        with (
            contextlib.nullcontext()
            if options.json
            else terminal.shown(console, session.status, title)
        ):
            session.run(stop, options.seconds)
        session.close()
        status = session.status()
    if options.json:
        _print_json(asdict(status))
    else:
        terminal.summarise(console, status, f"{title}: ended")
    return 0


@contextmanager
def open_session(
    source_address: str,
    model: Model,
    sinks: list[str],
    truth_address: str | None = None,
) -> Iterator[Session]:
    """A session with source and sinks opened by address; all is closed at the end, come what may.

    The source comes last: a device starts to send when it is opened, and a view takes its time.
    """
    if len(set(sinks)) < len(sinks):
        raise UsageError("a sink is named twice: --to takes each address once")
    with contextlib.ExitStack() as opened:
        truth = open_truth(truth_address, model.info) if truth_address else None
        if truth:
            opened.enter_context(truth.source)
        context = SinkContext(model.info, truth.at if truth else lambda _index: None)
        open_sinks: list[Sink] = []
        for address in sinks:
            try:
                sink = open_sink(address, context)
            except ViewError as error:  # nobody's session ends for want of a window
                log.warning("%s", error)
                continue
            opened.callback(_quietly(sink.close))
            open_sinks.append(sink)
        source = opened.enter_context(open_source(source_address))
        session = Session(source, PoseEstimator(model), open_sinks, context, truth=truth)
        opened.callback(session.close)
        yield session


def open_truth(address: str, info: ModelInfo) -> Truth:
    """Listens for true poses at osc://HOST:PORT. Raises UrlError or SourceError."""
    if not address.startswith("osc:"):
        raise UsageError(f"--truth '{address}': write osc://HOST:PORT")
    return Truth(open_source(address), info.labels)


def _print_json(value: dict[str, Any]) -> None:
    text = json.dumps(value) + "\n"
    try:
        if sys.stdout is None:
            raise OSError("it is closed")
        sys.stdout.write(text)
        sys.stdout.flush()
    except OSError as error:
        # Python would try once more at its end, and complain.
        sys.stdout = None
        raise MarkerbridgeError(f"cannot write to standard output: {error}") from error


def _quietly(close: Callable[[], None]) -> Callable[[], None]:
    """For what is closed a second time only because something else failed before."""

    def call() -> None:
        with contextlib.suppress(OSError, SinkError):
            close()

    return call


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge run",
        description="Reads tracked markers, estimates the whole body, and sends it on, live. "
        "Ctrl-C ends it with a summary.",
    )
    add = parser.add_argument
    add("source", metavar="SOURCE", help="serial:PATH, osc://HOST:PORT or c3d:FILE")
    add("--model", default=DEFAULT, help="a model file (default: the one that ships)")
    add(
        "--to",
        action="append",
        default=[],
        metavar="SINK",
        help="vmc://HOST:PORT, osc://HOST:PORT, c3d:FILE or view: (any number of times)",
    )
    add("--truth", metavar="URL", help="osc://HOST:PORT: where a simulator sends the true poses")
    add("--seconds", type=checked(positive), metavar="S", help="end after S seconds")
    add("--json", action="store_true", help="no table; the summary as JSON on standard output")
    return parser
