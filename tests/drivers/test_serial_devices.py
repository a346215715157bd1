"""Ports, probed over real ptys."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import serial

from drivers.frame import Layout
from drivers.serial_devices import Port, identify, identify_all, ports
from drivers.url import Url
from drivers.wire.registry import take_encoder
from simulators.lines import PtyLine

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
LISTEN = 0.3  # s


class Talker:
    """A device on a pty that sends all the time."""

    def __init__(self, path: Path, packets: list[bytes]) -> None:
        self.line = PtyLine(path)
        self._packets = packets
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._talk)
        self._thread.start()

    def _talk(self) -> None:
        while not self._stop.is_set():
            for packet in self._packets:
                if self._stop.wait(0.005):
                    return
                self.line.send(packet)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.line.close()


@pytest.fixture
def talkers(tmp_path: Path) -> Iterator[dict[str, Path]]:
    """A port for each of some codecs, one with text that is no tracker's, and a silent one."""
    packets = {name: frames(name) for name in ("cobs", "lines", "slip-osc")}
    packets["text"] = [b"ready 1 2 3\r\n", b"temperature: 21.5\r\n"]
    packets["silent"] = []
    opened = [Talker(tmp_path / name, chunks) for name, chunks in packets.items() if chunks]
    silent = PtyLine(tmp_path / "silent")
    yield {name: tmp_path / name for name in packets}
    for talker in opened:
        talker.close()
    silent.close()


def frames(codec: str) -> list[bytes]:
    encoder, _ = take_encoder(Url.parse(f"serial:x?codec={codec}"))
    xyz = np.arange(9, dtype=np.float32).reshape(3, 3)
    layout = encoder.encode_layout(LAYOUT)
    return [layout + encoder.encode_frame(n, n / 120, xyz) for n in range(1000)]


def test_each_port_is_named_with_the_address_to_use(talkers: dict[str, Path]) -> None:
    found = identify_all([Port(str(path)) for path in talkers.values()], LISTEN)
    by_name = dict(zip(talkers, found, strict=True))
    assert by_name["cobs"].address == f"serial:{talkers['cobs']}"
    assert by_name["lines"].address == f"serial:{talkers['lines']}?codec=lines"
    assert by_name["slip-osc"].address == f"serial:{talkers['slip-osc']}?codec=slip-osc"
    assert by_name["text"].address == ""
    assert sum(by_name["text"].heard.values()) > 0
    assert sum(by_name["silent"].heard.values()) == 0
    assert not any(identity.trouble for identity in found)


def test_a_port_that_cannot_be_opened_says_why(tmp_path: Path) -> None:
    assert "no such port" in identify(Port(str(tmp_path / "none")), LISTEN).trouble
    line = PtyLine(tmp_path / "taken")
    try:
        with serial.Serial(str(tmp_path / "taken"), exclusive=True):
            assert "another program" in identify(Port(str(tmp_path / "taken")), LISTEN).trouble
    finally:
        line.close()


def test_a_device_that_goes_away_meanwhile_is_no_error(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "loose")
    timer = threading.Timer(0.1, line.close)
    timer.start()
    found = identify(Port(str(tmp_path / "loose")), 5.0)
    timer.join()
    assert "went away" in found.trouble


def test_ports_that_are_named_are_those_that_are_probed(tmp_path: Path) -> None:
    assert ports([str(tmp_path / "tracker")]) == [Port(str(tmp_path / "tracker"))]
    assert identify_all([], LISTEN) == []
