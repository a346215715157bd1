"""What a session at 120 Hz takes of the machine, and how soon it begins."""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bridge.model import DEFAULT, Model
from tests.benchmarks.datagrams import has_pose
from tests.benchmarks.latency import SINKS
from tests.benchmarks.plan import Plan
from tests.benchmarks.rig import LONGEST, Rig, Stream, bridge, measure, started, walking
from tests.benchmarks.table import Goal, Row

RATE = 120.0
MEMORY = Goal(150.0, 250.0)  # MB
START = Goal(1.5, 3.0)  # s
STARTS = 5


def rows(plan: Plan) -> Iterator[Row]:
    labels = Model(DEFAULT).info.tracked
    with tempfile.TemporaryDirectory() as folder:
        log = f"log:{folder}/session.mcap"
        sessions = {
            "VMC": [SINKS["VMC"]],
            "osc://": [SINKS["osc://"]],
            "VMC and a recording": [SINKS["VMC"], log],
        }
        made = walking(labels, RATE, plan.either(10.0, 4.0))
        for name, sinks in sessions.items():
            passage = measure(bridge(*sinks), made)
            what = f"session to {name}"
            yield Row(f"{what}, memory", passage.memory, "MB", goal=MEMORY)
            yield Row(f"{what}, memory at most", passage.peak, "MB")
            yield Row(f"{what}, CPU of one core", 100 * passage.cpu, "%")
        made = walking(labels, RATE, LONGEST)
        first_pose(made)  # disk and compiled functions are warm after that
        took = [first_pose(made) for _ in range(plan.either(STARTS, 2))]
        yield Row(
            "start of `run` to the first pose", statistics.median(took), "s", goal=START, note="p50"
        )
        if plan.quick:
            return
        cold = first_pose(made, NUMBA_CACHE_DIR=str(Path(folder, "numba")))
        warm = statistics.median(took)
        yield Row("start with nothing compiled yet", cold, "s", cold / warm, "the warm one")


def first_pose(stream: Stream, **environment: str) -> float:
    """Seconds from the start of the process to its first pose; the tracker sends all the time."""
    with Rig() as rig:
        began = time.time()
        with started(rig.command(bridge(SINKS["VMC"])), **environment) as process:
            rig.play(stream, lambda: any(has_pose(head) for _, head in rig.engine.came[-3:]))
            poses = [at for at, head in rig.engine.came if has_pose(head)]
            if not poses:
                process.kill()
                raise RuntimeError(f"no pose in {LONGEST:.0f} s: {process.communicate()[1]}")
    return poses[0] - began
