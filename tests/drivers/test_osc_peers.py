"""Foreign programs over a real UDP port: liblo's oscsend and oscdump, and python-osc both ways."""

from __future__ import annotations

import contextlib
import re
import select
import shutil
import socket
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from pythonosc.dispatcher import Dispatcher
from pythonosc.osc_server import BlockingOSCUDPServer
from pythonosc.udp_client import SimpleUDPClient

from drivers.frame import Layout, MarkerFrame
from drivers.osc_udp import OscSource
from drivers.registry import open_source
from drivers.udp_sender import UdpSender
from drivers.url import Url
from drivers.wire.osc import build
from drivers.wire.registry import DIALECTS, take_encoder

LAYOUT = Layout(("1", "2"), 60.0)  # labels that every dialect can carry
XYZ = np.float32([[1, 2, 3], [-1, 0.5, 0]])


def open_osc(dialect: str) -> OscSource:
    source = open_source(f"osc://127.0.0.1:0?dialect={dialect}")
    assert isinstance(source, OscSource)
    return source


def send(port: int, *message: str) -> None:
    """One datagram, by a process of its own."""
    assert shutil.which("oscsend"), "install Debian's liblo-tools: the README's second command does"
    subprocess.run(["oscsend", "127.0.0.1", str(port), *message], check=True)


def test_liblos_oscsend_is_understood() -> None:
    with open_osc("native") as source:
        send(source.port, "/markerbridge/layout", "dss", "60", "C7", "LSHO")
        frame = ("idffffff", "9", "1.5", "1", "2", "3", "-1", "0.5", "0")
        send(source.port, "/markerbridge/frame", *frame)
        received = source.read(5.0)
    assert received is not None
    assert (received.index, received.t_device) == (9, 1.5)
    assert received.layout.labels == ("C7", "LSHO")
    assert received.layout.rate == 60.0
    np.testing.assert_array_equal(received.xyz, np.float32([[1, 2, 3], [-1, 0.5, 0]]))


# What oscsend sends of one marker, its label, and where our world has it (metres, Z up).
SENT = {
    "qtm": (("/qtm/3d/Left Hand", "fff", "1000", "2000", "3000"), "Left Hand", (1, 2, 3)),
    "natnet": (
        (
            "/rigidBody/Body 1",
            "isfffffffi",
            "4",
            "Body 1",
            *["1", "3", "-2", "0", "0", "0", "1", "1"],
        ),
        *("Body 1", (1, 2, 3)),
    ),
    "vmc": (
        ("/VMC/Ext/Tra/Pos", "sfffffff", "LHR-1", *["1", "3", "2", "0", "0", "0", "1"]),
        *("LHR-1", (1, 2, 3)),
    ),
    "vrchat": (("/tracking/trackers/head/position", "fff", "1", "3", "2"), "head", (1, 2, 3)),
}


@pytest.mark.parametrize("dialect", SENT)
def test_liblos_oscsend_speaks_each_dialect(dialect: str) -> None:
    message, label, place = SENT[dialect]
    with open_osc(dialect) as source:
        for _ in range(4):
            send(source.port, *message)
        received = source.read(5.0)
    assert received is not None
    assert received.layout.labels == (label,)
    np.testing.assert_allclose(received.xyz, [place], rtol=1e-6)


def test_python_oscs_client_is_understood() -> None:
    """It knows no doubles unless told, and sends the time as a float."""
    with open_osc("native") as source, client(source.port) as peer:
        peer.send_message("/markerbridge/layout", [120.0, "C7"])
        peer.send_message("/markerbridge/frame", [3, 0.25, 1.0, 2.0, 3.0])
        received = source.read(5.0)
    assert received is not None
    assert (received.index, received.t_device) == (3, 0.25)
    np.testing.assert_array_equal(received.xyz, np.float32([[1, 2, 3]]))


@contextlib.contextmanager
def client(port: int) -> Iterator[SimpleUDPClient]:
    peer = SimpleUDPClient("127.0.0.1", port)
    yield peer
    peer._sock.close()


PEERS = {
    "qtm": lambda x: [("/qtm/3d/A", [1000 * x, 0.0, 0.0]), ("/qtm/3d/B", [1000 * x, 0.0, 0.0])],
    "natnet": lambda x: [("/marker", [1, x, 0.0, 0.0]), ("/marker", [2, x, 0.0, 0.0])],
    "vmc": lambda x: [
        ("/VMC/Ext/T", [x]),
        ("/VMC/Ext/Tra/Pos", ["A", x, *[0.0] * 6]),
        ("/VMC/Ext/Hmd/Pos", ["B", x, *[0.0] * 6]),
    ],
    "vrchat": lambda x: [(f"/tracking/trackers/{i}/position", [x, 0.0, 0.0]) for i in (1, 2)],
}


