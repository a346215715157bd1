"""The run loop with real threads."""

from __future__ import annotations

import threading
from collections.abc import Iterable

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose
from bridge.session import Session
from bridge.sinks.sink import Input, Sink, SinkContext, SinkError
from drivers.c3d_file import C3dSource, Clip
from drivers.clock import SYSTEM_CLOCK
from drivers.frame import Layout, MarkerFrame, Source, SourceError
from drivers.session_log import LineEvent

MODEL = Model("default")
LAYOUT = Layout(MODEL.info.tracked, 120.0)
STANDING = np.random.default_rng(0).normal(1, 0.2, (9, 3)).astype(np.float32)


class Keep(Sink):
    name = "keep"
    waiting = None

    def __init__(self) -> None:
        self.indices: list[int] = []
        self.closed = 0

    def __call__(self, pose: Pose) -> None:
        self.indices.append(pose.index)

    def close(self) -> None:
        self.closed += 1


class Flood(Source):
    """All frames at once, as after a stall; then the end, or an error."""

    def __init__(self, count: int, error: Exception | None = None) -> None:
        super().__init__("flood")
        self._count = count
        self._error = error

    def _receive(self, timeout: float) -> Iterable[MarkerFrame]:
        if self._count:
            frames = [
                MarkerFrame(i, self.clock.now(), 0.0, LAYOUT, STANDING) for i in range(self._count)
            ]
            self._count = 0
            return frames
        if self._error:
            raise self._error
        self.exhausted = True
        return ()


def session(source: Source, *sinks: Sink) -> Session:
    context = SinkContext(MODEL.info, lambda index: None)
    return Session(source, PoseEstimator(MODEL), list(sinks), context)


def test_a_file_is_handled_whole_however_fast_it_comes(tmp_path) -> None:
    clip = Clip(tmp_path, LAYOUT, np.broadcast_to(STANDING, (3000, 9, 3)))
    keep = Keep()
    running = session(C3dSource("c3d:x", clip, SYSTEM_CLOCK, float("inf")), keep)
    running.run(threading.Event())
    running.close()
    assert keep.indices == list(range(3000))
    assert keep.closed == 1
    assert running.status().source["fifo_overflow"] == 0


def test_a_live_stream_that_overflows_loses_its_oldest_and_counts_them() -> None:
    keep = Keep()
    running = session(Flood(3000), keep)
    running.run(threading.Event())
    running.close()
    status = running.status()
    assert keep.indices[-1] == 2999
    assert keep.indices == sorted(keep.indices)
    assert len(keep.indices) + status.source["fifo_overflow"] == 3000
    assert status.frames == len(keep.indices)


@pytest.mark.parametrize("error", [SourceError("the port is gone"), RuntimeError("a bug")])
def test_what_the_source_raises_comes_out_after_what_it_delivered(error: Exception) -> None:
    keep = Keep()
    running = session(Flood(50, error), keep)
    with pytest.raises(type(error), match=str(error)):
        running.run(threading.Event())
    running.close()
    assert keep.indices == list(range(50))


def test_a_stop_ends_it_with_everything_delivered() -> None:
    class Endless(Flood):
        def _receive(self, timeout: float) -> Iterable[MarkerFrame]:
            self._count += 1
            self.clock.sleep_until(self.clock.now() + 0.001)
            return (MarkerFrame(self._count, self.clock.now(), 0.0, LAYOUT, STANDING),)

    threads = threading.active_count()
    keep, stop = Keep(), threading.Event()
    source = Endless(0)
    running = session(source, keep)
    threading.Timer(0.3, stop.set).start()
    running.run(stop)
    running.close()
    assert keep.indices == list(range(1, len(keep.indices) + 1))
    assert len(keep.indices) == source.counters["frames"] > 5
    assert threading.active_count() <= threads + 1  # the timer's own may not have ended


def test_one_sink_that_cannot_save_does_not_keep_the_others_from_it() -> None:
    class Full(Keep):
        def close(self) -> None:
            raise OSError("No space left on device")

    keep = Keep()
    running = session(Flood(5), Full(), keep)
    running.run(threading.Event())
    with pytest.raises(SinkError, match="No space left"):
        running.close()
    assert keep.closed == 1
    running.close()


def test_frames_that_never_came_are_those_that_the_source_counts() -> None:
    class Holed(Flood):
        def _receive(self, timeout: float) -> Iterable[MarkerFrame]:
            frames = super()._receive(timeout)
            self.counters["missing"] = 3
            return [frame for frame in frames if frame.index not in (7, 8, 20)]

    running = session(Holed(40))
    running.run(threading.Event())
    assert running.status().missing_indices == 3
    running.close()


def test_what_records_is_told_every_frame_even_those_that_overflow() -> None:
    class Record(Keep):
        records = True

        def __init__(self) -> None:
            super().__init__()
            self.frames: list[int] = []
            self.opened: list[tuple[str, str]] = []

        def record(self, came: Input) -> None:
            if isinstance(came, MarkerFrame):
                self.frames.append(came.index)
            elif isinstance(came, LineEvent):
                self.opened.append((came.source, came.address))

    record = Record()
    running = session(Flood(3000), record)
    running.run(threading.Event())
    running.close()
    overflow = running.status().source["fifo_overflow"]
    assert overflow > 0
    assert len(record.indices) == 3000 - overflow
    assert sorted(record.frames) == list(range(3000))
    assert record.opened == [("source", "flood")]
