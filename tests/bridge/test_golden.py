"""What the engines' sinks send is what was derived by hand, byte for byte.

tests/bridge/golden has it as text, a message per line: address, type tags, arguments. A quarter
turn to the left is, in our world, s = sqrt(1/2) about +z (up). Unity's up is y, and there turning
is the other way round: (0, -s, 0, s). Raising the left arm takes what points left (-x) up: a
quarter about +y (forward), which is Unity's z: (0, 0, -s, s). The arm's rotation in the world is
the first after the second, (1/2, -1/2, -1/2, 1/2) in Unity's space, and in Euler angles that are
applied z, x, y: -90 about z raises it, then -90 about y turns it with the body: (0, -90, -90).
Joints follow by adding up: the left elbow is a quarter metre above the left shoulder, the right one
to the right of its own, which is our +y now.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from bridge.sinks.registry import open_sink
from tests.bridge.poses import CONTEXT, made, pose, standing
from tests.end_to_end.peers import free_port, wait_for

GOLDEN = Path(__file__).parent / "golden"
SCHEMES = ["vmc", "vrchat", "vmt", "qtm-osc", "osc"]


def golden(scheme: str) -> list[tuple[str, str, list[str]]]:
    lines = (GOLDEN / f"{scheme}.txt").read_text().splitlines()
    words = [line.split() for line in lines if not line.startswith("#")]
    return [(address, types, values) for address, types, *values in words]


def encoded(address: str, types: str, values: list[str]) -> bytes:
    """OSC 1.0, written here from its specification."""
    body = b""
    for tag, value in zip(types, values, strict=True):
        if tag == "s":
            body += padded(value)
        else:
            body += struct.pack(f">{tag}", int(value) if tag == "i" else float(value))
    return padded(address) + padded("," + types) + body


def padded(text: str) -> bytes:
    raw = text.encode() + b"\0"
    return raw + b"\0" * (-len(raw) % 4)


def bundled(messages: list[bytes]) -> bytes:
    elements = (struct.pack(">i", len(message)) + message for message in messages)
    return b"#bundle\0" + struct.pack(">Q", 1) + b"".join(elements)  # immediately


def sent(scheme: str) -> bytes:
    """The last datagram of two poses half a second apart."""
    parts = made(f"{scheme}://127.0.0.1:1", standing(0, 50.0), standing(60, 50.5))
    return parts[1][-1]


@pytest.mark.parametrize("scheme", ["vmc", "vmt"])
def test_the_bytes_are_those_derived_by_hand(scheme: str) -> None:
    assert sent(scheme) == bundled([encoded(*line) for line in golden(scheme)])


def test_our_own_pose_is_one_message_with_the_bytes_derived_by_hand() -> None:
    (line,) = golden("osc")
    assert sent("osc") == encoded(*line)


@pytest.mark.parametrize("scheme", ["vrchat", "qtm-osc"])  # angles and millimetres are rounded
def test_addresses_and_types_are_exact_and_numbers_near(scheme: str) -> None:
    datagram, lines = sent(scheme), golden(scheme)
    assert len(datagram) == len(bundled([encoded(*line) for line in lines]))
    assert datagram[:16] == bundled([])
    for message, (address, types, values) in zip(OscBundle(datagram), lines, strict=True):
        assert message.dgram.startswith(padded(address) + padded("," + types))
        assert message.params == pytest.approx([float(value) for value in values], abs=2e-4)


@pytest.mark.parametrize("scheme", ["vmc", "vrchat", "vmt"])
def test_what_is_patched_equals_what_python_osc_builds_anew(scheme: str) -> None:
    for seed in range(3):
        (datagram,) = made(f"{scheme}://127.0.0.1:1", pose(seed=seed))[0]
        anew = OscBundleBuilder(IMMEDIATELY)
        for message in OscBundle(datagram):
            builder = OscMessageBuilder(message.address)
            for value in message.params:
                builder.add_arg(value, {int: "i", float: "f", str: "s"}[type(value)])
            anew.add_content(builder.build())
        assert datagram == anew.build().dgram


@pytest.mark.parametrize("scheme", SCHEMES)
def test_liblos_oscdump_reads_the_same(scheme: str, tmp_path: Path) -> None:
    assert shutil.which("oscdump"), "install Debian's liblo-tools: the README's second command does"
    port, path, lines = free_port(), tmp_path / "dump.txt", golden(scheme)
    printed: list[str] = []
    with path.open("w") as output:
        dump = subprocess.Popen(["oscdump", "-L", str(port)], stdout=output, stderr=output)
        try:
            sink = open_sink(f"{scheme}://127.0.0.1:{port}", CONTEXT)
            sink(standing(0, 50.0))

            def arrived() -> bool:
                sink(standing(60, 50.5))
                dumped = [line.partition(" ")[2] for line in path.read_text().splitlines()]
                printed[:] = [line for line in dumped if "/layout" not in line]
                return len(printed) > 2 * len(lines)

            wait_for(arrived, "oscdump to print", 10)
            sink.close()
        finally:
            dump.kill()
            dump.wait()
    second = printed[len(lines) :]  # the first frame may be that of half a second before
    for line, (address, types, values) in zip(second, lines, strict=False):
        there, tags, *read = line.replace('"', "").split()
        assert (there, tags) == (address, types)
        for tag, found, expected in zip(types, read, values, strict=True):
            assert found == expected if tag == "s" else near(float(found), float(expected))


def near(found: float, expected: float) -> bool:
    return abs(found - expected) < 1e-3  # oscdump prints six digits


def test_an_osc_message_alone_is_read_by_python_osc() -> None:
    each = standing()
    layout, message = (OscMessage(part) for part in made("osc://127.0.0.1:1", each)[0])
    assert layout.address == "/markerbridge/layout"
    assert layout.params == [CONTEXT.rate, *CONTEXT.info.labels]
    assert message.params[:3] == [60, 0.0, "M" * 20 + "E" * 21]
