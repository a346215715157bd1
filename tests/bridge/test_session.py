"""The run loop with real threads."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from functools import partial

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.regression import Estimate
from bridge.session import Session
from bridge.sinks.sink import Input, Sink, SinkContext, SinkError
from bridge.stage import Stage
from bridge.terminal import line
from bridge.truth import Truth
from drivers.c3d_file import C3dSource, Clip
from drivers.clock import SYSTEM_CLOCK, VirtualClock
from drivers.frame import Layout, MarkerFrame, Source, SourceError
from drivers.session_log import LineEvent
from drivers.transport import MemoryTransport, memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire_source import WireSource

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


class Named(Keep):
    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name


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
    Stage.of(running).run(threading.Event())
    running.close()
    assert keep.indices == list(range(3000))
    assert keep.closed == 1
    assert running.status().source["fifo_overflow"] == 0


def test_a_live_stream_that_overflows_loses_its_oldest_and_counts_them() -> None:
    keep = Keep()
    running = session(Flood(3000), keep)
    Stage.of(running).run(threading.Event())
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
        Stage.of(running).run(threading.Event())
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
    Stage.of(running).run(stop)
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
    Stage.of(running).run(threading.Event())
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
    Stage.of(running).run(threading.Event())
    assert running.status().missing_indices == 3
    running.close()


def wire_session(
    clock: VirtualClock, labels: tuple[str, ...], truth: Truth | None = None
) -> tuple[Session, MemoryTransport, CobsEncoder]:
    """A session whose device sends frames of `labels`: its end of the line, and its encoder."""
    ours, device = memory_line(clock)
    source = WireSource("osc://here:9", lambda: ours, CobsDecoder(), clock)
    encoder = CobsEncoder()
    device.send(encoder.encode_layout(Layout(labels, 120.0)))
    context = SinkContext(MODEL.info, truth.at if truth else lambda index: None)
    running = Session(source, PoseEstimator(MODEL), [], context, truth=truth, clock=clock)
    return running, device, encoder


def test_a_frame_that_is_held_up_on_the_line_is_seen_in_the_delay() -> None:
    clock = VirtualClock()
    running, device, encoder = wire_session(clock, LAYOUT.labels)
    assert running.status().ages["delay"].now is None
    for index in range(100):
        late = 0.2 if index == 99 else 0.01
        packet = encoder.encode_frame(index, index / 120, STANDING)
        clock.call_at(index / 120 + late, partial(device.send, packet))
    while (frame := running.source.read(0.5)) is not None:
        running.handle(frame)
    status = running.status()
    assert status.frames == 100
    delay = status.ages["delay"]
    assert delay.count == 100
    assert delay.worst == delay.max == pytest.approx(0.19, abs=1e-3)
    assert delay.p50 is not None
    assert delay.p50 < 1e-3
    # On virtual time nothing waits, and to read and to estimate costs nothing.
    assert status.ages["parse"].count == 100
    assert status.ages["parse"].max == 0.0
    assert status.ages["queue"].max == status.ages["estimate"].max == 0.0


def test_every_hop_is_accounted_for_to_the_microsecond() -> None:
    """Each costs what it is told to: the line, the queue, the estimate and a sink."""
    clock = VirtualClock()

    class Slow(Keep):
        def __call__(self, pose: Pose) -> None:
            clock.sleep_until(clock.now() + 0.001)

    class Thinking(PoseEstimator):
        def finish(self, frame: MarkerFrame, estimate: Estimate) -> Pose:
            clock.sleep_until(clock.now() + 0.002)
            return super().finish(frame, estimate)

    context = SinkContext(MODEL.info, lambda index: None)
    running = Session(Flood(0), Thinking(MODEL), [Slow(), Named("second")], context, clock=clock)
    waits = np.random.default_rng(1).permutation(np.arange(1, 481)) / 48_000  # s, to 10 ms
    for index, wait in enumerate(waits.tolist()):
        t = clock.now()
        clock.sleep_until(t + wait)
        frame = MarkerFrame(index, t, t, LAYOUT, STANDING, t - 0.003, t + wait / 2)
        pose = running.handle(frame)
        # The times of each frame go with its pose.
        assert (pose.t, pose.t_mapped, pose.t_parsed) == (frame.t, frame.t_mapped, frame.t_parsed)
        assert pose.t_estimated == pytest.approx(t + wait + 0.002, abs=1e-9)
    status = running.status()
    parse = status.ages["parse"]
    assert (parse.count, parse.max) == (480, pytest.approx(0.005, abs=1e-9))
    assert parse.p50 == pytest.approx(0.0025, rel=0.024)
    assert parse.p99 == pytest.approx(0.00495, rel=0.024)
    sinks = status.sinks
    for ages, cost in (
        (status.ages["queue"], 0.0),
        (status.ages["estimate"], 0.002),
        (sinks["keep"]["age"], 0.003),
        (sinks["second"]["age"], 0.003),
    ):
        assert ages.count == 480
        assert ages.p50 == pytest.approx(0.005 + cost, rel=0.024)
        assert ages.p99 == pytest.approx(0.0099 + cost, rel=0.024)
        assert ages.max == pytest.approx(0.01 + cost, abs=1e-9)
        # Of the last second, exactly.
        lately = waits[-np.searchsorted(np.cumsum(waits[::-1] + 0.003), 1.0) :] + cost
        assert ages.worst == pytest.approx(lately.max(), abs=1e-9)
        assert ages.now == pytest.approx(np.median(lately), abs=5e-5)
    delay = status.ages["delay"]
    assert (delay.count, delay.max) == (480, pytest.approx(0.003, abs=1e-9))
    assert status.silent == pytest.approx(0.003, abs=1e-9)
    # After a second nothing is of now any more, and all of it is of the session.
    clock.sleep_until(clock.now() + 1.1)
    later = running.status().ages["estimate"]
    assert (later.now, later.worst, later.count) == (None, None, 480)
    assert later.p50 == status.ages["estimate"].p50


def test_markers_are_accounted_for_frame_by_frame() -> None:
    clock = VirtualClock()
    running, device, encoder = wire_session(clock, LAYOUT.labels)
    assert running.status().markers == {}
    hidden = {2: range(30, 60), 5: range(10, 20), 7: range(80, 100)}
    poses = []
    for index in range(100):
        xyz = STANDING.copy()
        xyz[[row for row, frames in hidden.items() if index in frames]] = np.nan
        packet = encoder.encode_frame(index, index / 120, xyz)
        clock.call_at(index / 120, partial(device.send, packet))
    while (frame := running.source.read(0.5)) is not None:
        poses.append(running.handle(frame))
    markers = running.status().markers
    assert tuple(markers) == MODEL.info.tracked
    for label, marker in markers.items():
        row = MODEL.info.labels.index(label)
        states = [pose.provenance[row] for pose in poses]
        assert marker.missing == sum(state == Provenance.IMPUTED for state in states)
        assert marker.missing >= len(hidden.get(MODEL.info.tracked.index(label), ()))
        assert marker.state == Provenance(states[-1]).name.lower()
        changes = [at for at in range(1, 100) if states[at] != states[at - 1]]
        since = poses[changes[-1]].t if changes else poses[0].t
        assert marker.seconds == pytest.approx(clock.now() - since, abs=1e-9)
    assert running.status().imputed_samples == sum(marker.missing for marker in markers.values())
    assert markers[MODEL.info.tracked[7]].state == "imputed"


@pytest.mark.parametrize("labels", [("1", "head"), ("1", *LAYOUT.labels[1:])])
def test_foreign_labels_are_told_with_the_way_to_map_them(labels, caplog) -> None:
    clock = VirtualClock()
    running, device, encoder = wire_session(clock, labels)
    device.send(encoder.encode_frame(0, 0.0, STANDING[: len(labels)]))
    frame = running.source.read(1.0)
    assert frame is not None
    if len(labels) == 2:
        with pytest.raises(SourceError) as refused:
            running.handle(frame)
        text = str(refused.value)
    else:
        running.handle(frame)
        (text,) = caplog.messages
        assert f"no {LAYOUT.labels[0]}, imputed throughout, but 1: " in text
    assert "labels=THEIRS:OURS" in text
    assert "`markerbridge doctor osc://here:9`" in text


def test_a_truth_that_does_not_come_is_seen() -> None:
    clock = VirtualClock()
    ours, sender = memory_line(clock)
    truth = Truth(WireSource("truth", lambda: ours, CobsDecoder(), clock), MODEL.info.labels)
    running, device, encoder = wire_session(clock, LAYOUT.labels, truth)
    for index in range(2):
        device.send(encoder.encode_frame(index, index / 120, STANDING))
        frame = running.source.read(1.0)
        assert frame is not None
        running.handle(frame)
        assert "no RMS: no true pose has come" in line(running.status())
        sender.send(b"rubbish\0")
    status = running.status()
    assert status.truth is not None
    assert status.truth["bytes"] == 8
    assert status.truth.get("frames", 0) == 0


def test_bytes_of_which_no_frame_is_read_are_told_in_every_line() -> None:
    clock = VirtualClock()
    running, device, _ = wire_session(clock, LAYOUT.labels)
    device.send(b"rubbish\0" * 1000)
    assert running.source.read(1.0) is None
    clock.sleep_until(3.0)
    told = line(running.status())
    assert "no frame for 3 s, though 8,061 bytes came: `markerbridge doctor` tells why" in told


def test_engines_are_told_when_no_frame_comes_and_recorders_are_not(monkeypatch) -> None:
    monkeypatch.setattr("bridge.session.SILENT", 0.15)

    class Stalling(Flood):
        """Ten frames, none for a while, ten more, the end."""

        def _receive(self, timeout: float) -> Iterable[MarkerFrame] | None:
            if len(engine.lost) < 3 and self.counters["frames"] == 10:
                self.clock.sleep_until(self.clock.now() + 0.02)
                return None
            if self.counters["frames"] < 20:
                now, index = self.clock.now(), self.counters["frames"]
                return (MarkerFrame(index, now, now, LAYOUT, STANDING),)
            return super()._receive(timeout)

    class Engine(Keep):
        waiting = 120
        wants_posture = True

        def __init__(self) -> None:
            super().__init__()
            self.lost: list[Pose] = []

        def __call__(self, pose: Pose) -> None:
            if (pose.provenance == Provenance.LOST).all():
                self.lost.append(pose)
            else:
                super().__call__(pose)

    engine, recorder = Engine(), Named("recorder")
    running = session(Stalling(0), engine, recorder)
    Stage.of(running).run(threading.Event())
    running.close()
    assert engine.indices == recorder.indices == list(range(20))
    assert {pose.index for pose in engine.lost} == {9}
    times = [pose.t for pose in engine.lost]
    assert len(times) >= 3
    assert times == sorted(set(times))
    for pose in engine.lost:
        assert np.isinf(pose.sigma).all()
        assert pose.posture is not None
        assert np.isinf(pose.posture.sigma).all()
    assert running.status().frames == 20
    assert running.status().lost_frames == 0


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
    Stage.of(running).run(threading.Event())
    running.close()
    overflow = running.status().source["fifo_overflow"]
    assert overflow > 0
    assert len(record.indices) == 3000 - overflow
    assert sorted(record.frames) == list(range(3000))
    assert record.opened == [("source", "flood")]
