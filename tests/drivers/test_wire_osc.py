"""Our OSC against python-osc, an independent implementation, and against hostile packets."""

from __future__ import annotations

import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from drivers.frame import Layout
from drivers.wire.osc import OscError, arguments, messages
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from tests.drivers.strategies import frames, layouts, same_positions

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
XYZ = np.array([[1, 2, 3], [np.nan] * 3, [-0.5, 0, 4]], np.float32)

_VALUES = st.one_of(
    st.integers(-(2**31), 2**31 - 1).map(lambda v: ("i", v)),
    st.floats(width=32, allow_nan=False).map(lambda v: ("f", v)),
    st.floats(allow_nan=False).map(lambda v: ("d", v)),
    st.text(st.characters(min_codepoint=32, max_codepoint=126)).map(lambda v: ("s", v)),
    st.binary(min_size=1, max_size=40).map(lambda v: ("b", v)),
    st.booleans().map(lambda v: ("T" if v else "F", v)),
)


def message(address: str, *values: tuple[str, object]) -> OscMessage:
    builder = OscMessageBuilder(address)
    for kind, value in values:
        builder.add_arg(value, kind)
    return builder.build()


def bundle(*contents) -> OscBundle:
    builder = OscBundleBuilder(IMMEDIATELY)
    for content in contents:
        builder.add_content(content)
    return builder.build()


@given(st.lists(_VALUES, max_size=12))
def test_what_python_osc_builds_we_read(values) -> None:
    (read,) = messages(message("/a/b", *values).dgram)
    assert read.address == "/a/b"
    assert arguments(read) == [value for _, value in values]


def test_bundles_in_bundles_are_read_in_order() -> None:
    one, two, three = (message(f"/{n}", ("i", n)) for n in (1, 2, 3))
    packet = bundle(one, bundle(two, bundle(three))).dgram
    assert [m.address for m in messages(packet)] == ["/1", "/2", "/3"]


@given(layouts().flatmap(lambda layout: st.tuples(st.just(layout), frames(layout))))
def test_every_frame_survives_the_wire_and_python_osc_reads_the_same(case) -> None:
    layout, (index, microseconds, xyz) = case
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    assert decoder.feed(encoder.encode_layout(layout), 0.0) == []
    datagram = encoder.encode_frame(index, microseconds / 1e6, xyz)
    (frame,) = decoder.feed(datagram, 7.0)
    assert frame.layout == layout
    assert (frame.index, frame.t, frame.t_device) == (index, 7.0, microseconds / 1e6)
    assert same_positions(frame.xyz, xyz)
    foreign = OscMessage(datagram)
    assert foreign.address == "/markerbridge/frame"
    assert foreign.params[:2] == [index, microseconds / 1e6]
    assert np.array_equal(np.float32(foreign.params[2:]), xyz.ravel(), equal_nan=True)


KILLERS = {
    "element of size -4": b"#bundle\0" + bytes(8) + struct.pack(">i", -4),
    "element of size 0": b"#bundle\0" + bytes(8) + struct.pack(">i", 0),
    "element past the end": b"#bundle\0" + bytes(8) + struct.pack(">i", 400) + b"/a\0\0,\0\0\0",
    "bad UTF-8": b"/\xff\xfe\0,\0\0\0",
    "pattern": b"/" + b"*" * 30 + b"\0,\0\0\0",
    "bare bundle": b"#bundle\0",
    "no type tags": b"/abc\0\0\0\0",
    "odd length": b"/abc\0\0\0",
    "empty": b"",
    "string without an end": b"/abcdefg",
    "not padded with zeros": b"/a\0x,\0\0\0",
}


def nested(depth: int) -> bytes:
    packet = b"/a\0\0,\0\0\0"
    for _ in range(depth):
        packet = b"#bundle\0" + bytes(8) + struct.pack(">i", len(packet)) + packet
    return packet


