"""Asking silent devices, and coming back from a lost line: on virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.clock import VirtualClock
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


def test_rubbish_that_never_ends_does_not_hold_read_past_its_deadline() -> None:
    clock = VirtualClock()
    plug = Plug(clock)
    source = WireSource("plug", plug.connect, CobsDecoder(), clock)
    for _ in range(1000):
        plug.device.send(b"\x07rubbish\0")
    assert source.read(0.0) is None
    assert 0 < source.counters["bytes"] < 2000 * 9
