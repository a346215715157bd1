"""Records of Polhemus trackers. The golden bytes are written out from the record formats of the
maker's manuals, not by our encoder."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drivers.frame import Layout
from drivers.url import Url, UrlError
from drivers.wire.fastrak import FastrakDecoder
from drivers.wire.registry import take_decoder, take_encoder

FORMS = ("", "format=binary", "model=liberty", "model=liberty&format=binary")
LISTS = {
    "": ("2,4,1", "2,0,4,1", "52,54,61,51", "2,5,6,7,11,1"),
    "format=binary": ("2,4,1", "2", "11,2,0", "4,52,51"),
    "model=liberty": ("2,4,1", "8,9,11,3,7,1", "2,6,10,1"),
    "model=liberty&format=binary": ("2,4,1", "8,9,11,3,7", "3,7,8,0"),
}
WIRES = [f"{form}&fields={fields}" for form, lists in LISTS.items() for fields in lists]
LAYOUT = Layout(("1", "2", "4"), 60.0)
XYZ = np.array([[1.5, -2.25, 10.0], [-0.01, 0.0, 123.45], [99.99, -100.5, 7.0]], np.float32)


def wire(options: str):
    url = f"serial:/dev/ttyUSB0?codec=fastrak&{options}".replace("&&", "&").rstrip("&")
    (decoder, _), (encoder, _) = take_decoder(Url.parse(url)), take_encoder(Url.parse(url))
    assert isinstance(decoder, FastrakDecoder)
    return encoder, decoder


def known(options: str):
    """Both ends when the stations are known: after four frames."""
    encoder, decoder = wire(options)
    encoder.encode_layout(LAYOUT)
    for i in range(4):
        decoder.feed(encoder.encode_frame(i, i / 60, XYZ), i / 60)
    decoder.counters.clear()
    return encoder, decoder


def held(options: str) -> bool:
    """Whether a record is believed only when the next one has begun."""
    return "binary" in options and not options.endswith(("1", "51"))


positions = hnp.arrays(np.float32, (3, 3), elements=st.floats(-999, 999, width=16))


@settings(max_examples=20)
@given(st.lists(positions, min_size=1, max_size=5), st.data())
@pytest.mark.parametrize("options", WIRES)
def test_every_frame_survives_the_wire(options, sent, data) -> None:
    encoder, decoder = known(options)
    stream = b""
    for i, xyz in enumerate(sent):
        xyz[1:][data.draw(hnp.arrays(bool, 2))] = np.nan
        stream += encoder.encode_frame(4 + i, (4 + i) / 60, xyz)
    stream += encoder.encode_frame(4 + len(sent), 0.0, XYZ)
    frames = {frame.index: frame for frame in decoder.feed(stream, 0.1)}
    first = 4 if decoder._records._frame is not None else 2  # ours begin with the third frame
    for i, xyz in enumerate(sent):
        frame = frames[first + i]
        assert (frame.layout.labels, frame.t) == (LAYOUT.labels, 0.1)
        np.testing.assert_allclose(frame.xyz, xyz, atol=0.006)  # inches, of which ASCII has two
        if decoder._records._milliseconds is not None:
            assert frame.t_device == pytest.approx((4 + i) / 60, abs=6e-4)
    assert not {"bad_record", "flagged", "replies"} & set(decoder.counters)


GOLDEN = {
    "": b"01    1.50  -2.25  10.00   0.00   0.00   0.00\r\n"
    b"02   -0.01   0.00 123.45   0.00   0.00   0.00\r\n"
    b"04   99.99-100.50   7.00   0.00   0.00   0.00\r\n",
    "format=binary": b"".join(
        b"0" + station + b" " + struct.pack("<6f", *xyz, 0, 0, 0) + b"\r\n"
        for station, xyz in zip((b"1", b"2", b"4"), XYZ.tolist(), strict=True)
    ),
    "model=liberty": b"01    1.500   -2.250   10.000    0.000    0.000    0.000 \r\n"
    b"02   -0.010    0.000  123.450    0.000    0.000    0.000 \r\n"
    b"04   99.990 -100.500    7.000    0.000    0.000    0.000 \r\n",
    "model=liberty&format=binary": b"".join(
        b"LY" + station + b"C \0" + b"\x1a\0" + struct.pack("<6f", *xyz, 0, 0, 0) + b"\r\n"
        for station, xyz in zip((b"\1", b"\2", b"\4"), XYZ.tolist(), strict=True)
    ),
}


@pytest.mark.parametrize("options", GOLDEN)
def test_the_bytes_are_those_of_the_makers_record_formats(options) -> None:
    encoder, decoder = wire(options)
    encoder.encode_layout(LAYOUT)
    assert encoder.encode_frame(5, 0.1, XYZ) == GOLDEN[options]
    received = decoder.feed(GOLDEN[options] * 4, 0.0)
    np.testing.assert_allclose(received[-1].xyz, XYZ, atol=1e-5)
    assert received[-1].layout.labels == ("1", "2", "4")


@pytest.mark.parametrize("options", WIRES)
@settings(max_examples=25)
@given(cuts=st.lists(st.integers(1, 200), min_size=1, max_size=30))
def test_the_cuts_between_reads_do_not_matter(options, cuts) -> None:
    encoder, decoder = wire(options)
    encoder.encode_layout(LAYOUT)
    data = b"".join(encoder.encode_frame(i, i / 60, XYZ + i) for i in range(10))
    received = []
    for cut in cuts:
        received += decoder.feed(data[:cut], 0.0)
        data = data[cut:]
    received += decoder.feed(data, 0.0)
    if held(options):  # the last record waits for another
        received += decoder.feed(encoder.encode_frame(10, 10 / 60, XYZ), 0.0)[:1]
    numbered = decoder._records._frame is not None
    whole = [frame for frame in received if not np.isnan(frame.xyz).any()]
    assert len(whole) >= 7
    for i, frame in enumerate(whole[-7:]):
        np.testing.assert_allclose(frame.xyz, XYZ + (i + 3), atol=2e-3)
        assert not numbered or frame.index == i + 3


@pytest.mark.parametrize("options", WIRES)
@settings(max_examples=100)
@given(noise=st.binary(max_size=200), data=st.data())
def test_whatever_was_on_the_line_the_next_good_frame_is_read(options, noise, data) -> None:
    encoder, decoder = known(options)
    good = encoder.encode_frame(4, 4 / 60, XYZ)
    bad = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        bad[data.draw(st.integers(0, len(bad) - 1))] = data.draw(st.integers(0, 255))
    decoder.feed(noise + bytes(bad[: data.draw(st.integers(0, len(bad)))]), 4 / 60)
    received = []
    for i in (5, 6, 7):
        received += decoder.feed(encoder.encode_frame(i, i / 60, XYZ + 1), i / 60)
    assert any(np.allclose(frame.xyz, XYZ + 1, atol=0.01) for frame in received)


# LIBERTY's text has no columns that we could hold it to.
@pytest.mark.parametrize("options", [w for w in WIRES if not w.startswith("model=liberty&fields")])
@settings(max_examples=100)
@given(at=st.integers(0, 400), lost=st.integers(1, 120))
def test_lost_bytes_never_make_a_false_position(options, at, lost) -> None:
    encoder, decoder = wire(options)
    encoder.encode_layout(LAYOUT)
    stream = b"".join(encoder.encode_frame(i, i / 60, XYZ + i) for i in range(10))
    size = len(encoder.encode_frame(0, 0.0, XYZ)) // 3
    # Just as many as a record has, taken out of the midst of two: nothing could tell.
    assume(lost % size != 0)
    start = 3 * 3 * size + at
    received = decoder.feed(stream[:start] + stream[start + lost :], 0.0)
    sent = {tuple(np.round(xyz, 2)) for i in range(10) for xyz in (XYZ + i).tolist()}
    for frame in received:
        for xyz in frame.xyz[~np.isnan(frame.xyz).any(axis=1)].tolist():
            assert tuple(np.round(xyz, 2)) in sent


@pytest.mark.parametrize("options", FORMS)
def test_a_record_that_cannot_be_meant_is_counted(options) -> None:
    encoder, decoder = wire(options)
    encoder.encode_layout(Layout(("1",), 60.0))
    good = encoder.encode_frame(0, 0.0, XYZ[:1])
    decoder.feed(good * 4, 0.0)
    decoder.counters.clear()
    far = good[:-26] + struct.pack("<6f", 2000, 0, 0, 0, 0, 0) + b"\r\n"
    odd = good[:-26] + struct.pack("<6f", float("nan"), 0, 0, 0, 0, 0) + b"\r\n"
    turned = good[:-26] + struct.pack("<6f", 1, 2, 3, 400, 0, 0) + b"\r\n"
    if "binary" not in options:
        far = good.replace(b"  1.50", b"9999.0")
        odd = good.replace(b"1.50", b" nan")
        turned = good.replace(b"   0.00", b" 400.00", 1)
    assert len(decoder.feed(far + good + odd + good + turned + good, 0.0)) == 3
    assert decoder.counters == {"bad_record": 3}


@pytest.mark.parametrize(
    ("options", "reply"),
    [
        ("", b"21S3F8   F31  2.1.00" + b" " * 32 + b"\r\n"),
        ("format=binary", b"2 E*ERROR*X*ERROR* EC -99 *PS  0 *FL  0 *ST  0\r\n"),
        ("model=liberty", b"00F 0\r\n"),
        ("model=liberty&format=binary", b"LY\0F\0\0\4\0\1\0\0\0"),
        ("model=liberty&format=binary", b"PA\0\x16\0\0\xc8\0" + b"PATRIOT " * 25),
    ],
)
def test_replies_to_commands_are_no_errors(options, reply) -> None:
    encoder, decoder = known(options)
    good = encoder.encode_frame(0, 0.0, XYZ)
    assert len(decoder.feed(reply + reply + good + reply[: len(reply) // 2], 0.0)) == 1
    assert len(decoder.feed(reply[len(reply) // 2 :] + good, 0.0)) == 1
    assert decoder.counters == {"replies": 3}


@pytest.mark.parametrize("options", FORMS)
def test_a_station_that_the_tracker_doubts_is_read_and_counted(options) -> None:
    encoder, decoder = known(options)
    good = encoder.encode_frame(0, 0.0, XYZ)
    at = 4 if options.endswith("liberty&format=binary") else 2
    doubted = good[:at] + b"k" + good[at + 1 :]
    (frame,) = decoder.feed(doubted, 0.0)
    np.testing.assert_allclose(frame.xyz, XYZ, atol=1e-5)
    assert decoder.counters == {"flagged": 1}


def test_stations_that_are_measured_one_after_the_other_are_one_frame() -> None:
    """Four at 120 Hz make 30 frames a second, spread over all of it."""
    encoder, decoder = wire("")
    encoder.encode_layout(Layout(("1", "2", "3", "4"), 30.0))
    received = []
    for i in range(90):
        xyz = np.full((4, 3), i, np.float32)
        if i % 10 == 5:
            xyz[0] = np.nan
        for place, record in enumerate(encoder.encode_frame(i, 0.0, xyz).splitlines(True)):
            received += decoder.feed(record, (i + place / 4) / 30)
    assert len(received) == 88
    assert all(len(set(f.xyz[~np.isnan(f.xyz[:, 0]), 0])) == 1 for f in received)
    assert received[-1].layout.rate == 30


def test_numbers_and_times_of_the_tracker_are_kept() -> None:
    encoder, decoder = known("model=liberty&format=binary&fields=8,9,2,1")
    (before,) = decoder.feed(encoder.encode_frame(1000, 1000 / 240, XYZ), 0.0)
    (after,) = decoder.feed(encoder.encode_frame(1003, 1003 / 240, XYZ), 0.0)
    assert (before.index, after.index) == (1000, 1003)
    assert after.t_device == pytest.approx(1003 / 240, abs=1e-3)


def test_rubbish_takes_no_memory_and_is_counted() -> None:
    for options in FORMS:
        encoder, decoder = wire(options)
        for _ in range(200):
            decoder.feed(b"\xa5" * 1000, 0.0)
        assert len(decoder._buffer) <= 1024
        assert decoder.counters["bad_record"] > 0
        encoder.encode_layout(LAYOUT)
        frames = [decoder.feed(encoder.encode_frame(i, 0.0, XYZ), 0.0) for i in range(5)]
        assert len(frames[-1]) == 1


def test_continuous_output_is_asked_for_in_the_trackers_words() -> None:
    for options, hello in (("", b"C"), ("model=liberty", b"C\r")):
        encoder, decoder = wire(options)
        assert decoder.hello == hello
        assert encoder.has_hello(hello)
        assert not encoder.has_hello(b"\r\n")


def test_only_stations_can_be_sent() -> None:
    encoder, _ = wire("")
    with pytest.raises(ValueError, match="stations 1 to 12, not C7: write for example labels=1:C7"):
        encoder.encode_layout(Layout(("1", "C7"), 60.0))
    with pytest.raises(ValueError, match="not 13"):
        encoder.encode_layout(Layout(("13",), 60.0))
    encoder.encode_layout(Layout(("12", "10", "3"), 60.0))
    assert [r[:2] for r in encoder.encode_frame(0, 0.0, XYZ).splitlines()] == [b"03", b"0A", b"0C"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("model=viper", "known are fastrak, liberty"),
        ("format=hex", "known are ascii, binary"),
        ("fields=4,1", "without a position: put item 2 in"),
        ("fields=2,99,1", "item 99 cannot be read"),
        ("fields=2,4", "ends with item 1"),
        ("fields=2;4", "the list of the command O"),
        ("fields=", "the list of the command O"),
        ("rate=fast", "is no number above 0"),
    ],
)
def test_options_that_cannot_be_meant_are_refused(options, words) -> None:
    with pytest.raises(UrlError) as caught:
        wire(options)
    assert words in str(caught.value)
