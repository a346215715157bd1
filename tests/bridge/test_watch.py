"""What the log says of a session, on virtual time: a real source on a line with troubles."""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose
from bridge.session import Session
from bridge.sinks.sink import Sink, SinkContext
from bridge.terminal import line
from bridge.watch import LOOK, Watch
from drivers.clock import VirtualClock
from drivers.frame import Layout, SourceError
from drivers.transport import MemoryTransport, TransportLost, memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire_source import WireSource

MODEL = Model("default")
LAYOUT = Layout(MODEL.info.tracked, 20.0)
STANDING = np.random.default_rng(0).normal(1, 0.2, (len(LAYOUT.labels), 3)).astype(np.float32)
NAME = "serial:tracker"


class Bench:
    """A device, a session and its watch. Each frame goes over the line as `sent` makes it."""

    def __init__(self, *sinks: Sink) -> None:
        self.clock = VirtualClock()
        self.plugged = self.playing = True
        self.hidden = np.zeros(len(LAYOUT.labels), bool)
        self.spoil: Callable[[int, bytes], bytes] = lambda _index, packet: packet
        self._index = 0
        self._encoder = CobsEncoder()
        self._device: MemoryTransport | None = None
        source = WireSource(NAME, self._connect, CobsDecoder(), self.clock, reopens=True)
        context = SinkContext(MODEL.info, lambda _index: None)
        estimator = PoseEstimator(MODEL)
        self.session = Session(source, estimator, list(sinks), context, clock=self.clock)
        self.watch = Watch(NAME)
        self._play()

    def _connect(self) -> MemoryTransport:
        if not self.plugged:
            raise SourceError("not there")
        ours, self._device = memory_line(self.clock)
        self._device.send(self._encoder.encode_layout(LAYOUT))
        return ours

    def _play(self) -> None:
        self.clock.call_at(self._index / LAYOUT.rate, self._play)
        self._index += 1
        if self.playing and self._device is not None and self.plugged:
            xyz = np.where(self.hidden[:, None], np.float32(np.nan), STANDING)
            packet = self._encoder.encode_frame(self._index, self.clock.now(), xyz)
            with contextlib.suppress(TransportLost):
                self._device.send(self.spoil(self._index, packet))

    def unplug(self) -> None:
        self.plugged = False
        if self._device is not None:
            self._device.close()

    def replug(self) -> None:
        self.plugged = True

    def run(self, seconds: float) -> None:
        end = self.clock.now() + seconds
        while self.clock.now() < end - 1e-9:
            look = min(end, self.clock.now() + LOOK)
            while self.clock.now() < look - 1e-9:
                frame = self.session.source.read(look - self.clock.now())
                if frame is not None:
                    self.session.handle(frame)
            self.watch.look(self.session.status())


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> Callable[[], list[str]]:
    """What was said since the last call."""
    caplog.set_level(logging.INFO)

    def said() -> list[str]:
        found = [record.getMessage() for record in caplog.records]
        caplog.clear()
        return found

    return said


def test_when_all_goes_well_nothing_is_said(lines) -> None:
    Bench().run(100)
    assert lines() == []


def test_what_went_wrong_is_one_line_in_ten_seconds(lines) -> None:
    bench = Bench()
    bench.run(5)
    # A frame of ten is damaged, and one of fifty never comes.
    bench.spoil = lambda index, packet: (
        b"" if index % 50 == 7 else b"x" + packet[1:] if index % 10 == 0 else packet
    )
    bench.run(5.1)
    counters = bench.session.source.counters
    bad = counters["bad_cobs"] + counters["bad_crc"]
    assert (bad, counters["missing"]) == (10, 12)
    (line,) = lines()
    assert re.fullmatch(f"{NAME}: in 10 s: 19. frames, 12 missing, 10 bad_(cobs|crc)", line)
    bench.run(100)
    assert len(lines()) in (9, 10)
    bench.spoil = lambda index, packet: packet
    bench.run(10)
    lines()
    bench.run(100)
    assert lines() == []


def test_a_lost_line_and_a_found_one_are_told_at_once(lines) -> None:
    bench = Bench()
    bench.run(3)
    bench.unplug()
    bench.run(2 * LOOK)
    assert lines() == [f"{NAME}: connection lost"]
    bench.run(600)
    assert lines() == []
    bench.replug()
    bench.run(2 * LOOK)
    assert lines() == [f"{NAME}: found again after 10.0 min"]
    bench.run(100)
    assert lines() == []


