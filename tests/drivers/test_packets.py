from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.wire.packets import PacketBuffer


def packets(data: bytes, cuts: list[int]) -> list[bytes | None]:
    buffer, taken = PacketBuffer(b"\n", 8), []
    for cut in cuts:
        taken += buffer.feed(data[:cut])
        data = data[cut:]
        assert len(buffer) <= 8
    return taken + buffer.feed(data)


@given(
    st.lists(st.integers(0, 20), max_size=9),
    st.lists(st.binary(max_size=20).map(lambda b: b.replace(b"\n", b"")), max_size=9),
)
def test_packets_are_the_same_however_the_stream_is_cut(cuts, sent) -> None:
    data = b"".join(packet + b"\n" for packet in sent)
    expected = [packet if len(packet) <= 8 else None for packet in sent]
    assert packets(data, cuts) == packets(data, []) == expected


def test_a_packet_that_does_not_end_is_told_once_and_skipped_to_its_end() -> None:
    buffer = PacketBuffer(b"\n", 8)
    assert buffer.feed(b"x" * 9) == [None]
    assert buffer.feed(b"x" * 1000) == []
    assert buffer.feed(b"x\nabc\nde") == [b"abc"]
    buffer.clear()
    assert buffer.feed(b"fg\n") == [b"fg"]
