"""`markerbridge run`: a live session from one source to any number of sinks."""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import datetime
from importlib.metadata import version
from typing import Any

from rich.console import Console

from bridge import terminal
from bridge.model import DEFAULT, Model
from bridge.opening import Stopped, open_stage
from bridge.session_file import SessionPlan, plan_session, read_session
from bridge.stage import Stage
from bridge.status_server import StatusServer, parse_endpoint
from bridge.watch import watching
from drivers.errors import MarkerbridgeError, UsageError
from drivers.options import checked, positive
from drivers.signals import stopping
from drivers.url import Url


def main(argv: list[str]) -> int:
    """Runs the command; 0 when the session ended as it was asked to."""
    options = _parser().parse_args(argv)
    plan = _plan(options)
    console = Console(stderr=True)
    terminal.log_to(console, plan.log.level)
    # The paths of a session file, whoever reads them, are relative to its folder.
    here = contextlib.chdir(plan.folder) if plan.folder else contextlib.nullcontext()
    with here, stopping() as stop, terminal.log_aside():
        _run(plan, stop, console, as_json=options.json)
    return 0


def _run(plan: SessionPlan, stop: threading.Event, console: Console, *, as_json: bool) -> None:
    title = f"markerbridge run {plan.title}"
    report = Report(plan)
    with _status_server(plan, report, console):
        try:
            with (
                contextlib.suppress(Stopped),
                open_stage(plan, Model(plan.model), stop) as stage,
            ):
                report.stage, report.state = stage, "running"
                gc.freeze()  # what is there stays: it need not be looked through again
                shown = (
                    contextlib.nullcontext()
                    if as_json
                    else terminal.shown(console, stage.status, title, plan.log.lines)
                )
                with shown, watching(stage.by_source, plan.log.every):
                    stage.run(stop, plan.seconds)
                stage.close()
        except MarkerbridgeError:
            if report.stage and report.stage.status().frames:  # it did something before it failed
                _summarise(report, title, console, as_json=as_json)
            raise
        _summarise(report, title, console, as_json=as_json)


def _summarise(report: Report, title: str, console: Console, *, as_json: bool) -> None:
    report.state = "ended"
    if as_json:
        terminal.answer(json.dumps(report()))
    elif report.stage:
        terminal.summarise(console, report.stage.status(), f"{title}: ended")
    else:
        console.print(f"{title}: ended before its source was there", markup=False)


class Report:
    """A session for machines: what it is, and once its source is there, all of its status.

    state: `waiting` for the source, `running`, `ended`.
    """

    def __init__(self, plan: SessionPlan) -> None:
        self.state = "waiting"
        self.stage: Stage | None = None
        self._process = {
            "version": version("markerbridge"),
            "pid": os.getpid(),
            "started": datetime.now().astimezone().isoformat(timespec="seconds"),
        }
        self._plan = plan

    def __call__(self) -> dict[str, Any]:
        stage = self.stage
        return {
            **self._process,
            "state": self.state,
            "source_address": stage.name if stage else self._plan.title,
            "sink_addresses": self._plan.sinks,
            **(asdict(stage.status()) if stage else {}),
        }


def _plan(options: argparse.Namespace) -> SessionPlan:
    """What the command line says, or its session file with what the command line overrides."""
    if (not options.source) == (options.config is None):
        raise UsageError("name a SOURCE, or --config FILE, which names one: not both")
    overriding = {"seconds": options.seconds, "status": options.status, "wait": options.wait}
    overriding = {name: value for name, value in overriding.items() if value}
    if options.config is not None:
        for name in ("model", "to", "truth", "allow"):
            if getattr(options, name) not in (None, []):
                raise UsageError(f"--{name} and --config: write it into {options.config}")
        return read_session(options.config).model_copy(update=overriding)
    sources = [{"url": source} for source in options.source]
    if options.allow is not None:
        for source in sources:
            if Url.parse(source["url"]).scheme != "osc":
                raise UsageError(f"--allow is for osc:// sources, not for '{source['url']}'")
            source["allow"] = options.allow
    written = {"model": options.model or DEFAULT, "sinks": options.to, "truth": options.truth}
    return plan_session({"source": sources, **written, **overriding})


@contextmanager
def _status_server(plan: SessionPlan, report: Report, console: Console) -> Iterator[None]:
    if plan.status is None:
        yield
        return
    with StatusServer(plan.status, report) as server:
        console.print(f"status at {server.url}", markup=False, highlight=False)
        yield


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="markerbridge run",
        description="Reads tracked markers, estimates the whole body, and sends it on, live. "
        "Ctrl-C ends it with a summary.",
    )
    add = parser.add_argument
    add(
        "source",
        metavar="SOURCE",
        nargs="*",
        help="serial:PATH, osc://HOST:PORT, c3d:FILE or log:FILE; of several performers one each, "
        "with the option performer=NAME, or one for all, with performers=NAME,NAME where labels "
        "are NAME:LABEL",
    )
    add(
        "--config",
        metavar="FILE",
        help="a session file (TOML), which says what SOURCE, --model, --to, --truth and --allow "
        "would; --seconds, --status and --wait override it; paths in it are relative to its folder",
    )
    add("--model", help="a model file (default: the one that ships)")
    add(
        "--to",
        action="append",
        default=[],
        metavar="SINK",
        help="vmc://HOST, vrchat://HOST, vmt://HOST, qtm-osc://HOST:PORT, osc://HOST, "
        "mqtt://HOST/TOPIC, c3d:FILE, log:FILE or view: (any number of times)",
    )
    add("--truth", metavar="URL", help="osc://HOST:PORT: where a simulator sends the true poses")
    add(
        "--allow",
        metavar="ADDR,...",
        help="senders that an osc:// source listens to: addresses and networks, as "
        "192.168.1.20,10.0.0.0/8",
    )
    add(
        "--wait",
        action="store_true",
        help="wait for a source that is not there yet, in place of ending with an error",
    )
    add(
        "--seconds",
        type=checked(positive),
        metavar="S",
        help="end after S seconds, counted from when the source is there",
    )
    add(
        "--status",
        type=checked(parse_endpoint),
        metavar="HOST:PORT",
        help="answer there, over HTTP, with the session's status as JSON (HOST: this machine "
        "alone unless named; port 0: one that is free)",
    )
    add("--json", action="store_true", help="no table; the summary as JSON on standard output")
    return parser
