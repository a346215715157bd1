from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame import Layout
from drivers.wire.cobs import HELLO_PACKET, CobsDecoder, CobsEncoder
from tests.drivers.strategies import frames, layouts, same_positions

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
XYZ = np.array([[1, 2, 3], [np.nan] * 3, [-0.5, 0, 4]], np.float32)


@given(layouts().flatmap(lambda layout: st.tuples(st.just(layout), frames(layout))))
def test_every_frame_survives_the_wire(case) -> None:
    layout, (index, microseconds, xyz) = case
    encoder, decoder = CobsEncoder(), CobsDecoder()
    data = encoder.encode_layout(layout) + encoder.encode_frame(index, microseconds / 1e6, xyz)
    (frame,) = decoder.feed(data, 7.0)
    assert frame.layout == layout
    assert (frame.index, frame.t, round(frame.t_device * 1e6)) == (index, 7.0, microseconds)
    assert same_positions(frame.xyz, xyz)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_the_cuts_between_reads_do_not_matter(cuts, start) -> None:
    encoder, decoder = CobsEncoder(), CobsDecoder()
    data = encoder.encode_layout(LAYOUT)
    for i in range(10):
        data += encoder.encode_frame((start + i) % 2**32, i / 120, XYZ)
    received = []
    for cut in cuts:
        received += decoder.feed(data[:cut], 0.0)
        data = data[cut:]
    received += decoder.feed(data, 0.0)
    assert [frame.index for frame in received] == [(start + i) % 2**32 for i in range(10)]


@settings(max_examples=300)
@given(st.binary(max_size=400), st.data())
def test_whatever_was_on_the_line_the_next_good_frame_is_read(noise, data) -> None:
    """Noise, then a frame cut short, then a frame with a changed byte, then a good frame."""
    encoder, decoder = CobsEncoder(), CobsDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    good = encoder.encode_frame(1, 0.0, XYZ)
    cut = good[: data.draw(st.integers(1, len(good) - 2))]
    at = data.draw(st.integers(0, len(good) - 2))
    bad = bytearray(good)
    bad[at] ^= data.draw(st.integers(1, 255))
    before = sum(decoder.counters.values())
    received = decoder.feed(noise + b"\0" + cut + b"\0" + bytes(bad) + b"\0", 0.0)
    assert not received
    assert sum(decoder.counters.values()) > before
    (frame,) = decoder.feed(encoder.encode_frame(2, 0.0, XYZ), 0.0)
    assert frame.index == 2


@given(st.integers(2, 60))
def test_a_frame_that_was_cut_swallows_no_good_one(lost: int) -> None:
    encoder, decoder = CobsEncoder(), CobsDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    assert decoder.feed(encoder.encode_frame(1, 0.0, XYZ)[:-lost], 0.0) == []
    (frame,) = decoder.feed(encoder.encode_frame(2, 0.0, XYZ), 0.0)
    assert frame.index == 2


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("bad_crc", lambda packet: packet[:-1] + bytes([packet[-1] ^ 1])),
        ("bad_crc", lambda packet: packet[:3]),
        ("bad_version", lambda packet: b"\x09" + packet[1:]),
        ("bad_packet", lambda packet: packet[:1] + b"\x05" + packet[2:]),
        ("bad_packet", lambda packet: packet[:2] + b"\x01" + packet[3:]),
        ("bad_packet", lambda packet: packet[:15] + b"\xff" + packet[16:]),
        ("layout_mismatch", lambda packet: packet[:1] + b"\x30" + packet[2:]),
    ],
)
def test_each_kind_of_bad_packet_is_counted_under_its_name(name, spoil) -> None:
    import zlib

    from cobs import cobs

    encoder, decoder = CobsEncoder(), CobsDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    body = cobs.decode(encoder.encode_frame(1, 0.0, XYZ)[1:-1])[:-4]
    sealed = body + zlib.crc32(body).to_bytes(4, "little")
    spoilt = spoil(sealed)
    if name != "bad_crc":  # a sender that means what it says: its checksum is right
        spoilt = spoilt[:-4] + zlib.crc32(spoilt[:-4]).to_bytes(4, "little")
    assert decoder.feed(cobs.encode(spoilt) + b"\0", 0.0) == []
    assert decoder.counters[name] == 1


def test_a_frame_before_the_layout_is_counted() -> None:
    encoder, decoder = CobsEncoder(), CobsDecoder()
    encoder.encode_layout(LAYOUT)
    assert decoder.feed(encoder.encode_frame(1, 0.0, XYZ), 0.0) == []
    assert decoder.counters == {"no_layout": 1}


def test_a_frame_of_the_layout_before_is_never_read_with_the_new_labels() -> None:
    encoder, decoder = CobsEncoder(), CobsDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    old = encoder.encode_frame(1, 0.0, XYZ)
    decoder.feed(encoder.encode_layout(Layout(("RSHO", "LSHO", "C7"), 120.0)), 0.0)
    assert decoder.feed(old, 0.0) == []
    assert decoder.counters["layout_mismatch"] == 1
    (frame,) = decoder.feed(encoder.encode_frame(2, 0.0, XYZ), 0.0)
    assert frame.layout.labels[0] == "RSHO"


def test_a_line_of_noise_without_an_end_takes_no_memory() -> None:
    decoder = CobsDecoder()
    for _ in range(200):
        decoder.feed(b"\xa5" * 1000, 0.0)
    assert len(decoder._buffer) <= 17_384
    assert decoder.counters["overlong"] == 1
    encoder = CobsEncoder()
    decoder.feed(b"\0" + encoder.encode_layout(LAYOUT), 0.0)
    assert len(decoder.feed(encoder.encode_frame(3, 0.0, XYZ), 0.0)) == 1


def test_a_hello_is_found_wherever_the_reads_cut_it() -> None:
    hello = CobsDecoder.hello
    for cut in range(len(hello)):
        encoder = CobsEncoder()
        assert not encoder.has_hello(b"noise" + hello[:cut])
        assert encoder.has_hello(hello[cut:])
    assert HELLO_PACKET in hello


def test_positions_that_are_no_numbers_are_refused() -> None:
    encoder, decoder = CobsEncoder(), CobsDecoder()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    infinite = XYZ.copy()
    infinite[0, 0] = np.inf
    assert decoder.feed(encoder.encode_frame(1, 0.0, infinite), 0.0) == []
    assert decoder.counters["bad_packet"] == 1


def test_labels_that_the_wire_cannot_carry_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 255 markers"):
        CobsEncoder().encode_layout(Layout(tuple(f"m{i}" for i in range(256)), 120.0))


@pytest.mark.parametrize("label", ["\x1b[2J", "C7\n", "\x7f"])
def test_a_label_that_would_upset_a_terminal_is_none(label: str) -> None:
    decoder = CobsDecoder()
    decoder.feed(CobsEncoder().encode_layout(Layout((label,), 120.0)), 0.0)
    assert decoder.layout is None
    assert decoder.counters["bad_packet"] == 1
