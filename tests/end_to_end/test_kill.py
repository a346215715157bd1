"""Four sessions that are killed while they record; twenty: `python -m tests.benchmarks.kill`."""

from __future__ import annotations

from pathlib import Path

from tests.benchmarks.kill import killed


def test_a_killed_session_leaves_a_log_of_all_but_the_last_second(tmp_path: Path) -> None:
    found = list(killed(tmp_path, 4, seed=1, longest=1.5))
    assert len(found) == 4
    for kill in found:
        assert kill.lost < 1.0, kill
        assert kill.holes == 0, kill
        assert kill.logged >= kill.seconds * 120 - 120, kill
