"""Sessions with all that they need, opened by address and closed together."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from bridge.cast import Cast
from bridge.estimator import PoseEstimator
from bridge.model import Model, ModelInfo
from bridge.session import Session
from bridge.session_file import Role, SessionPlan
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import Sink, SinkContext, SinkError, ViewError
from bridge.stage import Stage
from bridge.truth import Truth
from drivers.frame import Source, SourceError
from drivers.registry import open_source
from drivers.url import Url, UrlError

AGAIN = 1.0  # s between attempts to open a source that is waited for

log = logging.getLogger(__name__)


class Stopped(Exception):
    """A session was told to end while its source was waited for."""


@contextmanager
def open_stage(plan: SessionPlan, model: Model, stop: threading.Event) -> Iterator[Stage]:
    """A stage with sources and sinks opened by address; all is closed at the end, come what may.

    Sources come last: a device starts to send when it is opened, and a view takes its time.
    Raises UsageError for performers that cannot be meant, Stopped where `stop` is set while a
    source is waited for.
    """
    roles = plan.roles
    with contextlib.ExitStack() as opened:
        with plan.naming("truth"):
            truth = open_truth(plan.truth, model.info) if plan.truth else None
        if truth:
            opened.enter_context(truth.source)
        known = truth.at if truth else lambda _index: None
        contexts = {
            name: SinkContext(model.info, known, performer=name)
            for role in roles
            for name in role.performers
        }
        sinks: dict[str, list[Sink]] = {name: [] for name in contexts}
        for number, address in enumerate(plan.sinks):
            with plan.naming("sinks", number):
                for name, sink in _open_sinks(address, contexts):
                    opened.callback(_quietly(sink.close))
                    _check(sink, name, address, sinks)
                    sinks[name].append(sink)
        if any(sink.wants_posture for own in sinks.values() for sink in own):
            import bridge.humanoid.solver  # noqa: F401  # compiled, before a device sends
        casts = []
        sources = _open_sources(roles, plan, stop)
        for source in sources:
            opened.enter_context(source)
        for role, source in zip(roles, sources, strict=True):
            sessions = {
                name: Session(
                    *(source, PoseEstimator(model), sinks[name], contexts[name]),
                    truth=truth,
                    shared=not role.alone,
                )
                for name in role.performers
            }
            casts.append(Cast(source, sessions, alone=role.alone))
        stage = Stage(casts)
        opened.callback(stage.close)
        yield stage


def _open_sinks(address: str, contexts: dict[str, SinkContext]) -> Iterator[tuple[str, Sink]]:
    """The sinks that an address means, one for each performer. Raises as `open_sink`."""
    url = Url.parse(address)
    names = list(contexts)
    if "performer" in url.options:
        names = [url.take("performer", "", _among(names))]
        address = Url.parse(address).without("performer").text
    for name in names:
        try:
            sink = open_sink(address, contexts[name])
        except ViewError as error:  # nobody's session ends for want of a window
            log.warning("%s", error)
            continue
        if sink.one_body and len(names) > 1:
            sink.close()
            raise UrlError(
                f"'{address}' is for one performer: write performer=NAME as one of its options "
                f"(known: {', '.join(names)}), and an address for each"
            )
        yield name, sink


def _check(sink: Sink, name: str, address: str, sinks: dict[str, list[Sink]]) -> None:
    """Raises UrlError for a sink that a performer has already, and for a second body where one is
    known alone.
    """
    if any(other.name == sink.name for other in sinks[name]):
        raise UrlError(f"'{address}': {name} goes there already: each address is taken once")
    if not (sink.one_body and sink.receiver):
        return
    for performer, others in sinks.items():
        there = any(other.one_body and other.receiver == sink.receiver for other in others)
        if there and performer != name:
            raise UrlError(f"'{address}': {performer} goes there already: give each a port")


def _among(names: Sequence[str]) -> Callable[[str], str]:
    def check(name: str) -> str:
        if name not in names or not name:
            raise ValueError(f"known are {', '.join(filter(None, names)) or 'none'}")
        return name

    return check


def _open_sources(roles: Sequence[Role], plan: SessionPlan, stop: threading.Event) -> list[Source]:
    """All sources, once all are there. Raises SourceError where one is not to be waited for.

    What is there already is closed meanwhile: nobody would read it, and what it had sent by then
    would be taken for what it sends now.
    """
    said = ""
    while True:
        sources: list[Source] = []
        try:
            for role in roles:
                with plan.naming(*role.keys):
                    sources.append(open_source(role.address))
        except BaseException as error:
            for source in sources:
                source.close()
            if not (plan.wait and isinstance(error, SourceError)):
                raise
            if str(error) != said:
                said = str(error)
                log.warning("waiting for the source: %s", said)
        else:
            if said:
                log.info("the source is there")
            return sources
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
