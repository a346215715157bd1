"""Asking silent devices, and coming back from a lost line: on virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.convention import Convention
from drivers.coordinates import FRAMES
from drivers.frame import Layout, SourceError
from drivers.transport import MemoryTransport, memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire_source import WireSource

LAYOUT = Layout(("C7",), 120.0)
XYZ = np.ones((1, 3), np.float32)


class Plug:
    """A line that can be pulled, and put in again later."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.inside = True
        self.attempts: list[float] = []
        self.device: MemoryTransport | None = None

    def connect(self) -> MemoryTransport:
        self.attempts.append(self.clock.now())
        if not self.inside:
            raise SourceError("no such port")
        host, self.device = memory_line(self.clock)
        return host

    def pull(self) -> None:
        assert self.device is not None
        self.device.close()
        self.inside = False

    def put_in(self) -> None:
        self.inside = True


def test_a_silent_device_is_asked_every_second() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    hellos = []

    def listen() -> None:
        if plug.device.receive(0.0):
            hellos.append(round(clock.now(), 2))
        clock.call_at(clock.now() + 0.01, listen)

    listen()
    assert source.read(5.5) is None
    assert hellos == pytest.approx([0, 1, 2, 3, 4, 5], abs=0.02)


def test_a_line_that_cannot_be_opened_at_first_is_the_callers_to_see() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    plug.inside = False
    with pytest.raises(SourceError, match="no such port"):
        WireSource("plug", plug.connect, CobsDecoder(), clock)


def test_a_lost_line_is_tried_every_100_ms_and_the_stream_goes_on() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(0, 0.0, XYZ))
    assert source.read(0.1) is not None
    whole = encoder.encode_frame(1, 0.0, XYZ)
    plug.device.send(whole[:9])  # the plug comes out in the middle of a frame
    clock.call_at(1.0, plug.pull)
    clock.call_at(3.0, plug.put_in)
    assert source.read(2.5) is None
    retries = np.diff([moment for moment in plug.attempts if moment > 1.1])
    np.testing.assert_allclose(retries, 0.1, atol=1e-6)
    assert source.read(1.0) is None
    assert source.counters["disconnects"] == source.counters["reconnects"] == 1
    assert plug.attempts[-1] - 3.0 <= 0.1 + 1e-6
    assert encoder.has_hello(plug.device.receive(0.0).data)
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(2, 0.0, XYZ))
    frame = source.read(0.1)
    assert frame is not None
    assert frame.index == 2  # and nothing of frame 1's beginning was in the way
    assert not any(name.startswith("bad_") for name in source.counters)


def test_a_line_that_breaks_again_at_once_is_only_another_attempt() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    opened = plug.connect

    def loose() -> MemoryTransport:
        line = opened()
        if len(plug.attempts) < 6:
            plug.device.close()  # gone before the hello is through
        return line

    source._connect = loose
    plug.device.close()
    assert source.read(2.0) is None
    assert source.counters["disconnects"] == 5
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(2, 0.0, XYZ))
    assert source.read(0.1) is not None


def test_another_device_on_the_line_is_not_read_with_the_labels_of_the_first() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    first, second = CobsEncoder(), CobsEncoder()
    plug.device.send(first.encode_layout(LAYOUT) + first.encode_frame(0, 0.0, XYZ))
    assert source.read(0.1) is not None
    plug.pull()
    plug.put_in()
    assert source.read(0.2) is None
    layout = second.encode_layout(Layout(("LTOE",), 120.0))
    plug.device.send(second.encode_frame(7, 0.0, XYZ))
    plug.device.send(layout + second.encode_frame(8, 0.0, XYZ))
    frame = source.read(0.2)
    assert frame is not None
    assert (frame.index, frame.layout.labels) == (8, ("LTOE",))
    assert source.counters["no_layout"] == 1


def test_a_port_that_stays_silent_is_opened_again_after_longer_and_longer() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, reopens=True)
    assert source.read(40.0) is None
    # 1 s of silence and 0.25 s for an answer; then twice as long, 8 s at most.
    waits = np.diff([moment for moment in plug.attempts if moment <= 40])
    np.testing.assert_allclose(waits, [1.25, 2.25, 4.25, 8.25, 8.25, 8.25], atol=1e-6)
    assert source.counters["silences"] == source.counters["reconnects"] == 6
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(0, 0.0, XYZ))
    assert source.read(0.1) is not None
    attempts = len(plug.attempts)
    assert source.read(1.5) is None
    assert len(plug.attempts) == attempts + 1  # patience is short again


def test_an_answer_to_the_question_keeps_the_line_open() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, reopens=True)
    encoder = CobsEncoder()

    def answer() -> None:
        hello = plug.device.receive(0.0)
        if hello and encoder.has_hello(hello.data):
            plug.device.send(encoder.encode_layout(LAYOUT))
        clock.call_at(clock.now() + 0.01, answer)

    answer()
    assert source.read(10.0) is None
    assert source.counters["disconnects"] == 0
    assert source.counters["layouts"] >= 9


