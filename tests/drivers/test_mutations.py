"""Spoilt packets through each wire; `python -m tests.benchmarks.mutations` sends a million."""

from __future__ import annotations

import pytest

from tests.drivers.mutations import ADDRESSES, run

COUNT = 400
MEMORY = 16 << 20  # bytes: what the interpreter may take and keep in so short a run


@pytest.mark.parametrize("name", ADDRESSES)
def test_no_packet_knocks_a_driver_over(name: str) -> None:
    outcome = run(name, COUNT, seed=1)
    assert outcome.unaccounted == []
    assert outcome.deaf_after == []
    assert outcome.slow == []
    assert outcome.grown < MEMORY
    assert outcome.counters["frames"] >= COUNT
