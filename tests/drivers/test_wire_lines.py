from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame import Layout
from drivers.url import Url, UrlError
from drivers.wire.lines import LinesDecoder, LinesEncoder, is_label
from drivers.wire.registry import take_decoder
from tests.drivers.strategies import frames, layouts, same_positions

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
XYZ = np.array([[1, 2, 3], [np.nan] * 3, [-0.5, 0, 4]], np.float32)
WHOLE = np.array([[1, 2, 3], [0.1, 1e-9, -7], [-0.5, 0, 4]], np.float32)


def decoder(warm: int = 3, **options) -> LinesDecoder:
    """One that knows the labels."""
    encoder, decoder = LinesEncoder(), LinesDecoder(**options)
    encoder.encode_layout(LAYOUT)
    for i in range(warm):
        decoder.feed(encoder.encode_frame(i, i / 120, WHOLE), i / 120)
    decoder.counters.clear()
    return decoder


def unsigned(text: str, times: int = 3) -> LinesDecoder:
    """One that has read a frame in lines without checksum and index."""
    decoder = LinesDecoder()
    for _ in range(times):
        decoder.feed(text.encode(), 0.0)
    return decoder


carried = layouts().filter(lambda layout: all(map(is_label, layout.labels)))


@given(carried.flatmap(lambda layout: st.tuples(st.just(layout), frames(layout))))
def test_every_frame_survives_the_wire(case) -> None:
    layout, (index, microseconds, xyz) = case
    encoder, decoder = LinesEncoder(), LinesDecoder(rate=layout.rate)
    assert encoder.encode_layout(layout) == b""
    here = np.nan_to_num(xyz)
    for i in range(3):
        decoder.feed(encoder.encode_frame(i, i - 3.0, here), 0.0)
    (frame,) = decoder.feed(encoder.encode_frame(index, microseconds / 1e6, xyz), 7.0)
    assert frame.layout == layout
    assert (frame.index, frame.t) == (index, 7.0)
    assert frame.t_device == pytest.approx(microseconds / 1e6, abs=1e-6)
    assert same_positions(frame.xyz, xyz)


def test_the_bytes_are_as_documented() -> None:
    encoder = LinesEncoder()
    encoder.encode_layout(LAYOUT)
    line = encoder.encode_frame(7, 0.125, XYZ)
    body = b"#7 @0.125000 C7 1 2 3 RSHO -0.5 0 4"
    checksum = 0
    for byte in body:
        checksum ^= byte
    assert line == body + b"*%02X\n" % checksum
    encoder = LinesEncoder(by_marker=True)
    encoder.encode_layout(LAYOUT)
    assert encoder.encode_frame(7, 0.125, XYZ) == b"C7 1 2 3\nRSHO -0.5 0 4\n\n"


@pytest.mark.parametrize(
    "text",
    [
        "#7 @0.5 C7 1 2 3 LSHO .1 1e-9 -7 RSHO -.5 0 4.0\n",
        "@.5 #7 C7\t1 2 3,LSHO,0.1,0.000000001,-7.00 , RSHO -0.5 +0 4\r\n",
        "#7 @0.5 C7 1 2 3 LSHO 0.1 1e-9 -7 RSHO -0.5 0 4*72  \r\n",
    ],
)
def test_a_frame_line_may_be_written_in_several_ways(text) -> None:
    (frame,) = unsigned(text, 2).feed(text.encode(), 1.0)
    assert (frame.index, frame.t_device, frame.t) == (7, 0.5, 1.0)
    assert frame.layout.labels == LAYOUT.labels
    assert same_positions(frame.xyz, WHOLE)


@pytest.mark.parametrize("lost", ["LSHO\n", "LSHO nan\n", "LSHO NaN nan nan\n", ""])
@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_lines_of_one_marker_each_make_frames(lost, end) -> None:
    text = "C7 1 2 3\nLSHO 0.1 1e-9 -7\nRSHO -0.5 0 4\n" + end
    decoder, received = LinesDecoder(), []
    for i in range(6):
        received += decoder.feed(text.encode(), i / 60)
    received += decoder.feed(text.replace("LSHO 0.1 1e-9 -7\n", lost).encode() + b"\n", 0.1)
    assert len(received) == 5
    assert [frame.index for frame in received] == [0, 1, 2, 3, 4]
    assert same_positions(received[0].xyz, WHOLE)
    assert same_positions(received[4].xyz, XYZ)
    assert np.isnan(received[4].t_device)


@given(st.lists(st.integers(1, 60), min_size=1, max_size=30), st.booleans())
def test_the_cuts_between_reads_do_not_matter(cuts, by_marker) -> None:
    encoder, host = LinesEncoder(by_marker=by_marker), LinesDecoder()
    encoder.encode_layout(LAYOUT)
    data = b"".join(encoder.encode_frame(i, i / 120, WHOLE + i) for i in range(12))
    received = []
    for cut in cuts:
        received += host.feed(data[:cut], 0.0)
        data = data[cut:]
    received += host.feed(data, 0.0)
    assert len(received) == 10
    for i, frame in enumerate(received):
        assert same_positions(frame.xyz, WHOLE + (i + 2))


