from __future__ import annotations

import os
import socket
import threading
import time
from pathlib import Path

import pytest
import serial

from drivers.clock import SYSTEM_CLOCK, VirtualClock
from drivers.frame import SourceError
from drivers.serial_port import SerialTransport
from drivers.transport import TransportLost
from simulators.lines import MemoryLine, PtyLine, SimulatorError, UdpLine


def test_a_pty_is_a_serial_port_both_ways(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "port")
    port = SerialTransport(str(tmp_path / "port"), 921_600, SYSTEM_CLOCK)
    line.send(b"\x00\x11\x13\r\n\xff")
    assert port.receive(1.0).data == b"\x00\x11\x13\r\n\xff"
    port.send(b"hello")
    assert line.receive(1.0).data == b"hello"
    port.close()
    line.close()
    assert not (tmp_path / "port").is_symlink()


def test_a_pulled_plug_is_seen_and_the_port_there_again_under_its_path(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "port")
    for _ in range(3):
        port = SerialTransport(str(tmp_path / "port"), 921_600, SYSTEM_CLOCK)
        line.unplug()
        with pytest.raises(TransportLost):
            port.receive(1.0)
        port.close()
        with pytest.raises(SourceError, match="cannot open serial port"):
            SerialTransport(str(tmp_path / "port"), 921_600, SYSTEM_CLOCK)
        line.plug()
        port = SerialTransport(str(tmp_path / "port"), 921_600, SYSTEM_CLOCK)
        line.send(b"again")
        assert port.receive(1.0).data == b"again"
        port.close()
    line.close()


def test_closing_an_unplugged_line_closes_nobody_elses_file(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "port")
    line.unplug()
    other = [os.open(tmp_path, os.O_RDONLY) for _ in range(4)]
    line.drain()
    line.close()
    for number in other:
        os.close(number)  # OSError if it were closed already


@pytest.mark.parametrize("host", ["pyserial", "cat"])
def test_it_is_seen_when_a_host_opens_a_pty(tmp_path: Path, host: str) -> None:
    line = PtyLine(tmp_path / "port")
    assert not line.opened(0.0)
    opened: list[object] = []

    def open_it() -> None:
        if host == "pyserial":
            opened.append(serial.Serial(str(tmp_path / "port"), 115_200, timeout=1.0))
        else:
            opened.append((tmp_path / "port").open("rb", buffering=0))

    later = threading.Timer(0.1, open_it)
    began = time.monotonic()
    later.start()
    assert line.opened(10.0)
    assert time.monotonic() - began < 5.0
    later.join()
    line.send(b"first")  # nothing of it is thrown away by the host's opening
    assert opened[0].read(5) == b"first"
    opened[0].close()
    line.close()


def test_a_path_that_is_taken_is_refused_with_a_way_out(tmp_path: Path) -> None:
    (tmp_path / "port").write_text("mine")
    with pytest.raises(SimulatorError, match="choose a path that does not exist"):
        PtyLine(tmp_path / "port")
    assert (tmp_path / "port").read_text() == "mine"


def test_a_udp_line_that_is_put_in_again_sends_from_another_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.settimeout(1.0)
        line = UdpLine("127.0.0.1", host.getsockname()[1])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            line.send(b"one")
            data, before = host.recvfrom(100)
            line.unplug()
            taken.bind(before)  # nobody may have the old one now
            line.plug()
            line.send(b"two")
            again, after = host.recvfrom(100)
        assert (data, again) == (b"one", b"two")
        assert before != after
        line.close()


def test_a_line_in_memory_is_opened_anew_each_time() -> None:
    clock = VirtualClock()
    line = MemoryLine(clock)
    line.send(b"nobody")
    assert line.lost == 1
    assert line.receive(2.0) is None
    assert clock.now() == 2.0
    first = line.connect()
    line.send(b"one")
    assert first.receive(0.0).data == b"one"
    second = line.connect()
    with pytest.raises(TransportLost):
        first.receive(0.0)
    second.send(b"hello")
    assert line.receive(0.0).data == b"hello"
    line.unplug()
    with pytest.raises(SourceError):
        line.connect()
    line.plug()
    third = line.connect()
    third.close()
    line.send(b"gone")
    assert line.receive(0.0) is None
    assert line.lost == 2
