"""From bytes on a serial line to bytes on UDP, in turns with a bridge that does nothing between."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bridge.model import DEFAULT, Model
from tests.benchmarks.plan import Plan
from tests.benchmarks.rig import NOTHING, Passage, bridge, measure, walking
from tests.benchmarks.table import Goal, Row

RATES = (120.0, 240.0, 480.0, 1000.0)
TURNS = 2  # with VMC, ours and the other: what disturbs the machine meets both
PERCENTILES = (50.0, 99.0, 99.9)
# Of VMC at 120 Hz, ms beyond the bridge that does nothing.
GOALS = {50.0: Goal(0.3, 0.6), 99.0: Goal(0.6, 1.5)}

EVERYTHING = "vmc://127.0.0.1:{port}?rate=100000"
SINKS = {
    "VMC": EVERYTHING,
    "VMC, markers alone": EVERYTHING + "&send=trackers",
    "osc://": "osc://127.0.0.1:{port}",
}


def rows(plan: Plan) -> Iterator[Row]:
    labels = Model(DEFAULT).info.tracked
    for name in plan.either([*SINKS], ["VMC"]):
        sink, all_rates = SINKS[name], name == "VMC" and not plan.quick
        for rate in RATES if all_rates else RATES[:: len(RATES) - 1]:
            ours, nothing = [], []
            for _ in range(plan.either(TURNS, 1) if name == "VMC" else 1):
                made = walking(labels, rate, plan.either(8.0, 4.0))
                ours.append(measure(bridge(sink), made))
                size, frame = ours[-1].datagram, made.frame
                nothing.append(measure([*NOTHING, str(size), str(frame)], made))
            lost = sum(one.lost for one in ours)
            sent = sum(one.sent for one in ours)
            for percent in PERCENTILES:
                age, bare = _age(ours, percent), _age(nothing, percent)
                note = f"{age:.3f} less {bare:.3f}"
                if lost and percent == PERCENTILES[0]:
                    note += f"; {lost} of {sent} lost"
                yield Row(
                    f"pty to {name}, {rate:.0f} Hz, p{percent:g} beyond nothing",
                    age - bare,
                    "ms",
                    age / bare,
                    "nothing",
                    GOALS.get(percent) if (name, rate) == ("VMC", 120.0) else None,
                    note,
                )
            yield Row(
                f"pty to {name}, {rate:.0f} Hz, CPU of one core",
                100 * float(np.mean([one.cpu for one in ours])),
                "%",
                note=f"nothing: {100 * np.mean([one.cpu for one in nothing]):.1f} %",
            )


def _age(passages: list[Passage], percent: float) -> float:
    """A percentile, ms, of all ages together."""
    ages = np.concatenate([one.ages for one in passages])
    return float(np.percentile(ages, percent)) * 1000 if len(ages) else float("nan")