def test_a_marker_that_is_away_for_long_is_told_and_so_is_its_return(lines) -> None:
    bench = Bench()
    bench.run(3)
    bench.hidden[2] = True
    bench.run(2.5)
    bench.hidden[:] = False
    bench.run(5)
    assert lines() == []
    bench.hidden[[2, 5]] = True
    bench.run(30)
    two = f"{LAYOUT.labels[2]}, {LAYOUT.labels[5]}"
    assert lines() == [f"{NAME}: no {two} for 3 s"]
    bench.hidden[5] = False
    bench.run(5)
    (line,) = lines()
    assert re.fullmatch(rf"{NAME}: seen again: {LAYOUT.labels[5]} after 30\.\d s", line)
    bench.unplug()
    bench.run(10)
    assert lines() == [f"{NAME}: connection lost"]


def test_a_short_break_is_told_as_one(lines) -> None:
    bench = Bench()
    bench.run(3)
    bench.unplug()
    bench.run(0.1)
    bench.replug()
    bench.run(1)
    assert lines() == [f"{NAME}: connection lost and found again"]


def test_a_plug_that_flaps_is_told_less_and_less_often(lines) -> None:
    bench = Bench()
    bench.run(20)
    losses, times = 0, []
    told: list[str] = []
    while bench.clock.now() < 320:
        bench.unplug()
        bench.run(0.15)
        bench.replug()
        bench.run(0.35)
        losses += 1
        if found := [line for line in lines() if " in 10 s" not in line]:
            times.append(bench.clock.now())
            told += found
    bench.run(20)
    told += [line for line in lines() if " in 10 s" not in line]
    assert len(told) < 300 / 10 + 6
    assert all(later - earlier >= 1 for earlier, later in pairwise(times))
    # Every one of them is told in the end.
    often = [int(line.rpartition(", ")[2].split()[0]) if ", " in line else 1 for line in told]
    assert sum(often) == losses
    # After a calm a change is told at once again.
    bench.unplug()
    bench.run(2 * LOOK)
    assert lines() == [f"{NAME}: connection lost"]


def test_silence_is_told_once_and_so_is_its_end(lines) -> None:
    bench = Bench()
    bench.playing = False
    bench.run(3)
    (line,) = lines()
    quiet = f"{NAME}: no frames for 2 s"
    found = r"\d+ bytes came, but no frame in them \(\d layouts\)"
    assert re.fullmatch(rf"{quiet}: {found}: `markerbridge doctor .*`.* tells why", line)
    bench.playing = True
    bench.run(10)
    lines()
    bench.playing = False
    bench.run(3600)
    (line,) = lines()
    assert line.startswith(quiet)
    assert bench.session.source.counters["silences"] > 100
    bench.playing = True
    bench.run(1)
    assert lines() == [f"{NAME}: frames come again after 60.0 min"]


def test_bytes_without_frames_are_told_as_what_they_are(lines) -> None:
    bench = Bench()
    bench.spoil = lambda _index, packet: b"boot ok\0"
    bench.run(3)
    (line,) = lines()
    assert line.startswith(f"{NAME}: no frames for 2 s: ")
    assert "bytes came, but no frame in them (" in line
    assert "bad_" in line
    assert f"`markerbridge doctor {NAME}`" in line


def test_what_goes_wrong_on_the_truth_channel_has_a_line_of_its_own(lines) -> None:
    bench = Bench()
    status = bench.session.status()
    bench.watch.look(replace(status, seconds=0.0, truth={"frames": 0}))
    bench.watch.look(replace(status, seconds=10.0, truth={"frames": 7, "bad_osc": 3}))
    assert "truth: in 10 s: 7 frames, 3 bad_osc" in lines()


def test_packets_that_are_refused_are_not_told_as_nothing(lines) -> None:
    bench = Bench()
    bench.playing = False
    bench.run(1)
    bench.session.source.counters.clear()
    bench.watch.look(bench.session.status())
    for _ in range(3):
        bench.session.source.counters["refused"] += 120
        bench.clock.sleep_until(bench.clock.now() + 1)
        bench.watch.look(bench.session.status())
    (told,) = lines()
    assert re.search(r"the option allow does not name come \(\d+ refused\)", told)
    assert "360 packets came, of senders that" in line(bench.session.status())


def test_a_sink_that_fails_is_summed_up_by_name(lines) -> None:
    class Broken(Sink):
        name = "vmc://nowhere"

        def __call__(self, pose: Pose) -> None:
            if pose.index % 2:
                raise OSError("no route")

        def close(self) -> None:
            pass

    bench = Bench(Broken())
    bench.run(100.5)
    first, *sums = lines()
    assert first.startswith("vmc://nowhere: no route (said once")
    assert len(sums) == 10
    assert sums[-1] == "vmc://nowhere: in 10 s: 100 poses, 100 errors"