@pytest.mark.parametrize("dialect", PEERS)
def test_python_oscs_client_speaks_each_dialect_marker_by_marker(dialect: str) -> None:
    received: list[MarkerFrame] = []
    with open_osc(dialect) as source, client(source.port) as peer:
        for i in range(20):
            for address, values in PEERS[dialect](i / 64):
                peer.send_message(address, values)
            while (frame := source.read(0.002)) is not None:
                received.append(frame)
    assert len(received) >= 15
    for frame in received[-10:]:
        assert frame.xyz.shape == (2, 3)
        assert frame.xyz[0, 0] == frame.xyz[1, 0]  # both of one moment


def packets(dialect: str) -> list[bytes]:
    """What our simulator sends: a layout where the dialect has one, and a frame."""
    encoder, _ = take_encoder(Url.parse(f"osc://127.0.0.1:1?dialect={dialect}"))
    layout = encoder.encode_layout(LAYOUT)
    return [*filter(None, [layout]), encoder.encode_frame(7, 1.5, XYZ)]


# What a reader of what we send should see: address, and the numbers among its arguments.
WRITTEN = {
    "native": [("/markerbridge/layout", [60]), ("/markerbridge/frame", [7, 1.5, *XYZ.ravel()])],
    "qtm": [
        ("/qtm/data", [0, 1_500_000, 0, 7, 0, 0, 2]),
        ("/qtm/3d/1", [1, 2, 3]),
        ("/qtm/3d/2", [-1, 0.5, 0]),
    ],
    "natnet": [("/marker", [1, 1, 2, 3]), ("/marker", [2, -1, 0.5, 0])],
    "vmc": [
        ("/VMC/Ext/OK", [1]),
        ("/VMC/Ext/T", [1.5]),
        ("/VMC/Ext/Tra/Pos", [1, 2, 3, 0, 0, 0, 1]),
        ("/VMC/Ext/Tra/Pos", [-1, 0.5, 0, 0, 0, 0, 1]),
    ],
    "vrchat": [
        ("/tracking/trackers/1/position", [1, 2, 3]),
        ("/tracking/trackers/2/position", [-1, 0.5, 0]),
    ],
}


def without_check(address: str, numbers: list[float]) -> list[float]:
    """A native frame's second number is the check of its labels."""
    return [numbers[0], *numbers[2:]] if address == "/markerbridge/frame" else numbers


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        port: int = end.getsockname()[1]
        return port


def dumped(packets: list[bytes], count: int) -> list[str]:
    """The lines that oscdump prints of packets, as soon as it listens."""
    port = free_port()
    with (
        subprocess.Popen(["oscdump", "-L", str(port)], stdout=subprocess.PIPE, text=True) as dump,
        contextlib.closing(UdpSender("127.0.0.1", port)) as out,
    ):
        assert dump.stdout is not None
        try:
            for _ in range(100):
                out.send(build("/ready"))
                if select.select([dump.stdout], [], [], 0.05)[0]:
                    break
            for packet in packets:
                out.send(packet)
            lines: list[str] = []
            while len(lines) < count:
                line = dump.stdout.readline()
                assert line
                lines += [] if "/ready" in line else [line]
            return lines
        finally:
            dump.kill()


@pytest.mark.parametrize("dialect", DIALECTS)
def test_liblos_oscdump_reads_what_we_send(dialect: str) -> None:
    read = []
    for line in dumped(packets(dialect), len(WRITTEN[dialect])):
        _, address, _, *numbers = re.sub(r'"[^"]*"', "", line).split()  # a time tag, types
        read.append((address, without_check(address, [float(number) for number in numbers])))
    assert read == [(address, pytest.approx(list(n), abs=1e-5)) for address, n in WRITTEN[dialect]]


@pytest.mark.parametrize("dialect", DIALECTS)
def test_python_oscs_server_reads_what_we_send(dialect: str) -> None:
    read: list[tuple[str, list[float]]] = []

    def note(address: str, *values: object) -> None:
        numbers = [float(value) for value in values if isinstance(value, (int, float))]
        read.append((address, without_check(address, numbers)))

    dispatcher = Dispatcher()
    dispatcher.set_default_handler(note)
    sent = packets(dialect)
    with BlockingOSCUDPServer(("127.0.0.1", 0), dispatcher) as server:
        server.timeout = 5.0
        out = UdpSender(*server.server_address)
        for packet in sent:
            out.send(packet)
            server.handle_request()
        out.close()
    assert read == [(address, pytest.approx(list(n), abs=1e-5)) for address, n in WRITTEN[dialect]]
