"""What goes out, read by other OSC implementations: python-osc and liblo's oscdump."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_message import OscMessage

from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext, SinkError
from bridge.sinks.vmc import VmcSink, _Bundles, _tracker
from drivers.c3d_file import read_c3d, write_c3d
from drivers.frame import Layout
from drivers.udp_sender import AddressError
from drivers.url import Url, UrlError
from tests.end_to_end.peers import Receiver, free_port, wait_for

INFO = Model("default").info
COUNT = len(INFO.labels)
CONTEXT = SinkContext(INFO, lambda index: None, 100.0)


def pose(index: int = 7, t: float = 50.0, seed: int = 0) -> Pose:
    random = np.random.default_rng(seed)
    return Pose(
        index,
        t,
        random.normal(size=(COUNT, 3)).astype(np.float32),
        random.integers(0, 3, COUNT).astype(np.uint8),
        random.random(COUNT).astype(np.float32),
    )


def unknown(index: int = 0) -> Pose:
    return Pose(
        index,
        0.0,
        np.full((COUNT, 3), np.nan, np.float32),
        np.full(COUNT, Provenance.LOST, np.uint8),
        np.full(COUNT, np.inf, np.float32),
    )


def sent(address: str, *poses: Pose) -> list[bytes]:
    with Receiver() as receiver:
        sink = open_sink(address.format(receiver.port), CONTEXT)
        for each in poses:
            sink(each)
        sink.close()
        wait_for(lambda: receiver.datagrams, "datagrams", 5)
    return receiver.datagrams


def test_vmc_is_one_bundle_that_python_osc_reads_back() -> None:
    poses = [pose(i, 50.0 + i / 120, seed=i) for i in range(3)]
    datagrams = sent("vmc://127.0.0.1:{}", *poses)
    assert len(datagrams) == 3
    for datagram, each in zip(datagrams, poses, strict=True):
        assert datagram[8:16] == struct.pack(">Q", 1)  # time tag: immediately
        ok, t, *trackers = list(OscBundle(datagram))
        assert (ok.address, ok.params) == ("/VMC/Ext/OK", [1])
        assert t.address == "/VMC/Ext/T"
        assert t.params == [pytest.approx(each.t - 50.0, abs=1e-6)]
        assert [m.address for m in trackers] == ["/VMC/Ext/Tra/Pos"] * COUNT
        assert [m.params[0] for m in trackers] == list(INFO.labels)
        received = np.float32([m.params[1:] for m in trackers])
        np.testing.assert_array_equal(received[:, :3], each.xyz[:, [0, 2, 1]])
        np.testing.assert_array_equal(received[:, 3:], np.tile([0, 0, 0, 1], (COUNT, 1)))


def test_vmc_says_not_ready_before_the_first_known_pose() -> None:
    (datagram,) = sent("vmc://127.0.0.1:{}", unknown())
    ok, t = list(OscBundle(datagram))
    assert (ok.params, t.params) == ([0], [0.0])


def test_off_loopback_bundles_fit_an_ethernet_packet_and_lose_nothing() -> None:
    trackers = [_tracker(label) for label in INFO.labels]
    bundles = _Bundles(trackers, 1472)
    values = np.arange(7.0 * COUNT)
    parts = [bytes(part) for part in bundles.filled(values)]
    assert len(parts) > 1
    assert max(map(len, parts)) <= 1472
    contents = [message for part in parts for message in OscBundle(part)]
    assert [m.params[0] for m in contents] == list(INFO.labels)
    np.testing.assert_array_equal(np.ravel([m.params[1:] for m in contents]), values)


def test_our_own_pose_is_read_by_python_osc() -> None:
    each = pose()
    layout, message = (OscMessage(d) for d in sent("osc://127.0.0.1:{}", each))
    assert layout.address == "/markerbridge/layout"
    assert layout.params == [100.0, *INFO.labels]
    assert message.address == "/markerbridge/pose"
    index, seconds, letters, *values = message.params
    assert (index, seconds) == (7, 0.0)
    assert letters == "".join("MIEL"[kind] for kind in each.provenance)
    np.testing.assert_array_equal(np.float32(values[: 3 * COUNT]), each.xyz.ravel())
    np.testing.assert_array_equal(np.float32(values[3 * COUNT :]), each.sigma)


def test_the_layout_is_sent_once_a_second() -> None:
    datagrams = sent("osc://127.0.0.1:{}", *[pose(i, i / 10) for i in range(31)])
    kinds = [OscMessage(d).address.rpartition("/")[2] for d in datagrams]
    assert [i for i, kind in enumerate(kinds) if kind == "layout"] == [0, 11, 22, 33]


@pytest.mark.parametrize("scheme", ["vmc", "osc"])
def test_liblos_oscdump_reads_the_same(scheme: str, tmp_path: Path) -> None:
    assert shutil.which("oscdump"), "install Debian's liblo-tools: the README's second command does"
    port, each = free_port(), pose()
    path = tmp_path / "dump.txt"
    with path.open("w") as output:
        dump = subprocess.Popen(["oscdump", "-L", str(port)], stdout=output, stderr=output)
        try:
            sink = open_sink(f"{scheme}://127.0.0.1:{port}", CONTEXT)
            lines: list[str] = []

            def arrived() -> bool:
                sink(each)
                lines[:] = [line for line in path.read_text().splitlines() if "/" in line]
                return sum("/Tra/Pos" in line or "/pose" in line for line in lines) >= (
                    COUNT if scheme == "vmc" else 1
                )

            wait_for(arrived, "oscdump to print", 10)
            sink.close()
        finally:
            dump.kill()
            dump.wait()
    if scheme == "vmc":
        line = next(line for line in lines if '"LFHD"' in line)
        assert "/VMC/Ext/Tra/Pos sfffffff" in line
        numbers = [float(word) for word in line.split('"LFHD"')[1].split()]
        np.testing.assert_allclose(numbers[:3], each.xyz[0, [0, 2, 1]], atol=1e-5)
        assert numbers[3:] == [0, 0, 0, 1]
    else:
        line = next(line for line in lines if "/markerbridge/pose" in line)
        numbers = [float(word) for word in line.split('"')[2].split()]
        np.testing.assert_allclose(numbers[: 3 * COUNT], each.xyz.ravel(), atol=1e-5)


def test_a_receiver_that_is_not_there_costs_nothing() -> None:
    sink = open_sink(f"vmc://127.0.0.1:{free_port()}", CONTEXT)
    for _ in range(100):
        try:
            sink(pose())
        except ConnectionRefusedError:  # the kernel may tell; the outlet counts it
            continue
    sink.close()


def test_a_recording_holds_every_pose_and_lost_ones_as_missing(tmp_path: Path) -> None:
    path = tmp_path / "out.c3d"
    sink = open_sink(f"c3d:{path}", CONTEXT)
    poses = [pose(i, seed=i) for i in (0, 1, 4)]
    for each in poses:
        sink(each)
    sink(unknown(5))
    sink.close()
    sink.close()
    clip = read_c3d(path)
    assert clip.layout.rate == 100.0
    assert len(clip.xyz) == 6  # frames 2 and 3 were never seen, 5 was lost
    assert np.isnan(clip.xyz[[2, 3, 5]]).all()
    np.testing.assert_allclose(clip.xyz[[0, 1, 4]], [p.xyz for p in poses], atol=1e-6)


def test_a_recording_longer_than_c3d_goes_on_in_another_file(tmp_path, monkeypatch) -> None:
    """As C3D counts frames in 16 bits; here it counts to 100."""
    monkeypatch.setattr("bridge.sinks.c3d.MAX_FRAMES", 100)
    sink = open_sink(f"c3d:{tmp_path / 'out.c3d'}", CONTEXT)
    for index in range(250):
        sink(pose(index))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out-2.c3d", "out.c3d"]
    sink.close()
    lengths = [len(read_c3d(path).xyz) for path in sorted(tmp_path.iterdir())]
    assert lengths == [100, 50, 100]  # out-2, out-3, out
    with pytest.raises(ValueError, match="a C3D file counts to 65535"):
        write_c3d(tmp_path / "x.c3d", Layout(("C7",), 120.0), np.ones((65536, 1, 3), np.float32))


def test_a_recording_without_a_pose_leaves_no_file(tmp_path: Path) -> None:
    open_sink(f"c3d:{tmp_path / 'out.c3d'}", CONTEXT).close()
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(SinkError, match="it is a folder"):
        open_sink(f"c3d:{tmp_path}", CONTEXT)
    with pytest.raises(SinkError, match=r"cannot write .*No such file or directory"):
        open_sink(f"c3d:{tmp_path / 'no' / 'out.c3d'}", CONTEXT)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("fax:1", "is no sink: known are vmc, osc, c3d, view"),
        ("vmc://127.0.0.1:1?rat=3", "unknown option rat (known: rate)"),
        ("vmc://127.0.0.1:1?rate=fast", "option rate=fast is wrong"),
        ("vmc://127.0.0.1:1?rate=-5", "option rate=-5 is wrong"),
        ("c3d:", "names no path"),
    ],
)
def test_an_address_that_cannot_be_meant_is_refused(address: str, words: str) -> None:
    with pytest.raises(UrlError) as caught:
        open_sink(address, CONTEXT)
    assert words in str(caught.value)


def test_an_unknown_host_is_refused() -> None:
    with pytest.raises(AddressError, match=r"cannot send to host\.invalid"):
        open_sink("osc://host.invalid:9000", CONTEXT)


def test_default_ports_are_the_protocols() -> None:
    sink = VmcSink(Url.parse("vmc://127.0.0.1"), CONTEXT)
    assert sink._out._address[1] == 39539
    sink.close()
