from __future__ import annotations

from pathlib import Path

from tests.end_to_end.plugs import cycles

COUNT = 12  # python -m tests.benchmarks.plugs pulls it a hundred times


def test_every_time_the_plug_is_in_again_the_stream_goes_on(tmp_path: Path) -> None:
    recovered, counters = cycles(tmp_path, COUNT)
    assert len(recovered) == COUNT
    assert counters["disconnects"] == counters["reconnects"] == COUNT
    # The line is tried every 100 ms, the device asked at once: half a second is what a busy machine
    # may make of it.
    assert sorted(recovered)[COUNT // 2] < 0.5
    assert counters["frames"] >= COUNT
