"""Whom an OSC source listens to: allowed senders, several of them, and QTM, which is asked."""

from __future__ import annotations

import contextlib
import logging
import socket
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frame import Layout, MarkerFrame, SourceError
from drivers.osc_udp import RECEIVE_BUFFER, OscSource, UdpTransport, parse_networks
from drivers.ownership import Ownership, Verdict
from drivers.registry import open_source
from drivers.transport import Received
from drivers.url import Url, UrlError
from drivers.wire.osc import arguments, build, build_bundle, messages, sized
from drivers.wire.osc_native import NativeOscEncoder

LAYOUT = Layout(("C7", "LSHO"), 120.0)
OTHER = Layout(("LSHO", "C7"), 120.0)
XYZ = np.ones((2, 3), np.float32)
A, B, C = "10.0.0.1:1000", "10.0.0.1:2000", "10.0.0.2:1000"


def open_osc(options: str = "", host: str = "127.0.0.1", clock=None) -> OscSource:
    address = f"osc://{host}:0{'?' + options if options else ''}"
    source = open_source(address, clock) if clock else open_source(address)
    assert isinstance(source, OscSource)
    return source


@contextlib.contextmanager
def sender(port: int, host: str = "127.0.0.1") -> Iterator[socket.socket]:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as end:
        end.bind((host, 0))
        end.connect((host, port))
        yield end


