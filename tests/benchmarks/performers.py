"""How many performers at 120 Hz one core takes: every frame of each estimated, every pose received,
and 99 of 100 of them before the next is due.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bridge.model import DEFAULT, Model
from simulators.corruption import Faults, Gaps
from tests.benchmarks.crowd import measure, stream_of
from tests.benchmarks.highest_rate import TRIES, what_is_wrong
from tests.benchmarks.plan import Plan
from tests.benchmarks.rig import Passage
from tests.benchmarks.table import Goal, Row

RATE = 120.0  # Hz
COUNTS = (1, 8, 16, 24, 32, 40, 48, 64)
SEPARATE = 16  # performers, when each has a tracker
GOAL = Goal(32.0, 16.0, higher=True)

SINKS = {
    "osc://": "osc://127.0.0.1:{port}?performer={name}",
    "VMC, bones": "vmc://127.0.0.1:{port}?performer={name}&send=bones",
}
GAPS, WHOLE = "2 % of samples missing", "none missing"
CONDITIONS = {GAPS: Faults(gaps=Gaps(0.02, 10, 100)), WHOLE: Faults()}


def rows(plan: Plan) -> Iterator[Row]:
    some = plan.either(COUNTS, COUNTS[2:5:2])
    yield from _until_too_many(plan, "osc://", GAPS, some)
    if not plan.quick:
        yield from _until_too_many(plan, "osc://", WHOLE, COUNTS[4:])
        yield from _until_too_many(plan, "VMC, bones", GAPS, COUNTS[2:])
    passage, wrong = passed(plan, "osc://", GAPS, SEPARATE, trackers=SEPARATE)
    yield _age(f"{SEPARATE} performers with a tracker each to osc://", passage, wrong)


def _until_too_many(plan: Plan, sink: str, condition: str, counts: Sequence[int]) -> Iterator[Row]:
    most, told = 0, "more were not tried"
    for count in counts:
        passage, wrong = passed(plan, sink, condition, count)
        yield _age(f"{count} performers to {sink}, {condition}", passage, wrong)
        if wrong:
            told = f"with {count} {wrong}"
            break
        most = count
    what = f"performers at 120 Hz on one core, to {sink}, {condition}"
    yield Row(what, most, "", goal=GOAL if condition == GAPS else None, note=told)


def _age(what: str, passage: Passage, wrong: str) -> Row:
    note = f"p50 {passage.age(50):.2f} ms, CPU {100 * passage.cpu:.0f} %, {passage.memory:.0f} MB"
    if wrong:
        note += f"; {wrong}"
    return Row(f"{what}, age of a pose, p99", passage.age(99), "ms", note=note)


def passed(
    plan: Plan, sink: str, condition: str, count: int, *, trackers: int = 1
) -> tuple[Passage, str]:
    """What went through, and what was wrong with it; of some tries the first that went well."""
    labels = Model(DEFAULT).info.tracked
    names = [f"p{number:02}" for number in range(count)]
    companies = [names[number::trackers] for number in range(trackers)]
    seconds, faults = plan.either(6.0, 3.0), CONDITIONS[condition]
    streams = [stream_of(company, labels, RATE, seconds, faults) for company in companies]
    for _ in range(TRIES):
        passage, fewest = measure(companies, streams, SINKS[sink])
        wrong = _what_is_wrong(passage, len(streams[0].packets) - fewest)
        if not wrong:
            break
    return passage, wrong


def _what_is_wrong(passage: Passage, passed_over: int) -> str:
    wrong = [f"{passed_over} frames of a performer not estimated"] if passed_over else []
    if lost := what_is_wrong(passage, RATE):
        wrong.append(lost)
    if passage.age(99) > 1000 / RATE:
        wrong.append("99 of 100 are not there before the next is due")
    return ", ".join(wrong)
