"""Serial ports that come and go: on a real pty, and with a made-up list of USB devices."""

from __future__ import annotations

import os
import pty
import termios
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
from drivers.wire.cobs import CobsEncoder
from simulators.lines import PtyLine

LAYOUT = Layout(("C7", "LSHO"), 120.0)
XYZ = np.float32([[1, 2, 3], [4, 5, 6]])


def usb(device: Path, number: str | None) -> SimpleNamespace:
    """A port as pyserial lists it."""
    return SimpleNamespace(device=os.path.realpath(device), serial_number=number)


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