class Line:
    """A UDP line on virtual time: datagrams of senders as one names them."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.source = open_osc(clock=clock)
        assert self.source._transport is not None
        self.source._transport.close()
        self.source._transport = self  # type: ignore[assignment]
        self._waiting: list[Received] = []

    def receive(self, timeout: float) -> Received | None:
        return self._waiting.pop(0) if self._waiting else None

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...

    def put(self, sender: str, t: float, *packets: bytes) -> list[MarkerFrame]:
        """What the source makes of packets that come at `t`."""
        self._clock.sleep_until(t)
        self._waiting += [Received(packet, t, sender) for packet in packets]
        frames = []
        while (frame := self.source.read(0.0)) is not None:
            frames.append(frame)
        return frames


@pytest.fixture
def line() -> Line:
    return Line(VirtualClock())


def stream(layout: Layout, first: int, count: int) -> list[bytes]:
    encoder = NativeOscEncoder()
    packets = [encoder.encode_layout(layout)]
    return packets + [encoder.encode_frame(first + i, i / 120, XYZ) for i in range(count)]


def verdicts(*heard: tuple[str, float]) -> list[Verdict]:
    ownership = Ownership()
    return [ownership.hear(name, t) for name, t in heard]


def test_an_established_owner_keeps_the_stream_until_it_is_silent_for_a_second() -> None:
    told = verdicts(
        (A, 0.0), (A, 0.1), (A, 0.2), (B, 1.1), (C, 1.1), (A, 1.15), (B, 2.15), (A, 2.2)
    )
    take, refuse = Verdict.TAKE, Verdict.REFUSE
    assert told[:6] == [take, take, take, refuse, refuse, take]
    assert told[6:] == [Verdict.START_ANEW, Verdict.TAKE_OVER]


def test_senders_of_single_packets_follow_each_other() -> None:
    told = verdicts(*((f"10.0.0.1:{port}", port / 1000) for port in range(1000, 1100)))
    assert set(told[1:]) == {Verdict.TAKE_OVER}


def test_another_machine_starts_anew() -> None:
    assert verdicts((A, 0.0), (C, 0.01))[1] is Verdict.START_ANEW


def test_of_two_that_begin_together_one_prevails() -> None:
    told = verdicts(*((name, i / 120) for i in range(20) for name in (A, B)))
    assert told[6::2] == [Verdict.TAKE] * 17
    assert told[5::2] == [Verdict.REFUSE] * 18


def test_the_memory_of_senders_is_bounded() -> None:
    ownership = Ownership()
    for port in range(10_000):
        ownership.hear(f"10.0.0.1:{port}", 0.0)
    assert len(ownership._packets) <= 64


def test_a_second_sender_is_not_mixed_in_and_named_once(
    line: Line, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert len(line.put(A, 0.0, *stream(LAYOUT, 0, 5))) == 5
        for i in range(20):
            assert line.put(B, 0.01 * i, *stream(OTHER, 500, 1)) == []
    frames = line.put(A, 0.5, *stream(LAYOUT, 5, 2)[1:])
    assert [(frame.index, frame.layout) for frame in frames] == [(5, LAYOUT), (6, LAYOUT)]
    assert line.source.counters["other_sender"] == 40
    (said,) = [record.getMessage() for record in caplog.records if "sends to" in record.message]
    assert A in said
    assert B in said
    assert "allow" in said


def test_a_flood_of_other_senders_floods_no_log(
    line: Line, caplog: pytest.LogCaptureFixture
) -> None:
    line.put(A, 0.0, *stream(LAYOUT, 0, 5))
    with caplog.at_level(logging.WARNING):
        for port in range(3000):
            line.put(f"10.0.0.9:{port}", 0.1, b"x")
    assert len(caplog.records) <= 16
    assert line.source.counters["other_sender"] == 3000


def test_who_follows_a_sender_that_fell_silent_starts_anew(line: Line) -> None:
    line.put(A, 0.0, *stream(LAYOUT, 1000, 5))
    layout, *frames = stream(OTHER, 0, 3)
    assert line.put(B, 1.5, *frames) == []
    assert line.source.counters["no_layout"] == 3  # never read with the labels of the other
    assert [frame.index for frame in line.put(B, 1.6, layout, *frames)] == [0, 1, 2]
    assert line.source.counters["sender_changes"] == 1
    assert line.source.counters["missing"] == 0


def test_frames_that_wait_for_a_late_one_are_not_lost_with_their_sender() -> None:
    clock = VirtualClock()
    line = Line(clock)
    line.source._sequence._depth = 2
    layout, *frames = stream(LAYOUT, 0, 4)
    line.put(A, 0.0, build_bundle([sized(layout), sized(frames[0])]))
    assert line.put(A, 0.01, frames[2]) == []
    read = line.put(C, 0.02, *stream(LAYOUT, 7, 1))
    assert [frame.index for frame in read] == [2, 7]


def test_a_program_started_for_each_message_is_one_sender(line: Line) -> None:
    packets = stream(LAYOUT, 0, 30)
    read = []
    for i, packet in enumerate(packets):
        read += line.put(f"127.0.0.1:{40000 + i}", i / 10, packet)
    assert [frame.index for frame in read] == list(range(30))
    assert line.source.counters["sender_changes"] == 30


def test_only_allowed_senders_are_read() -> None:
    with open_osc("allow=10.0.0.0/8") as refusing, sender(refusing.port) as end:
        for packet in stream(LAYOUT, 0, 100):
            end.send(packet)
        assert refusing.read(0.05) is None
        assert refusing.counters["refused"] == 101
        assert refusing.counters["bytes"] == 0
    with open_osc("allow=10.0.0.1,127.0.0.1") as source, sender(source.port) as end:
        for packet in stream(LAYOUT, 0, 3):
            end.send(packet)
        assert [source.read(1.0).index for _ in range(3)] == [0, 1, 2]
        assert source.counters["refused"] == 0


def test_a_flood_of_refused_datagrams_holds_no_reader_up() -> None:
    with open_osc("allow=10.0.0.1") as source, sender(source.port) as end:
        for _ in range(300):
            end.send(b"x")
        assert source._transport.receive(0.0) is None
        assert 0 < source.counters["refused"] < 300


@pytest.mark.parametrize("wrong", ["10.0.0.300", "10.0.0.1/33", "studio-pc", ""])
def test_a_wrong_entry_of_allow_is_named(wrong: str) -> None:
    with pytest.raises(UrlError, match=rf"option allow=.*'{wrong}' is no address") as caught:
        OscSource(Url("osc://x", "osc", "", "127.0.0.1", 0, {"allow": f"10.0.0.1,{wrong}"}), None)
    assert caught.value.exit_status == 2


def test_networks_are_hosts_and_ranges() -> None:
    assert [str(each) for each in parse_networks("10.0.0.1, 192.168.2.7/24,fe80::/10")] == [
        "10.0.0.1/32",
        "192.168.2.0/24",
        "fe80::/10",
    ]


def has_ipv6() -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as end:
        end.bind(("::1", 0))
        return True
    return False


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
def test_ipv6_and_ipv4_senders_are_told_apart_on_one_socket() -> None:
    with open_osc(host="[::1]") as source, sender(source.port, "::1") as end:
        for packet in stream(LAYOUT, 0, 1):
            end.send(packet)
        assert source.read(1.0) is not None
        assert source.ownership.owner == f"[::1]:{end.getsockname()[1]}"
    with open_osc("allow=127.0.0.0/8", host="[::]") as source, sender(source.port) as end:
        for packet in stream(LAYOUT, 0, 1):
            end.send(packet)
        assert source.read(1.0) is not None


def test_listening_to_everybody_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "drivers.osc_udp"):
        with open_osc():
            pass
        with open_osc("allow=127.0.0.1", host="0.0.0.0"):
            pass
        assert not [record for record in caplog.records if "everybody" in record.message]
        with open_osc(host="0.0.0.0") as source:
            source._lose()
            source.read(0.05)
    said = [record for record in caplog.records if "everybody" in record.message]
    assert len(said) == 1
    assert source.counters["reconnects"] == 1


def test_the_receive_buffer_that_was_granted_is_told() -> None:
    with open_osc() as source:
        assert 0 < source.receive_buffer <= 2 * RECEIVE_BUFFER


def test_the_kernels_buffer_holds_a_second_of_120_hz() -> None:
    """What is sent while nobody reads: as much as the buffer asked for allows."""
    with open_osc() as source, sender(source.port) as end:
        for packet in stream(Layout(tuple(f"M{i}" for i in range(9)), 120.0), 0, 0):
            end.send(packet)
        encoder = NativeOscEncoder()
        encoder.encode_layout(Layout(tuple(f"M{i}" for i in range(9)), 120.0))
        for i in range(120):
            end.send(encoder.encode_frame(i, i / 120, np.ones((9, 3), np.float32)))
        assert [source.read(1.0).index for _ in range(120)] == list(range(120))


class FakeQtm:
    """Answers commands as QTM's server does, and keeps them."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(2.0)
        self.port = self._socket.getsockname()[1]

    def hear(self) -> str:
        (message,) = messages(self._socket.recv(4096))
        assert message.address == "/qtm"
        (command,) = arguments(message)
        return command

    def send(self, port: int, packet: bytes) -> None:
        self._socket.sendto(packet, ("127.0.0.1", port))

    def close(self) -> None:
        self._socket.close()


