from __future__ import annotations

import numpy as np
import pytest
import sliplib
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.coordinates import FRAMES
from drivers.frame import Layout
from drivers.url import Url, UrlError
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from drivers.wire.registry import take_decoder, take_encoder
from drivers.wire.slip import HELLO_PACKET, SlipDecoder, SlipEncoder
from tests.drivers.strategies import frames, layouts, same_positions

LAYOUT = Layout(("C7", "LSHO", "RSHO"), 120.0)
# 0xC0 and 0xDB are among the bytes of these floats.
XYZ = np.array([[-6.0, 2, 3], [np.nan] * 3, [-0.5, 123.857, -1.2e17]], np.float32)


def wire() -> tuple[SlipEncoder, SlipDecoder]:
    return SlipEncoder(NativeOscEncoder()), SlipDecoder(NativeOscDecoder())


@given(layouts().flatmap(lambda layout: st.tuples(st.just(layout), frames(layout))))
def test_every_frame_survives_the_wire_and_sliplib_reads_the_same(case) -> None:
    layout, (index, microseconds, xyz) = case
    encoder, decoder = wire()
    packets = encoder.encode_layout(layout), encoder.encode_frame(index, microseconds / 1e6, xyz)
    (frame,) = decoder.feed(b"".join(packets), 7.0)
    assert frame.layout == layout
    assert (frame.index, frame.t, frame.t_device) == (index, 7.0, microseconds / 1e6)
    assert same_positions(frame.xyz, xyz)
    peer, inner = sliplib.Driver(), NativeOscEncoder()
    peer.receive(b"".join(packets))
    assert peer.get() == inner.encode_layout(layout)
    assert peer.get() == inner.encode_frame(index, microseconds / 1e6, xyz)


@pytest.mark.parametrize("leading", [True, False])
def test_what_sliplib_sends_we_read(leading) -> None:
    with sliplib.use_leading_end_byte(leading):
        peer = sliplib.Driver()
    inner, (_, decoder) = NativeOscEncoder(), wire()
    stream = peer.send(inner.encode_layout(LAYOUT))
    stream += b"".join(peer.send(inner.encode_frame(i, 0.0, XYZ)) for i in range(3))
    received = decoder.feed(stream, 0.0)
    assert [frame.index for frame in received] == [0, 1, 2]
    assert same_positions(received[2].xyz, XYZ)


def test_the_bytes_are_those_of_rfc_1055() -> None:
    assert HELLO_PACKET == b"\xc0/markerbridge/hello\0,\0\0\0\xc0"
    encoder, decoder = wire()
    encoder.encode_layout(Layout(("C7",), 120.0))
    # -6.0 is C0 C0 00 00 as a float32, -1.2e17 is DB D5 29 AF.
    packet = encoder.encode_frame(1, 0.0, np.array([[-6.0, -1.2e17, 0]], np.float32))
    assert packet.startswith(b"\xc0/markerbridge/frame\0,")
    assert packet.endswith(b"\xdb\xdc\xdb\xdc\0\0\xdb\xdd\xd5\x29\xaf" + bytes(4) + b"\xc0")
    assert packet.count(b"\xc0") == 2
    assert decoder.feed(packet, 0.0) == []
    assert decoder.counters == {"no_layout": 1}


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_the_cuts_between_reads_do_not_matter(cuts) -> None:
    encoder, decoder = wire()
    data = encoder.encode_layout(LAYOUT)
    data += b"".join(encoder.encode_frame(i, i / 120, XYZ) for i in range(10))
    received = []
    for cut in cuts:
        received += decoder.feed(data[:cut], 0.0)
        data = data[cut:]
    received += decoder.feed(data, 0.0)
    assert [frame.index for frame in received] == list(range(10))


@settings(max_examples=300)
@given(st.binary(max_size=400), st.data())
def test_whatever_was_on_the_line_the_next_good_frame_is_read(noise, data) -> None:
    """Noise, then a frame cut short, then one with a changed byte, and at once a good one."""
    encoder, decoder = wire()
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    good = encoder.encode_frame(1, 0.0, XYZ)
    cut = good[: data.draw(st.integers(1, len(good) - 2))]
    bad = bytearray(good)
    bad[data.draw(st.integers(1, 20))] ^= data.draw(st.integers(1, 255))  # the address
    before = sum(decoder.counters.values())
    received = decoder.feed(noise + cut + bytes(bad), 0.0)
    assert not received
    assert sum(decoder.counters.values()) > before
    (frame,) = decoder.feed(cut + encoder.encode_frame(2, 0.0, XYZ), 0.0)
    assert frame.index == 2


@pytest.mark.parametrize(
    ("name", "packet"),
    [
        ("bad_slip", b"/a\xdb"),
        ("bad_slip", b"/a\xdbx\0\0\0\0"),
        ("bad_slip", b"\xdb\xdb\xdc"),
        ("bad_osc", b"hello"),
        ("foreign", b"/a\0\0,\0\0\0"),
    ],
)
def test_each_kind_of_bad_packet_is_counted_under_its_name(name, packet) -> None:
    _, decoder = wire()
    assert decoder.feed(b"\xc0" + packet + b"\xc0\xc0\xc0", 0.0) == []
    assert decoder.counters == {name: 1}


def test_a_line_of_noise_without_an_end_takes_no_memory() -> None:
    encoder, decoder = wire()
    for _ in range(200):
        decoder.feed(b"\xa5" * 1000, 0.0)
    assert len(decoder._buffer) <= 65_536
    assert decoder.counters == {"overlong": 1}
    decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    assert len(decoder.feed(encoder.encode_frame(3, 0.0, XYZ), 0.0)) == 1


def test_a_hello_is_found_wherever_the_reads_cut_it() -> None:
    hello = SlipDecoder.hello
    for cut in range(1, len(hello)):
        encoder, _ = wire()
        assert not encoder.has_hello(b"noise" + hello[:cut])
        assert encoder.has_hello(hello[cut:])


def test_a_line_that_was_lost_begins_without_a_layout_or_half_a_packet() -> None:
    encoder, decoder = wire()
    packet = encoder.encode_layout(LAYOUT) + encoder.encode_frame(1, 0.0, XYZ)
    assert decoder.feed(packet + packet[:20], 0.0)
    decoder.reset()
    assert decoder.layout is None
    assert len(decoder.feed(packet, 0.0)) == 1
    assert "bad_osc" not in decoder.counters


def test_another_dialect_brings_its_own_world() -> None:
    url = "serial:/dev/ttyUSB0?codec=slip-osc&dialect=qtm"
    (decoder, convention), (encoder, _) = take_decoder(Url.parse(url)), take_encoder(Url.parse(url))
    assert convention.frame == FRAMES["c3d"]
    sent = np.arange(1, 10, dtype=np.float32).reshape(3, 3) * 100
    received = decoder.feed(encoder.encode_layout(LAYOUT), 0.0)
    for i in range(5):
        received = decoder.feed(encoder.encode_frame(i, i / 120, sent), i / 120)
    rows = [received[0].layout.labels.index(label) for label in LAYOUT.labels]
    np.testing.assert_allclose(received[0].xyz[rows], sent)
    _, convention = take_decoder(Url.parse(url + "&frame=ros"))
    assert convention.frame == FRAMES["ros"]
    with pytest.raises(UrlError, match="dialect=qtx is wrong: known are native, qtm"):
        take_decoder(Url.parse("serial:/dev/ttyUSB0?codec=slip-osc&dialect=qtx"))
