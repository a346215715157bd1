"""A session with all that it needs, opened by address and closed together."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bridge.estimator import PoseEstimator
from bridge.model import Model, ModelInfo
from bridge.session import Session
from bridge.session_file import SessionPlan
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import Sink, SinkContext, SinkError, ViewError
from bridge.truth import Truth
from drivers.frame import Source, SourceError
from drivers.registry import open_source
from drivers.url import UrlError

AGAIN = 1.0  # s between attempts to open a source that is waited for

log = logging.getLogger(__name__)


class Stopped(Exception):
    """A session was told to end while its source was waited for."""


@contextmanager
def open_session(plan: SessionPlan, model: Model, stop: threading.Event) -> Iterator[Session]:
    """A session with source and sinks opened by address; all is closed at the end, come what may.

    The source comes last: a device starts to send when it is opened, and a view takes its time.
    Raises Stopped where `stop` is set while the source is waited for.
    """
    with contextlib.ExitStack() as opened:
        with plan.naming("truth"):
            truth = open_truth(plan.truth, model.info) if plan.truth else None
        if truth:
            opened.enter_context(truth.source)
        context = SinkContext(model.info, truth.at if truth else lambda _index: None)
        open_sinks: list[Sink] = []
        for number, address in enumerate(plan.sinks):
            try:
                with plan.naming("sinks", number):
                    sink = open_sink(address, context)
            except ViewError as error:  # nobody's session ends for want of a window
                log.warning("%s", error)
                continue
            opened.callback(_quietly(sink.close))
            open_sinks.append(sink)
        source = opened.enter_context(_open_source(plan, stop))
        session = Session(source, PoseEstimator(model), open_sinks, context, truth=truth)
        opened.callback(session.close)
        yield session


def _open_source(plan: SessionPlan, stop: threading.Event) -> Source:
    """The plan's source, once it is there. Raises SourceError where it is not to be waited for."""
    said = ""
    while True:
        try:
            with plan.naming("source"):
                source = open_source(plan.source.address)
            if said:
                log.info("the source is there")
            return source
        except SourceError as error:
            if not plan.wait:
                raise
            if str(error) != said:
                said = str(error)
                log.warning("waiting for the source: %s", said)
        if stop.wait(AGAIN):
            raise Stopped


def open_truth(address: str, info: ModelInfo) -> Truth:
    """Listens for true poses at osc://HOST:PORT. Raises UrlError or SourceError."""
    if not address.startswith("osc:"):
        raise UrlError(f"'{address}' is no line of true poses: write osc://HOST:PORT")
    return Truth(open_source(address), info.labels)


def _quietly(close: Callable[[], None]) -> Callable[[], None]:
    """For what is closed a second time only because something else failed before."""

    def call() -> None:
        with contextlib.suppress(OSError, SinkError):
            close()

    return call
