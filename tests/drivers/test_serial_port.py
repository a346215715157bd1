"""Serial ports that come and go: on a real pty, and with a made-up list of USB devices."""

from __future__ import annotations

import contextlib
import os
import pty
import termios
import time
import tty
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from serial.tools import list_ports

from drivers.clock import SYSTEM_CLOCK
from drivers.frame import Layout, SourceError
from drivers.registry import open_source
from drivers.serial_port import SerialPort, SerialTransport
from drivers.url import UrlError
from drivers.wire.cobs import CobsEncoder
from simulators.lines import PtyLine

LAYOUT = Layout(("C7", "LSHO"), 120.0)
XYZ = np.float32([[1, 2, 3], [4, 5, 6]])


def usb(device: Path, number: str | None, location: str | None = None) -> SimpleNamespace:
    """A port as pyserial lists it."""
    path = os.path.realpath(device)
    return SimpleNamespace(device=path, serial_number=number, location=location)


@pytest.fixture
def usb_ports(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """What the system says is plugged in."""
    ports: list[SimpleNamespace] = []
    monkeypatch.setattr(list_ports, "comports", lambda: list(ports))
    return ports


def test_a_device_that_comes_back_under_another_name_is_found_by_its_number(
    tmp_path: Path, usb_ports: list[SimpleNamespace]
) -> None:
    first = PtyLine(tmp_path / "ttyUSB0")
    usb_ports.append(usb(first.path, "A1"))
    port = SerialPort(str(first.path), 921_600, SYSTEM_CLOCK)
    port().close()
    # Another device is now where it was, and it is elsewhere.
    other, again = first, PtyLine(tmp_path / "ttyUSB1")
    usb_ports[:] = [usb(other.path, "B2"), usb(again.path, "A1")]
    found = port()
    again.send(b"here")
    received = found.receive(1.0)
    assert received is not None
    assert received.data == b"here"
    found.close()
    usb_ports[:] = [usb(other.path, "B2")]
    with pytest.raises(SourceError, match="USB serial number A1"):
        port()
    for line in (other, again):
        line.close()


def test_a_port_without_a_number_is_opened_by_its_path_again(
    tmp_path: Path, usb_ports: list[SimpleNamespace]
) -> None:
    line = PtyLine(tmp_path / "tracker")
    usb_ports.append(usb(line.path, None))
    port = SerialPort(str(line.path), 921_600, SYSTEM_CLOCK)
    for _ in range(2):
        port().close()
    line.close()


def test_a_closed_port_does_not_drop_the_line_that_resets_boards() -> None:
    device, host = pty.openpty()
    tty.setraw(host)
    attributes = termios.tcgetattr(host)
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(host, termios.TCSANOW, attributes)
    transport = SerialTransport(os.ttyname(host), 9600, SYSTEM_CLOCK)
    assert not termios.tcgetattr(host)[2] & termios.HUPCL
    assert not transport.low_latency  # a pty has no such mode, and that is no error
    transport.close()
    transport.close()
    for end in (device, host):
        os.close(end)


def test_a_real_port_that_goes_silent_is_asked_closed_and_opened_again(tmp_path: Path) -> None:
    line = PtyLine(tmp_path / "tracker")
    encoder = CobsEncoder()
    with open_source(f"serial:{line.path}") as source:
        line.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(0, 0.0, XYZ))
        assert source.read(2.0) is not None
        assert source.read(1.6) is None  # nothing more comes for 1.25 s
        assert source.counters["silences"] == source.counters["reconnects"] == 1
        line.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(1, 0.01, XYZ))
        frame = source.read(2.0)
        assert frame is not None
        assert frame.index == 1
    line.close()


def test_a_device_that_takes_nothing_in_does_not_hold_up_the_reader(tmp_path: Path) -> None:
    device, host = pty.openpty()
    tty.setraw(host)
    os.set_blocking(host, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(host, bytes(4096))  # until nothing more fits in
    transport = SerialTransport(os.ttyname(host), 9600, SYSTEM_CLOCK)
    begun = time.monotonic()
    transport.send(b"hello")
    assert time.monotonic() - begun < 0.5
    os.write(device, b"here")
    assert transport.receive(1.0).data == b"here"
    transport.close()
    for end in (device, host):
        os.close(end)


def test_a_port_that_vanishes_while_ports_are_listed_is_only_not_there_yet(
    tmp_path: Path, usb_ports: list[SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = PtyLine(tmp_path / "ttyUSB0")
    usb_ports.append(usb(line.path, "A1"))
    port = SerialPort(str(line.path), 921_600, SYSTEM_CLOCK)
    port().close()

    def torn() -> list[SimpleNamespace]:
        raise TypeError("int() can't convert non-string with explicit base")  # as pyserial does

    with monkeypatch.context() as patch:
        patch.setattr(list_ports, "comports", torn)
        with pytest.raises(SourceError, match="USB serial number A1"):
            port()
    port().close()
    line.close()


@pytest.mark.parametrize("interfaces", [("1-1:1.0", "1-1:1.2"), (None, None)])
def test_another_port_with_the_same_number_is_not_taken_for_it(
    tmp_path: Path, usb_ports: list[SimpleNamespace], interfaces: tuple[str | None, ...]
) -> None:
    """Both ports of one adapter have its number, and cheap adapters all have number 0001."""
    wanted, other = PtyLine(tmp_path / "ttyUSB0"), PtyLine(tmp_path / "ttyUSB1")
    usb_ports[:] = [
        usb(line.path, "0001", location)
        for line, location in zip((wanted, other), interfaces, strict=True)
    ]
    port = SerialPort(str(wanted.path), 921_600, SYSTEM_CLOCK)
    port().close()
    wanted.close()
    del usb_ports[0]
    with pytest.raises(SourceError):
        port()
    other.close()


@pytest.mark.parametrize("baud", ["0", "-5", "fast", "99999999999"])
def test_a_rate_that_is_none_is_told_as_one(tmp_path: Path, baud: str) -> None:
    line = PtyLine(tmp_path / "tracker")
    with pytest.raises(UrlError, match=f"option baud={baud} is wrong"):
        open_source(f"serial:{line.path}?baud={baud}")
    line.close()