def test_frames_come_in_our_words_metres_and_time() -> None:
    clock = VirtualClock(100.0)
    plug = Plug(clock)
    convention = Convention(FRAMES["unreal"], {"neck": "C7"})
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, convention=convention)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(Layout(("neck", "nose"), 120.0)))
    foreign = np.float32([[100, 200, 150], [3e6, 0, 0]])  # the second is 30 km away
    plug.device.send(encoder.encode_frame(0, 7.0, np.nan_to_num(foreign)))
    clock.sleep_until(100.2)  # it is not read at once
    plug.device.send(encoder.encode_frame(1, 7.2, foreign))
    first, second = source.read(0.1), source.read(0.1)
    assert first.layout.labels == ("C7", "nose")
    np.testing.assert_allclose(first.xyz[0], [2, 1, 1.5], rtol=1e-6)
    assert np.isnan(first.xyz[1]).all()
    assert source.counters["out_of_range"] == 2
    assert (first.t_device, first.t_mapped) == (7.0, pytest.approx(100.0))
    assert (second.t_device, second.t_mapped) == (pytest.approx(7.2), pytest.approx(100.2))
    assert first.layout is second.layout


def test_labels_that_do_not_fit_the_stream_are_told(caplog: pytest.LogCaptureFixture) -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    convention = Convention(labels={"neck": "C7", "toe": "LTOE"})
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, convention=convention)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(Layout(("neck",), 120.0)))
    plug.device.send(encoder.encode_frame(0, 0.0, XYZ))
    assert source.read(0.1) is not None
    assert not caplog.text  # a wire without layouts may name it yet
    clock.sleep_until(1.1)
    plug.device.send(encoder.encode_frame(1, 1.1, XYZ))
    assert source.read(0.1) is not None
    assert "names toe, which the stream does not carry (it has neck)" in caplog.text
    plug.device.send(encoder.encode_layout(Layout(("neck", "C7"), 120.0)))
    plug.device.send(encoder.encode_frame(2, 1.2, np.ones((2, 3), np.float32)))
    assert source.read(0.1) is None
    assert "does not fit the stream: marker labels occur twice: C7" in caplog.text
    assert source.counters["bad_layout"] == 1


def test_rubbish_that_never_ends_does_not_hold_read_past_its_deadline() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    for _ in range(1000):
        plug.device.send(b"\x07rubbish\0")
    assert source.read(0.0) is None
    assert 0 < source.counters["bytes"] < 2000 * 9


def test_rubbish_does_not_hold_back_a_frame_that_waits() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, reorder=3)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT))
    for index in (0, 2):  # 1 is lost, 2 waits for it
        plug.device.send(encoder.encode_frame(index, 0.0, XYZ))

    def rubbish() -> None:
        plug.device.send(b"\x07rubbish\0")
        clock.call_at(clock.now() + 0.01, rubbish)

    rubbish()
    assert source.read(0.1).index == 0
    assert source.read(1.0).index == 2
    assert clock.now() < 0.3


def test_a_device_that_comes_back_has_its_own_clock() -> None:
    clock = VirtualClock(1000.0)
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(0, 0.1, XYZ))
    assert source.read(0.1).t_mapped == pytest.approx(1000.0)
    plug.pull()
    clock.call_at(1600.0, plug.put_in)
    assert source.read(601.0) is None
    plug.device.send(encoder.encode_layout(LAYOUT) + encoder.encode_frame(1, 0.2, XYZ))
    frame = source.read(0.1)
    assert frame.t_mapped == pytest.approx(frame.t)
    assert source.counters["clock_jumps"] == 0


def test_a_rate_that_changes_does_not_tell_of_the_labels_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    convention = Convention(labels={"toe": "LTOE"})
    source = WireSource("plug", plug.connect, CobsDecoder(), clock, convention=convention)
    encoder = CobsEncoder()
    for index, rate in enumerate((120.0, 60.0, 120.0, 60.0)):
        plug.device.send(encoder.encode_layout(Layout(("neck",), rate)))
        plug.device.send(encoder.encode_frame(index, 0.0, XYZ))
        assert source.read(0.1).layout.rate == rate
        clock.sleep_until(clock.now() + 1.5)
    assert caplog.text.count("names toe") == 1


def test_a_device_that_starts_anew_on_an_open_line_has_its_own_clock() -> None:
    """A board that was reset: the adapter stays. Its stamps may be later than the last one."""
    clock = VirtualClock(1000.0)
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    encoder = CobsEncoder()
    plug.device.send(encoder.encode_layout(LAYOUT))
    for index in range(9):
        plug.device.send(encoder.encode_frame(index, 0.1 + index / 120, XYZ))
        assert source.read(0.1) is not None
    clock.sleep_until(1600.0)
    for index in range(9):
        clock.sleep_until(1600.0 + index / 120)
        plug.device.send(encoder.encode_frame(index, 0.2 + index / 120, XYZ))
    frame = source.read(0.1)
    assert source.counters["restarts"] == 1
    assert frame.t_mapped == pytest.approx(frame.t)
