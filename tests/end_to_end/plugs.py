"""A plug that is pulled and put in again, over and over, in one session on a real pty."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import numpy as np

from drivers.frame import Layout
from drivers.registry import open_source
from drivers.wire.cobs import CobsEncoder
from simulators.lines import PtyLine

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
XYZ = np.ones((3, 3), np.float32)


class Tracker:
    """A device at `path` that is plugged in and out from outside, and sends while it is in."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._encoder = CobsEncoder()
        self._line: PtyLine | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._index = 0
        self._thread = threading.Thread(target=self._work)
        self.plug_in()
        self._thread.start()

    def plug_in(self) -> None:
        with self._lock:
            self._line = PtyLine(self._path)
            self._asked = False

    def pull(self) -> None:
        with self._lock:
            assert self._line is not None
            self._line.close()
            self._line = None

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.pull()

    def _work(self) -> None:
        while not self._stop.wait(1 / LAYOUT.rate):
            with self._lock:
                if self._line is None:
                    continue
                hello = self._line.receive(0.0)
                if hello and self._encoder.has_hello(hello.data):
                    self._line.send(self._encoder.encode_layout(LAYOUT))
                    self._asked = True
                if not self._asked:  # nobody has opened the port yet
                    continue
                time_ = self._index / LAYOUT.rate
                self._line.send(self._encoder.encode_frame(self._index, time_, XYZ))
                self._index += 1


def cycles(folder: Path, count: int) -> tuple[list[float], dict[str, int]]:
    """Seconds from each putting in to the first frame after it, and the session's counters."""
    tracker = Tracker(folder / "tracker")
    try:
        with open_source(f"serial:{folder / 'tracker'}") as source:
            assert source.read(5.0) is not None
            recovered = []
            for number in range(count):
                # In the middle of a frame or between two, and out for a moment or for longer.
                time.sleep(number % 7 * 0.0017)
                tracker.pull()
                while source.counters["disconnects"] == number:
                    source.read(0.05)
                source.read(number % 5 * 0.05)
                tracker.plug_in()
                back = time.monotonic()
                while source.read(0.01) is None:
                    assert time.monotonic() < back + 10, "the stream did not come back"
                recovered.append(time.monotonic() - back)
            return recovered, dict(source.counters)
    finally:
        tracker.close()
