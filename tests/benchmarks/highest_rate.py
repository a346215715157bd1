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
TRIES = 2  # of a rate: a machine has other work, too
PACE = 0.99  # of a rate, that the tracker keeps
LATE = 0.1  # s: a bridge that is as late as this at the end does not keep up


def rows(plan: Plan) -> Iterator[Row]:
    labels = Model(DEFAULT).info.tracked
    seconds = plan.either(5.0, 3.0)
    for name in plan.either(["VMC", "osc://"], ["VMC"]):
        highest, told = 0.0, "more was not tried"
        for rate in plan.either(RATES, RATES[1:6:2]):
            made = walking(labels, rate, seconds)
            for _ in range(TRIES):
                passage = measure(bridge(SINKS[name]), made)
                wrong = what_is_wrong(passage, rate)
                if not wrong:
                    break
            if wrong:
                bare = measure([*NOTHING, str(passage.datagram), str(made.frame)], made)
                told = f"at {rate:,.0f}/s {wrong}"
                if bare_wrong := what_is_wrong(
                    bare, rate
                ):  # then it may be the line, or the sender
                    told += f"; and with nothing between {bare_wrong}"
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


def what_is_wrong(passage: Passage, rate: float) -> str:
    """What was lost, or came too late; nothing where all is well. rate: Hz, as it should be."""
    report = passage.report
    source = report.get("source", {})
    counted = {name: source.get(name, 0) for name in ("missing", "fifo_overflow")}
    sinks = report.get("sinks", {}).values()
    unsent = ("dropped", "rate_limited", "errors")
    counted["poses dropped"] = sum(sink[name] for sink in sinks for name in unsent)
    counted["that the line had no room for"] = passage.refused
    counted["never answered"] = passage.lost
    wrong = [f"{count} {name}" for name, count in counted.items() if count]
    if passage.rate < PACE * rate:
        wrong.append(f"{passage.rate:,.0f}/s was all that the tracker sent")
    last = passage.ages[-len(passage.ages) // 10 :]
    if len(last) and np.median(last) > LATE:
        wrong.append(f"{np.median(last) * 1000:.0f} ms late in the end")
    return ", ".join(wrong)