@pytest.mark.parametrize("packet", KILLERS.values(), ids=KILLERS.keys())
def test_packets_that_kill_other_servers_are_refused_and_counted(packet) -> None:
    with pytest.raises(OscError):
        messages(packet)
    decoder = NativeOscDecoder()
    assert decoder.feed(packet, 0.0) == []
    assert decoder.counters == {"bad_osc": 1}


def test_nesting_is_bounded() -> None:
    assert len(messages(nested(4))) == 1
    for depth in (5, 100, 3000):
        with pytest.raises(OscError, match="nested"):
            messages(nested(depth))


def test_a_bundle_dated_in_the_future_is_not_waited_for() -> None:
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    packet = encoder.encode_layout(LAYOUT)
    dated = b"#bundle\0" + b"\xff" * 8 + struct.pack(">i", len(packet)) + packet
    began = time.process_time()
    decoder.feed(dated, 0.0)
    assert decoder.layout == LAYOUT
    assert time.process_time() - began < 1.0


@settings(max_examples=500)
@given(st.data())
def test_no_changed_packet_does_harm_and_the_next_good_one_is_read(data) -> None:
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    layout = encoder.encode_layout(LAYOUT)
    decoder.feed(layout, 0.0)
    frame = encoder.encode_frame(1, 0.5, XYZ)
    joined = bundle(OscMessage(layout), OscMessage(frame)).dgram
    bad = bytearray(data.draw(st.sampled_from([layout, frame, joined])))
    for _ in range(data.draw(st.integers(1, 8))):
        bad[data.draw(st.integers(0, len(bad) - 1))] = data.draw(st.integers(0, 255))
    decoder.feed(bytes(bad[: data.draw(st.integers(0, len(bad)))]), 0.0)
    decoder.feed(layout, 0.0)
    (read,) = decoder.feed(frame, 0.0)
    assert read.index == 1
    assert same_positions(read.xyz, XYZ)


@pytest.mark.parametrize(
    ("name", "packet"),
    [
        ("foreign", message("/somebody/else", ("f", 1.0)).dgram),
        ("bad_packet", message("/markerbridge/frame", ("s", "x"), ("d", 0.0)).dgram),
        ("bad_packet", message("/markerbridge/frame", ("i", 1), ("d", 0.0), ("f", 1.0)).dgram),
        ("bad_packet", message("/markerbridge/frame", ("i", 1)).dgram),
        ("bad_packet", message("/markerbridge/frame", ("i", 1), ("d", float("nan"))).dgram),
        ("bad_packet", message("/markerbridge/layout", ("d", 0.0), ("s", "C7")).dgram),
        ("bad_packet", message("/markerbridge/layout", ("d", 120.0), ("i", 1)).dgram),
        ("bad_packet", message("/markerbridge/layout", ("d", 120.0)).dgram),
        ("bad_packet", message("/markerbridge/layout", ("d", 1.0), ("s", "a"), ("s", "a")).dgram),
        ("layout_mismatch", message("/markerbridge/frame", ("i", 1), ("d", 0.0)).dgram),
    ],
)
def test_what_is_osc_but_not_ours_is_counted_under_its_name(name, packet) -> None:
    decoder = NativeOscDecoder()
    decoder.feed(NativeOscEncoder().encode_layout(LAYOUT), 0.0)
    assert decoder.feed(packet, 0.0) == []
    assert decoder.counters[name] == 1
    assert decoder.layout == LAYOUT


def test_a_sender_without_doubles_is_understood() -> None:
    decoder = NativeOscDecoder()
    decoder.feed(NativeOscEncoder().encode_layout(LAYOUT), 0.0)
    values = [("f", float(v)) for v in np.nan_to_num(XYZ).ravel()]
    (frame,) = decoder.feed(
        message("/markerbridge/frame", ("i", 5), ("f", 0.25), *values).dgram, 0.0
    )
    assert (frame.index, frame.t_device) == (5, 0.25)


def test_a_frame_before_the_layout_is_counted() -> None:
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    encoder.encode_layout(LAYOUT)
    assert decoder.feed(encoder.encode_frame(0, 0.0, XYZ), 0.0) == []
    assert decoder.counters == {"no_layout": 1}
