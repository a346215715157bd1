"""What the view costs the bridge, and how fast it is: `python -m tests.benchmarks.view`.

A simulated tracker at 120 Hz on a serial line, in a process of its own, and the session without a
view, with one on a screen that software draws, and with one that is stopped (SIGSTOP). Printed are
the ages of poses when they are estimated, and the view's pictures a second.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import tempfile
import threading
import time
from contextlib import ExitStack
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from unittest.mock import patch

from bridge.model import Model, ModelInfo
from bridge.opening import open_stage
from bridge.session import Status
from bridge.session_file import plan_session
from bridge.view import live
from bridge.view.window import Window
from tests.bridge.display import screen
from tests.end_to_end.peers import free_port, running, wait_for

COUNT = "MARKERBRIDGE_BENCHMARK"  # where the view's process writes what it has drawn


def counting_show(connection: Connection, info: ModelInfo) -> None:
    """The view's process, which counts its pictures from the second second on."""
    drawn: list[float] = []
    draw = Window.draw

    def counted(window: Window) -> bool:
        drawn.append(time.monotonic())
        return draw(window)

    with patch.object(Window, "draw", counted):
        try:
            live.show(connection, info)
        finally:
            if len(drawn) > 2:
                steps = sorted(b - a for a, b in pairwise(drawn[60:]))
                rate = (len(drawn) - 61) / (drawn[-1] - drawn[60])
                used = resource.getrusage(resource.RUSAGE_SELF)
                share = (used.ru_utime + used.ru_stime) / (drawn[-1] - drawn[0])
                Path(os.environ[COUNT]).write_text(
                    f"{rate:.1f} pictures a second, p99 {1000 * steps[int(0.99 * len(steps))]:.1f} "
                    f"ms apart, {100 * share:.0f} % of a core"
                )


def session(
    folder: Path, seconds: float, *, view: bool, stopped: bool = False
) -> tuple[Status, str]:
    """One session, and what its view has to say."""
    port, count = folder / "tracker", folder / "count"
    count.write_text("")
    os.environ[COUNT] = str(count)
    truth = f"osc://127.0.0.1:{free_port()}"
    sinks = ["view:"] if view else []
    plan = plan_session({"source": f"serial:{port}", "sinks": sinks, "truth": truth})
    command = ["simulate", "performer:walk", "--loop", "--to", f"serial:{port}", "--truth", truth]
    with ExitStack() as stack:
        stack.enter_context(patch("bridge.sinks.view.show", counting_show))
        stack.enter_context(running(*command, "--noise", "1mm", "--drop", "5%"))
        wait_for(port.exists, "the simulator")
        stop = threading.Event()
        bridge = stack.enter_context(open_stage(plan, Model("default"), stop))
        if stopped:
            sink = bridge.sessions[""].outlets[0].sink
            os.kill(sink._process.pid, signal.SIGSTOP)
        bridge.run(stop, seconds)
        status = bridge.status()
        began = time.monotonic()
        bridge.close()
        ended = time.monotonic() - began
    return status, f"{count.read_text()} closed in {ended:.1f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    options = parser.parse_args()
    kinds = {
        "no view": {"view": False},
        "view": {"view": True},
        "a view that hangs": {"view": True, "stopped": True},
    }
    with screen() as display, tempfile.TemporaryDirectory() as folder:
        os.environ["DISPLAY"] = display
        for name, kind in kinds.items():
            status, said = session(Path(folder), options.seconds, **kind)
            ages = status.ages["estimate"]
            p50, p99, most = (1000 * (age or 0.0) for age in (ages.p50, ages.p99, ages.max))
            print(
                f"{name:18} {status.frames} frames, overflow {status.source['fifo_overflow']}; age "
                f"p50 {p50:.2f} p99 {p99:.2f} max {most:.1f} ms; {said}",
                flush=True,
            )


if __name__ == "__main__":
    main()
