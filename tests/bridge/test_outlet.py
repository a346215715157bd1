from __future__ import annotations

import threading

import numpy as np
import pytest

from bridge.pose import Pose
from bridge.sinks.outlet import Outlet, Tap
from bridge.sinks.sink import Input, Sink, SinkClosed, SinkError
from drivers.clock import SYSTEM_CLOCK, VirtualClock
from drivers.session_log import FOUND, LOST, LineBytes, LineEvent
from drivers.transport import Received

EMPTY = np.zeros((0, 3), np.float32)


def pose(index: int) -> Pose:
    return Pose(index, 0.0, EMPTY, np.zeros(0, np.uint8), EMPTY[:, 0])


class Gate(Sink):
    """A sink that takes a pose only when it is let; it says when it holds one."""

    name = "gate"

    def __init__(self, waiting: int | None = 25, rate: float = 0.0) -> None:
        self.waiting = waiting
        self.rate = rate
        self.taken: list[int] = []
        self.let = threading.Semaphore(0)
        self.holds = threading.Event()
        self.closed = 0

    def __call__(self, pose: Pose) -> None:
        self.holds.set()
        self.let.acquire()
        self.taken.append(pose.index)

    def close(self) -> None:
        self.closed += 1


def filled(waiting: int | None, count: int) -> tuple[Gate, Outlet]:
    """An outlet whose sink holds pose 0 while poses 1 to count - 1 come."""
    gate = Gate(waiting)
    outlet = Outlet(gate, SYSTEM_CLOCK)
    outlet.start()
    outlet.put(pose(0))
    assert gate.holds.wait(5)
    for index in range(1, count):
        outlet.put(pose(index))
    return gate, outlet


def test_a_recorder_gets_every_pose_however_slow_it_is() -> None:
    gate, outlet = filled(None, 500)
    gate.let.release(500)
    outlet.close()
    assert gate.taken == list(range(500))
    assert outlet.counters == {"sent": 500}
    assert gate.closed == 1


class Closed(Gate):
    """Whoever looked at it has gone."""

    def __call__(self, pose: Pose) -> None:
        self.taken.append(pose.index)
        if pose.index == 2:
            raise SinkClosed("the window was closed")


def test_a_sink_that_nobody_wants_any_more_gets_no_poses_and_is_no_error() -> None:
    closed = Closed()
    outlet = Outlet(closed, SYSTEM_CLOCK)
    for index in range(5):
        outlet.put(pose(index))
    assert closed.taken == [0, 1, 2]
    assert outlet.counters == {"sent": 2}
    assert outlet.last_error is None


class Recorder(Gate):
    """A gate that keeps what it is told of what comes in, between the poses."""

    records = True

    def record(self, came: Input) -> None:
        assert isinstance(came, LineBytes)
        self.taken.append(int(came.received.data))


def test_what_comes_in_is_recorded_in_its_place_however_slow_the_disk() -> None:
    recorder = Recorder(None)
    outlet = Outlet(recorder, SYSTEM_CLOCK)
    outlet.start()
    outlet.put(pose(0))
    assert recorder.holds.wait(5)
    tap = Tap("source", [outlet])
    for index in range(1, 400, 2):
        tap.received("serial:/dev/x", Received(b"%d" % index, 0.0))
        outlet.put(pose(index + 1))
    recorder.let.release(400)
    outlet.close()
    assert recorder.taken == list(range(401))
    assert outlet.counters == {"sent": 201, "recorded": 200}


def test_a_line_that_is_lost_and_found_is_recorded_under_its_name() -> None:
    told: list[Input] = []
    recorder = Recorder()
    recorder.record = told.append  # type: ignore[method-assign]
    tap = Tap("truth", [Outlet(recorder, SYSTEM_CLOCK)])
    tap.lost("osc://127.0.0.1:1", 3.0)
    tap.found("osc://127.0.0.1:1", 4.0)
    assert told == [LineEvent("truth", 3.0, LOST), LineEvent("truth", 4.0, FOUND)]