def test_qtm_is_asked_for_its_markers_and_told_to_stop() -> None:
    with contextlib.closing(FakeQtm()) as qtm:
        source = open_osc(f"dialect=qtm&control=127.0.0.1:{qtm.port}")
        with source:
            assert qtm.hear() == f"Connect {source.port}"
            assert qtm.hear() == "StreamFrames AllFrames 3D"
            qtm.send(source.port, build("/qtm/cmd_res", ("s", "Connected")))
            assert source.read(0.05) is None
            assert source.counters["answers"] == 1
        assert qtm.hear() == "StreamFrames Stop"
        assert qtm.hear() == "Disconnect"


def test_qtm_is_asked_again_after_a_second_of_silence() -> None:
    clock = VirtualClock()
    with (
        contextlib.closing(FakeQtm()) as qtm,
        open_osc(f"dialect=qtm&control=127.0.0.1:{qtm.port}", clock=clock) as source,
    ):
        asked = [f"Connect {source.port}", "StreamFrames AllFrames 3D"]
        assert [qtm.hear() for _ in range(2)] == asked
        clock.sleep_until(1.01)
        source.read(0.0)
        assert [qtm.hear() for _ in range(2)] == asked


def test_a_qtm_that_cannot_send_to_us_is_named() -> None:
    with pytest.raises(SourceError, match=r"192\.0\.2\.1 cannot send to 127\.0\.0\.1: listen on"):
        open_osc("dialect=qtm&control=192.0.2.1")
    with pytest.raises(SourceError, match="cannot find no-such-host"):
        open_osc("dialect=qtm&control=no-such-host.invalid", host="0.0.0.0")


def test_a_network_that_is_down_does_not_close_the_socket(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with (
        contextlib.closing(FakeQtm()) as qtm,
        open_osc(f"dialect=qtm&control=127.0.0.1:{qtm.port}") as source,
    ):
        transport = source._transport
        monkeypatch.setattr(transport, "_peer", ("255.255.255.255", 9))  # not without asking
        source._say_hello()
        source._say_hello()
        assert source._transport is transport
        assert source.counters["unsent"] == 2
        assert source.counters["disconnects"] == 0
    assert len([record for record in caplog.records if "cannot send to QTM" in record.message]) == 1


def test_a_transport_with_nothing_to_read_waits_no_longer_than_told() -> None:
    clock = VirtualClock()
    with contextlib.closing(UdpTransport("127.0.0.1", 0, clock)) as transport:
        assert transport.receive(0.01) is None


@pytest.mark.parametrize("chatter", [build("/heartbeat", ("i", 1)), b"GET / HTTP/1.1\r\n\r\n"])
@pytest.mark.parametrize("host", [B, C])
def test_who_sends_nothing_of_use_does_not_keep_the_stream_from_its_owner(
    line: Line, host: str, chatter: bytes
) -> None:
    for i in range(50):  # it was there first
        assert line.put(host, 0.01 * i, chatter) == []
    packets = [*stream(LAYOUT, 0, 100), *stream(LAYOUT, 100, 100)]  # a layout once a second
    frames = []
    for i, packet in enumerate(packets):
        frames += line.put(A, 0.5 + 0.01 * i, packet)
        frames += line.put(host, 0.505 + 0.01 * i, chatter)
    assert [frame.index for frame in frames[-100:]] == list(range(100, 200))


def test_qtm_is_asked_again_though_others_talk(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(line.source, "_say_hello", lambda: asked.append(1))
    for i in range(50):
        line.put(B, 0.1 * i, build("/heartbeat", ("i", 1)))
    assert len(asked) >= 4
    asked.clear()
    for i, packet in enumerate(stream(LAYOUT, 0, 50)):
        line.put(A, 6.0 + 0.1 * i, packet)
    assert len(asked) <= 1