@settings(max_examples=300)
@given(st.binary(max_size=400), st.data())
def test_whatever_was_on_the_line_the_next_good_frame_is_read(noise, data) -> None:
    """Noise, then a frame cut short, then one with a changed byte, then a good one."""
    encoder, host = LinesEncoder(), decoder()
    encoder.encode_layout(LAYOUT)
    good = encoder.encode_frame(10, 0.1, XYZ)
    cut = good[: data.draw(st.integers(1, len(good) - 2))]
    bad = bytearray(good)
    bad[data.draw(st.integers(0, len(good) - 5))] ^= data.draw(st.integers(1, 255))
    received = host.feed(noise + b"\n" + cut + b"\n" + bytes(bad) + b"\n", 0.1)
    assert not received
    assert host.counters["bad_checksum"] + host.counters["bad_line"] >= 2
    (frame,) = host.feed(encoder.encode_frame(11, 0.11, XYZ), 0.11)
    assert frame.index == 11
    assert same_positions(frame.xyz, XYZ)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("bad_checksum", b"#1 @0 C7 1 2 3*00"),
        ("bad_line", b"C7 1 2"),
        ("bad_line", b"C7 1 2 3 4"),
        ("bad_line", b"C7 1 2 three"),
        ("bad_line", b"C7 1 2 inf"),
        ("bad_line", b"C7 1 2 1e39"),
        ("bad_line", b"C7 1 2 1_0"),
        ("bad_line", b"C7 1 2 3 C7 4 5 6"),
        ("bad_line", b"C7 1 2 3 #x 4 5 6"),
        ("bad_line", b"#1 #2 C7 1 2 3"),
        ("bad_line", b"#-1 C7 1 2 3"),
        ("bad_line", b"#1.5 C7 1 2 3"),
        ("bad_line", b"#" + b"9" * 5000 + b" C7 1 2 3"),
        ("bad_line", b"@nine C7 1 2 3"),
        ("bad_line", b"@inf C7 1 2 3"),
        ("bad_line", b"@nan C7 1 2 3"),
        ("bad_line", b"C\xc37 1 2 3"),
        ("bad_line", b"C\x007 1 2 3"),
        ("bad_line", b"\x1c"),
        ("bad_line", b"Ready."),
        ("bad_line", b"ets Jun  8 2016 00:22:57"),
        ("bad_line", b"rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)"),
        ("bad_line", b" ".join(b"m%d 1 2 3" % i for i in range(256))),
        ("overlong", b"C7 1 2 3 " * 4000),
    ],
)
def test_each_kind_of_bad_line_is_counted_under_its_name(name, line) -> None:
    host = unsigned("C7 1 2 3 LSHO 4 5 6\n")
    host.counters.clear()
    assert host.feed(line + b"\n", 0.0) == []
    assert host.counters == {name: 1}
    assert len(host.feed(b"C7 1 2 3 LSHO 4 5 6\n", 0.0)) == 1


def test_a_checksum_may_be_required() -> None:
    host = LinesDecoder(required=True)
    for _ in range(20):
        assert host.feed(b"C7 1 2 3 LSHO 4 5 6\n", 0.0) == []
    assert host.counters == {"bad_checksum": 20}
    assert host.feed(b"C7 1 2 3 LSHO 4 5 6*4B\n" * 3, 0.0) != []


def test_a_line_that_lost_its_checksum_or_index_is_not_believed() -> None:
    host = decoder()
    assert host.feed(b"#4 @0.04 C7 1 2 3\n", 0.0) == []
    assert host.counters == {"bad_checksum": 1}
    host = unsigned("#4 C7 1 2 3\n")
    host.counters.clear()
    assert host.feed(b"C7 1 2 3 LSHO 4 5 6\nRSHO 1 2 3\n", 0.0) == []
    assert host.counters == {"bad_line": 2}
    for _ in range(7):
        assert host.feed(b"C7 1 2 3 LSHO 4 5 6\n", 0.0) == []
    assert len(host.feed(b"C7 1 2 3 LSHO 4 5 6\n", 0.0)) == 1  # that is how they are now


def test_a_label_is_believed_when_it_has_come_three_times() -> None:
    host = unsigned("C7 1 2 3 LSHO 4 5 6\n")
    for i in range(3):
        (frame,) = host.feed(b"C7 1 2 3 LSHO 4 5 6 NEW 7 8 9\n", 0.1 * i)
        assert frame.layout.labels == ("C7", "LSHO", "NEW")[: 2 + (i == 2)]
    (frame,) = host.feed(b"LSHO 4 5 6 GHOST 0 0 0\n", 0.4)
    assert frame.layout.labels == ("C7", "LSHO", "NEW")
    assert np.isnan(frame.xyz[[0, 2]]).all()


def test_a_frame_in_which_nothing_is_seen_is_a_frame() -> None:
    (frame,) = unsigned("#4 @1 C7 1 2 3\n").feed(b"#5 @1.1\n", 0.0)
    assert frame.index == 5
    assert np.isnan(frame.xyz).all()


def test_a_line_of_noise_without_an_end_takes_no_memory() -> None:
    host = decoder()
    for _ in range(200):
        host.feed(b"\xa5" * 1000, 0.0)
    assert len(host._buffer) <= 32_768
    assert host.counters == {"overlong": 1}


def test_labels_that_the_wire_cannot_carry_are_refused() -> None:
    for label in ("left hand", "a,b", "*1", "#1", "@1", "Kopf\xe4"):
        with pytest.raises(ValueError, match="a line carries labels"):
            LinesEncoder().encode_layout(Layout((label,), 120.0))


def test_options_that_cannot_be_meant_are_refused() -> None:
    for option in ("checksum=never", "rate=0"):
        with pytest.raises(UrlError, match="is wrong"):
            take_decoder(Url.parse(f"serial:x?codec=lines&{option}"))
    host, _ = take_decoder(Url.parse("serial:x?codec=lines&rate=100&checksum=required"))
    for i in range(3):
        received = host.feed(b"C7 1 2 3 LSHO 4 5 6*4B\n", 5.0 * i)
    assert not received  # three times, but not within two seconds
    received = host.feed(b"C7 1 2 3 LSHO 4 5 6*4B\n" * 3, 20.0)
    assert received[-1].layout.rate == 100
