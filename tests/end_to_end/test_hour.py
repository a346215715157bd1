"""The hour of tests/benchmarks/hour.py, a minute and a quarter of it."""

from __future__ import annotations

import pytest

from simulators.faults.plan import KINDS
from tests.benchmarks.hour import PLAN, Outcome, play, table


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return play(1.25)


def test_every_packet_is_accounted_for(outcome: Outcome) -> None:
    print(table(outcome))
    assert outcome.wrong == []
    assert outcome.sent == 9_000
    assert 0.9 * outcome.sent < outcome.delivered < outcome.sent


def test_every_kind_of_fault_was_at_work_and_felt(outcome: Outcome) -> None:
    assert len(KINDS) == 15
    did = {name for name, count in outcome.device.items() if count}
    kinds = {line.split('"')[1] for line in PLAN.splitlines() if line.startswith("kind")}
    assert len(kinds) == len(KINDS)
    assert kinds <= did
    felt = ("missing", "duplicates", "reordered", "bad_crc", "bad_cobs", "clock_jumps", "silences")
    assert all(outcome.host[name] for name in (*felt, "disconnects", "reconnects"))


def test_memory_is_flat_and_the_log_no_flood(outcome: Outcome) -> None:
    assert outcome.grown < 4
    assert len(outcome.records) <= outcome.host["disconnects"] + 2


def test_what_does_not_add_up_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that loses packets in silence, and one that gives some twice, do not pass."""
    from drivers.sequence import Sequence
    from tests.benchmarks.hour import LedgerLine

    send = LedgerLine.send
    calls = iter(range(10**6))
    clean = "[[fault]]\nkind = 'drift'\nppm = 1"

    def leaky(line: LedgerLine, data: bytes) -> None:
        if next(calls) % 50:
            send(line, data)

    monkeypatch.setattr(LedgerLine, "send", leaky)
    assert any("have an end" in text for text in play(0.05, plan=clean).wrong)
    monkeypatch.setattr(LedgerLine, "send", send)

    monkeypatch.setattr(Sequence, "put", lambda self, frame: [frame] * (1 + frame.index % 2))
    assert any("twice" in text for text in play(0.05, plan=clean).wrong)
    monkeypatch.setattr(Sequence, "put", lambda self, frame: [frame] if frame.index % 2 else [])
    assert any("were read" in text for text in play(0.05, plan=clean).wrong)
