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
from drivers.url import Url
from drivers.wire.codec import Decoder
from drivers.wire.osc import OscError, arguments, messages
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder, check_of
from drivers.wire.registry import DIALECTS, take_decoder, take_encoder
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
    assert foreign.params[0] == index
    assert foreign.params[1] & 0xFFFFFFFF == check_of(layout.labels)
    assert foreign.params[2] == microseconds / 1e6
    assert np.array_equal(np.float32(foreign.params[3:]), xyz.ravel(), equal_nan=True)


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
    "5,000 messages": b"#bundle\0" + bytes(8) + (struct.pack(">i", 8) + b"/a\0\0,\0\0\0") * 5000,
    "60,000 type tags": b"/a\0\0," + b"f" * 60_003,
    "address of 60,000 letters": b"/" + b"a" * 60_003 + bytes(4) + b",\0\0\0",
}


def decoder_of(dialect: str) -> Decoder:
    return take_decoder(Url.parse(f"osc://127.0.0.1:9100?dialect={dialect}"))[0]


def cost(read, packet: bytes) -> float:
    """Seconds of CPU, the least of three times: others work on this machine too."""
    seconds = []
    for _ in range(3):
        began = time.thread_time()
        read(packet)
        seconds.append(time.thread_time() - began)
    return min(seconds)


def nested(depth: int) -> bytes:
    packet = b"/a\0\0,\0\0\0"
    for _ in range(depth):
        packet = b"#bundle\0" + bytes(8) + struct.pack(">i", len(packet)) + packet
    return packet


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("packet", KILLERS.values(), ids=KILLERS.keys())
def test_packets_that_kill_other_servers_are_refused_and_counted(dialect, packet) -> None:
    with pytest.raises(OscError):
        messages(packet)
    decoder = decoder_of(dialect)
    assert cost(lambda packet: decoder.feed(packet, 0.0), packet) < 0.01
    assert decoder.feed(packet, 0.0) == []
    assert decoder.counters == {"bad_osc": 4}


HEAVY = {
    "1,024 strangers": [message("/a", ("f", 1.0))] * 1024,
    "1,024 markers": [message(f"/qtm/3d/{i}", *[("f", 1.0)] * 3) for i in range(1024)],
    "900 devices": [
        message("/VMC/Ext/Tra/Pos", ("s", f"{i}"), *[("f", 1.0)] * 7) for i in range(900)
    ],
    "1,000 arguments": [message("/VMC/Ext/OK", *[("s", "x")] * 1000)] * 12,
    "4,000 arguments": [message("/VMC/Ext/OK", *[("s", "x")] * 4000)] * 3,
    "one marker 1,024 times": [message("/marker", ("i", 1), *[("f", 1.0)] * 3)] * 1024,
}


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("contents", HEAVY.values(), ids=HEAVY.keys())
def test_no_packet_costs_more_than_10_ms(dialect, contents) -> None:
    packet = bundle(*contents).dgram
    assert len(packet) < 65_536
    decoder = decoder_of(dialect)
    for i in range(4):  # so often that the labels are believed
        decoder.feed(packet, i / 120)
    assert cost(lambda packet: decoder.feed(packet, 1.0), packet) < 0.01
    assert len(decoder.layout.labels if decoder.layout else ()) <= 255


def test_nesting_is_bounded() -> None:
    assert len(messages(nested(4))) == 1
    for depth in (5, 100, 3000):
        with pytest.raises(OscError, match="nested"):
            messages(nested(depth))


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_bundle_dated_in_the_future_is_not_waited_for(dialect) -> None:
    decoder = decoder_of(dialect)
    encoder, _ = take_encoder(Url.parse(f"osc://127.0.0.1:9100?dialect={dialect}"))
    packets = [encoder.encode_layout(LAYOUT)]
    xyz = np.nan_to_num(XYZ)
    packets += [encoder.encode_frame(i, i / 120, xyz) for i in range(10)]
    read = []
    for i, packet in enumerate(filter(None, packets)):
        if packet.startswith(b"#bundle"):
            dated = b"#bundle\0" + b"\xff" * 8 + packet[16:]
        else:
            dated = b"#bundle\0" + b"\xff" * 8 + struct.pack(">i", len(packet)) + packet
        read += decoder.feed(dated, i / 120)
    assert len(read) >= 7  # where there are no layouts, labels are believed after some frames
    assert same_positions(read[-1].xyz, xyz)


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
        ("bad_packet", message("/markerbridge/layout", ("d", 1.0), ("s", "a" * 256)).dgram),
        (
            "bad_packet",
            message(
                "/markerbridge/layout", ("d", 1.0), *(("s", str(i)) for i in range(1025))
            ).dgram,
        ),
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


def test_a_stream_of_a_hundred_performers_is_read_and_a_larger_one_refused() -> None:
    for count, read in ((1024, 1), (1025, 0)):
        encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
        layout = Layout(tuple(f"p{i // 9}:{i % 9}" for i in range(count)), 120.0)
        xyz = np.arange(3 * count, dtype=np.float32).reshape(-1, 3)
        decoder.feed(encoder.encode_layout(layout), 0.0)
        found = decoder.feed(encoder.encode_frame(0, 0.0, xyz), 0.0)
        assert len(found) == read
        for frame in found:
            assert frame.layout == layout
            np.testing.assert_array_equal(frame.xyz, xyz)
        assert decoder.counters["bad_packet"] == 1 - read


def test_a_frame_before_the_layout_is_counted() -> None:
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    encoder.encode_layout(LAYOUT)
    assert decoder.feed(encoder.encode_frame(0, 0.0, XYZ), 0.0) == []
    assert decoder.counters == {"no_layout": 1}


def test_a_frame_whose_layout_was_lost_is_never_read_with_the_labels_before() -> None:
    encoder, decoder = NativeOscEncoder(), NativeOscDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    encoder.encode_layout(Layout(("RSHO", "C7", "LSHO"), 120.0))  # this one does not arrive
    assert decoder.feed(encoder.encode_frame(1, 0.0, XYZ), 0.0) == []
    assert decoder.counters["layout_mismatch"] == 1


def test_a_sender_that_was_started_anew_needs_no_new_layout_for_the_same_labels() -> None:
    decoder = NativeOscDecoder()
    decoder.feed(NativeOscEncoder().encode_layout(LAYOUT), 0.0)
    again = NativeOscEncoder()
    again.encode_layout(LAYOUT)
    assert len(decoder.feed(again.encode_frame(0, 0.0, XYZ), 0.0)) == 1


def test_names_beyond_ascii_are_read() -> None:
    (read,) = messages(message("/a/H\u00f6ft", ("s", "\u8170")).dgram)
    assert (read.address, arguments(read)) == ("/a/H\u00f6ft", ["\u8170"])


def test_spaces_in_an_address_are_read_as_motive_names_its_bodies() -> None:
    (read,) = messages(message("/rigidBody/Rigid Body #1", ("i", 1)).dgram)
    assert read.address == "/rigidBody/Rigid Body #1"


@pytest.mark.parametrize(
    ("types", "data"),
    [("f", b""), ("ff", bytes(4)), ("", bytes(4)), ("s", b"abcd"), ("[", b""), ("r", bytes(4))],
)
def test_arguments_of_another_length_or_type_are_refused(types: str, data: bytes) -> None:
    packet = b"/a\0\0" + f",{types}".encode().ljust(4, b"\0") + data
    (read,) = messages(packet)
    with pytest.raises(OscError):
        arguments(read)
