"""The guess at a codec or dialect: from each encoder's bytes, cut, spoilt, and from no tracker."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drivers.frame import Layout
from drivers.transport import Received
from drivers.url import Url
from drivers.wire.guess import guess_wire
from drivers.wire.registry import CODECS, DIALECTS, take_encoder

COUNT = 120
RATE = 120.0
BOOT = (
    b"rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    b"configsip: 0, SPIWP:0xee\r\nmode:DIO, clock div:2\r\nload:0x3fff0030,len:1344\r\n"
    b"entry 0x400805f0\r\n[I][main.c:42] setup(): ready 1 2 3\r\n"
    b"$GPGGA,092750.000,5321.6802,N*76\r\n"
)
WIRES = [
    *(("serial", {"codec": name}) for name in CODECS),
    ("serial", {"codec": "slip-osc", "dialect": "qtm"}),
    ("serial", {"codec": "lines", "style": "markers"}),
    ("serial", {"codec": "fastrak", "format": "binary"}),
    ("serial", {"codec": "fastrak", "model": "liberty"}),
    ("serial", {"codec": "fastrak", "model": "liberty", "format": "binary"}),
    *(("osc", {"dialect": name}) for name in DIALECTS),
]


def expected(options: dict[str, str]) -> dict[str, str]:
    """What is to be told: all but how the sender writes its lines."""
    return {name: value for name, value in options.items() if name != "style"}


def sent(scheme: str, options: dict[str, str]) -> list[bytes]:
    """A second and more of walking, as the wire's encoder writes it: a packet a frame."""
    query = "&".join(f"{name}={value}" for name, value in options.items())
    encoder, convention = take_encoder(Url.parse(f"{scheme}:x?{query}"))
    labels = ("1", "2", "3", "4") if "fastrak" in options.values() else ("C7", "LSHO", "RSHO")
    packets = [encoder.encode_layout(Layout(labels, RATE))]
    place = np.arange(3.0 * len(labels)).reshape(-1, 3) / 10
    for index in range(COUNT):
        xyz = convention.xyz_out((place + 0.1 * np.sin(index / 20)).astype(np.float32))
        packets.append(encoder.encode_frame(index, index / RATE, xyz))
    return [packet for packet in packets if packet]


def received(chunks: list[bytes]) -> list[Received]:
    return [Received(chunk, 10 + n / RATE) for n, chunk in enumerate(chunks)]


def cut(stream: bytes, seed: int) -> list[bytes]:
    """The stream in pieces of any length, from somewhere within its first packet."""
    rng = np.random.default_rng(seed)
    places = np.sort(rng.integers(7, len(stream), COUNT))
    return [stream[a:b] for a, b in pairwise(places.tolist()) if b > a]


@pytest.mark.parametrize(("scheme", "options"), WIRES)
def test_each_wire_is_told_from_all_others(scheme: str, options: dict[str, str]) -> None:
    guess = guess_wire(scheme, received(sent(scheme, options)))
    assert guess is not None
    assert dict(guess.options) == expected(options)
    assert guess.good > 0.8 * COUNT
    assert guess.bad == 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("options", [options for scheme, options in WIRES if scheme == "serial"])
def test_a_line_is_told_wherever_it_is_cut_and_with_noise_on_it(
    options: dict[str, str], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    packets = sent("serial", options)
    for place in rng.integers(0, len(packets), 12):
        packets[place] += rng.bytes(5)
    guess = guess_wire("serial", received(cut(b"".join(packets), seed)))
    assert guess is not None
    assert dict(guess.options) == expected(options)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scheme", ["serial", "osc"])
def test_noise_is_nobodys(scheme: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert guess_wire(scheme, received([rng.bytes(200) for _ in range(100)])) is None


@pytest.mark.parametrize("scheme", ["serial", "osc"])
def test_what_a_board_says_when_it_starts_is_nobodys(scheme: str) -> None:
    assert guess_wire(scheme, received([BOOT] * 20)) is None


def test_nothing_is_nobodys() -> None:
    assert guess_wire("serial", []) is None
