"""`markerbridge demo`: the whole chain on one machine, with nothing to plug in."""

from __future__ import annotations

import argparse
import contextlib
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from bridge import terminal
from bridge.model import DEFAULT, Model
from bridge.opening import open_stage
from bridge.session import Session
from bridge.session_file import plan_session
from bridge.sinks.sink import SinkError
from bridge.view.process import has_display
from bridge.view.snapshot import check_picture, snapshot
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import MarkerbridgeError
from drivers.options import checked, positive
from drivers.osc_udp import UdpTransport
from drivers.signals import stopping

START = 20.0  # s that the simulator gets to come up on a slow machine
TITLE = "markerbridge demo"
VMC = "vmc://127.0.0.1:39539"


class DemoError(MarkerbridgeError):
    """The demo's own simulator did not work."""


def main(argv: list[str]) -> int:
    """Runs the command; 0 when frames came through."""
    options = _parser().parse_args(argv)
    console = Console(stderr=True)
    terminal.log_to(console)
    # The demo's own truth channel needs no large buffer; a warning would only puzzle.
    logging.getLogger("drivers.osc_udp").setLevel(logging.ERROR)
    model = Model(options.model)
    sinks = [*(options.to or [VMC]), *_view(options.view, console)]
    truth = f"osc://127.0.0.1:{_free_port()}"
    if options.snapshot:
        check_picture(options.snapshot, (".png",))
    with tempfile.TemporaryDirectory(prefix="markerbridge-") as folder:
        port = Path(folder) / "tracker"
        plan = plan_session({"source": f"serial:{port}", "sinks": sinks, "truth": truth})
        with (
            stopping() as stop,
            _simulator(options, port, truth) as simulator,
            open_stage(plan, model, stop) as stage,
        ):
            _introduce(console, options, sinks)
            with terminal.shown(console, stage.status, TITLE):
                stage.run(stop, options.seconds)
            died = simulator.poll() is not None
            stage.close()
            status = stage.status()
    terminal.summarise(console, status, f"{TITLE}: ended")
    if died:
        raise DemoError("the simulator ended before the demo did")
    if not (status.frames or stop.is_set()):
        raise DemoError("no frame came through the simulated serial port")
    if options.snapshot:
        _take_snapshot(options.snapshot, model, stage.sessions[""], console)
    return 0


@contextmanager
def _simulator(
    options: argparse.Namespace, port: Path, truth: str
) -> Iterator[subprocess.Popen[bytes]]:
    """`markerbridge simulate` as a process of its own, from its port's appearance on."""
    command = [sys.executable, "-P", "-m", "bridge.cli", "simulate", options.source, "--loop"]
    command += ["--to", f"serial:{port}", "--truth", truth, "--model", options.model]
    command += ["--noise", "1mm", "--drop", "5%"]
    # Should the demo be killed while it plays, its simulator ends by itself.
    command += ["--seconds", str(options.seconds + 60)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,  # Ctrl-C is for the demo, which then ends it
        )
        try:
            deadline = time.monotonic() + START
            while not port.exists():
                if process.poll() is not None or time.monotonic() > deadline:
                    errors.seek(0)
                    lines = errors.read().decode(errors="replace").strip().splitlines()
                    raise DemoError(lines[-1] if lines else "the simulator did not start")
                time.sleep(0.02)
            yield process
        finally:
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _introduce(console: Console, options: argparse.Namespace, sinks: list[str]) -> None:
    to = " and ".join(sinks) or "nowhere"
    console.print(
        f"{TITLE}: {options.source} as a simulated tracker on a serial line "
        f"(1 mm noise, 5 % of samples dropped), the whole body to {to}, "
        f"for {options.seconds:g} s. Ctrl-C ends it.",
        markup=False,
        highlight=False,
        soft_wrap=not console.is_terminal,
    )


def _view(wish: bool | None, console: Console) -> list[str]:
    """The view's address where it is wished for, or not refused and possible."""
    if wish or (wish is None and has_display()):
        return ["view:"]
    if wish is None:
        console.print(
            "no display here, so no view (--snapshot F.png writes a picture)", style="dim"
        )
    return []


def _free_port() -> int:
    with contextlib.closing(UdpTransport("127.0.0.1", 0, SYSTEM_CLOCK)) as transport:
        return transport.port


def _take_snapshot(path: Path, model: Model, session: Session, console: Console) -> None:
    if session.last_pose is None:
        raise SinkError(f"no pose to draw for {path}")
    snapshot(path, model.info, session.last_pose, session.last_truth)
    console.print(f"picture of the view: {path}", markup=False, highlight=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=TITLE,
        description="Starts a simulated tracker, estimates the whole body from its few markers, "
        "streams it to a VR engine's port, and shows the view where there is a display.",
    )
    add = parser.add_argument
    add("--seconds", type=checked(positive), default=20.0, metavar="S", help="default: 20")
    add("--source", default="performer:walk", metavar="SOURCE", help="c3d:FILE for a real capture")
    add("--model", default=DEFAULT, help="a model file (default: the one that ships)")
    add("--to", action="append", metavar="SINK", help=f"where poses go (default: {VMC})")
    add(
        "--view",
        action=argparse.BooleanOptionalAction,
        help="open the view or not (default: where there is a display)",
    )
    add("--snapshot", type=Path, metavar="F.png", help="write a picture of the view at the end")
    return parser
