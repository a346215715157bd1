"""A session in the field becomes a test: recorded on a real line with all that goes wrong there."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.session import Session
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext
from bridge.stage import Stage
from drivers.clock import VirtualClock
from drivers.frame import Layout
from drivers.marker_set import MARKERS
from drivers.registry import open_source
from drivers.session_log import SessionLog
from drivers.wire.cobs import CobsEncoder
from simulators.lines import PtyLine
from simulators.performer import load_performer
from tests.end_to_end.peers import wait_for
from tests.kept import Keep

MODEL = Model("default")
LAYOUT = Layout(MODEL.info.tracked, 240.0)


class Tracker:
    """A device that drops, doubles, exchanges, cuts and spoils packets."""

    def __init__(self, port: Path) -> None:
        self._port = port
        self._encoder = CobsEncoder()
        self._walker = load_performer("walk")
        self._rows = [MARKERS.index(label) for label in LAYOUT.labels]
        self._chance = np.random.default_rng(0)
        self._sent = 0
        self.line = PtyLine(port)

    def answer(self) -> None:
        while not ((hello := self.line.receive(5.0)) and self._encoder.has_hello(hello.data)):
            pass
        self.line.send(self._encoder.encode_layout(LAYOUT))

    def play(self, count: int) -> None:
        held = b""
        for index in range(self._sent, self._sent + count):
            xyz = self._walker.pose(index)[self._rows]
            xyz[self._chance.random(len(xyz)) < 0.05] = np.nan
            packet = self._encoder.encode_frame(index, index / 240, xyz)
            fault = self._chance.integers(40)
            if fault == 0:
                continue
            if fault == 1:
                packet += packet
            elif fault == 2:
                packet = packet[: len(packet) // 2]
            elif fault == 3:
                packet = packet[:20] + b"\x55" + packet[21:]
            elif fault == 4:
                held = packet
                continue
            self.line.send(packet + held)
            held = b""
            time.sleep(1 / 240)
        self._sent += count
        self.line.drain()

    def replug(self) -> None:
        self.line.send(b"\5\6 half a packet")
        self.line.close()
        time.sleep(0.15)
        self.line = PtyLine(self._port)


def test_what_went_wrong_on_a_line_goes_wrong_again_frame_by_frame(tmp_path: Path) -> None:
    tracker, path = Tracker(tmp_path / "tracker"), tmp_path / "session.mcap"
    context = SinkContext(MODEL.info, lambda index: None)
    live = Keep()
    source = open_source(f"serial:{tmp_path / 'tracker'}?reorder=1")
    sinks = [open_sink(f"log:{path}", context), live]
    session = Session(source, PoseEstimator(MODEL), sinks, context)
    stop = threading.Event()
    running = threading.Thread(target=Stage.of(session).run, args=(stop,))
    running.start()
    try:
        tracker.answer()
        tracker.play(150)
        tracker.replug()
        tracker.answer()
        tracker.play(150)
        wait_for(lambda: len(live.poses) > 240, "poses", 5)
    finally:
        stop.set()
        running.join()
        session.close()
        tracker.line.close()
    again = open_source(f"log:{path}?speed=max", VirtualClock(SessionLog(path).start))
    estimator = PoseEstimator(MODEL)
    for frame, pose in zip(again, live.poses, strict=True):
        assert (frame.index, frame.t) == (pose.index, pose.t)
        got = estimator.step(frame)
        for part in ("xyz", "provenance", "sigma"):
            np.testing.assert_array_equal(getattr(got, part), getattr(pose, part))
    assert again.counters["frames"] == session.status().frames > 240
    named = ("bad_crc", "bad_cobs", "duplicates", "missing", "reordered", "disconnects", "bytes")
    assert {name: again.counters[name] for name in named} == {
        name: source.counters[name] for name in named
    }
    assert min(source.counters[name] for name in named) > 0
