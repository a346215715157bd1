"""The highest rate without loss: every frame estimated, every pose sent, and none of it late."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bridge.model import DEFAULT, Model
from tests.benchmarks.latency import SINKS
from tests.benchmarks.plan import Plan
from tests.benchmarks.rig import NOTHING, Passage, bridge, measure, walking
from tests.benchmarks.speed import PAPER
from tests.benchmarks.table import Goal, Row

RATES = (500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 8000.0, 10_000.0)
LATE = 0.1  # s: a bridge that is as late as this at the end does not keep up


def rows(plan: Plan) -> Iterator[Row]:
    labels = Model(DEFAULT).info.tracked
    seconds = plan.either(5.0, 3.0)
    for name in ("VMC", "osc://"):
        highest, told = 0.0, "more was not tried"
        for rate in RATES:
            made = walking(labels, rate, seconds)
            passage = measure(bridge(SINKS[name]), made)
            wrong = what_is_wrong(passage)
            if wrong:
                bare = measure([*NOTHING, str(passage.datagram), str(made.frame)], made)
                told = f"at {rate:,.0f}/s {wrong}"
                if what_is_wrong(bare):  # then it may be the line, or the sender
                    told += f"; and with nothing between {what_is_wrong(bare)}"
                break
            highest = rate
        yield Row(
            f"highest rate without loss, pty to {name}",
            highest,
            "/s",
            highest / PAPER,
            "the paper's 600",
            Goal(5000.0, 2000.0, higher=True) if name == "VMC" else None,
            told,
        )


def what_is_wrong(passage: Passage) -> str:
    """What was lost, or came too late; nothing where all is well."""
    report = passage.report
    source = report.get("source", {})
    counted = {name: source.get(name, 0) for name in ("missing", "fifo_overflow")}
    sinks = report.get("sinks", {}).values()
    unsent = ("dropped", "rate_limited", "errors")
    counted["poses dropped"] = sum(sink[name] for sink in sinks for name in unsent)
    counted["that the line had no room for"] = passage.refused
    counted["never answered"] = passage.lost
    wrong = [f"{count} {name}" for name, count in counted.items() if count]
    last = passage.ages[-len(passage.ages) // 10 :]
    if len(last) and np.median(last) > LATE:
        wrong.append(f"{np.median(last) * 1000:.0f} ms late in the end")
    return ", ".join(wrong)