def test_the_newest_pose_wins_where_one_may_wait() -> None:
    gate, outlet = filled(1, 100)
    gate.let.release(100)
    outlet.close()
    assert gate.taken == [0, 99]
    assert outlet.counters == {"sent": 2, "dropped": 98}


def test_a_bounded_queue_drops_the_oldest_and_counts_them() -> None:
    gate, outlet = filled(25, 100)
    gate.let.release(100)
    outlet.close()
    assert gate.taken == [0, *range(75, 100)]
    assert outlet.counters["dropped"] == 74


def test_a_sink_that_raises_loses_that_pose_alone_and_says_so_once(caplog) -> None:
    class Broken(Gate):
        def __call__(self, pose: Pose) -> None:
            if pose.index % 2:
                raise OSError("no route")
            self.taken.append(pose.index)

    sink = Broken()
    outlet = Outlet(sink, SYSTEM_CLOCK)
    for index in range(10):
        outlet.put(pose(index))
    assert sink.taken == [0, 2, 4, 6, 8]
    assert outlet.counters == {"sent": 5, "errors": 5}
    assert outlet.last_error == "no route"
    assert [record.message for record in caplog.records] == [
        "gate: no route (said once; counted from now on)"
    ]


def test_a_recording_that_cannot_be_saved_is_an_error_at_the_end() -> None:
    class Full(Gate):
        def close(self) -> None:
            raise OSError("No space left on device")

    with pytest.raises(SinkError, match="gate: No space left on device"):
        Outlet(Full(), SYSTEM_CLOCK).close()


@pytest.mark.parametrize(("rate", "stream"), [(50.0, 120), (250.0, 1000), (30.0, 60)])
def test_a_rate_limit_holds_over_time(rate: float, stream: int) -> None:
    clock = VirtualClock()
    gate = Gate(rate=rate)
    gate.let.release(100_000)
    outlet = Outlet(gate, clock)
    outlet.stream_rate = stream
    seconds = 20
    for index in range(stream * seconds):
        clock.sleep_until(index / stream)
        outlet.put(pose(index))
    assert outlet.counters["sent"] == pytest.approx(rate * seconds, rel=0.02)
    assert outlet.counters["sent"] + outlet.counters["rate_limited"] == stream * seconds


def test_a_stream_below_the_limit_passes_whole_though_it_comes_in_bursts() -> None:
    clock = VirtualClock()
    gate = Gate(rate=250.0)
    gate.let.release(100_000)
    outlet = Outlet(gate, clock)
    outlet.stream_rate = 120.0
    for index in range(2400):
        clock.sleep_until((index // 6) * 0.05)  # 120 Hz, six at a time
        outlet.put(pose(index))
    assert gate.taken == list(range(2400))


def test_with_a_thread_the_limit_keeps_the_newest() -> None:
    gate = Gate(rate=100.0)
    gate.let.release(10_000)
    gate.waiting = None
    outlet = Outlet(gate, SYSTEM_CLOCK)
    outlet.stream_rate = 1000.0
    outlet.start()
    began = SYSTEM_CLOCK.now()
    for index in range(2000):
        outlet.put(pose(index))
    outlet.close()
    seconds = SYSTEM_CLOCK.now() - began
    assert gate.taken[-1] == 1999
    assert gate.taken == sorted(gate.taken)
    assert len(gate.taken) <= 100 * (seconds + 0.1) + 1
    assert sum(outlet.counters.values()) == 2000


def test_after_a_stall_a_slower_stream_than_the_limit_loses_nothing() -> None:
    """60 poses at once: more than the burst, so they are paced, and all of them come."""
    gate = Gate(waiting=120, rate=400.0)
    gate.let.release(10_000)
    outlet = Outlet(gate, SYSTEM_CLOCK)
    outlet.stream_rate = 120.0
    outlet.start()
    began = SYSTEM_CLOCK.now()
    for index in range(60):
        outlet.put(pose(index))
    outlet.close()
    assert SYSTEM_CLOCK.now() - began >= (60 - 41) / 400
    assert gate.taken == list(range(60))
