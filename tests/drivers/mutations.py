"""Spoilt packets by the million: what no driver may be knocked over by.

A wire's corpus is what its encoder sends (layouts, frames whole and with markers missing), what the
other dialects send, and packets that are known to kill other programs. Each spoilt packet goes
through the real source, and after it good ones that have to be read.
"""

from __future__ import annotations

import gc
import random
import resource
import struct
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.clock import VirtualClock
from drivers.convention import Convention
from drivers.frame import Floats, Layout
from drivers.transport import Received
from drivers.url import Url
from drivers.wire.codec import Encoder
from drivers.wire.registry import CODECS, DIALECTS, take_decoder, take_encoder
from drivers.wire_source import WireSource

LABELS = ("C7", "LSHO", "RSHO", "LWRB", "RWRB", "LANK", "RANK", "RSHN", "RBWT")
RATE = 120.0
GOOD = 2  # good frames after each spoilt packet; the last one must be read
SLOW = 0.010  # s of CPU that no packet may cost

# fastrak and vrchat have places and not names.
_PLACES = {
    "fastrak": [str(place) for place in range(1, 10)],
    "vrchat": [*(str(place) for place in range(1, 9)), "head"],
}
ADDRESSES = {
    **{name: f"serial:/dev/none?codec={name}" for name in CODECS},
    "fastrak-binary": "serial:/dev/none?codec=fastrak&format=binary",
    "liberty": "serial:/dev/none?codec=fastrak&model=liberty",
    "liberty-binary": "serial:/dev/none?codec=fastrak&model=liberty&format=binary",
    **{name: f"osc://127.0.0.1:9100?dialect={name}" for name in DIALECTS},
}


def address(name: str) -> str:
    """The address of a wire, with the markers mapped to its places where it has no names."""
    places = _PLACES.get("vrchat" if name == "vrchat" else "fastrak")
    if name not in ("fastrak", "fastrak-binary", "liberty", "liberty-binary", "vrchat"):
        return ADDRESSES[name]
    assert places is not None
    pairs = ",".join(f"{place}:{label}" for place, label in zip(places, LABELS, strict=True))
    return f"{ADDRESSES[name]}&labels={pairs}"


class Sender:
    """A device's end: good packets of frames that carry their own truth."""

    def __init__(self, name: str) -> None:
        self.encoder: Encoder
        self.convention: Convention
        self.encoder, self.convention = take_encoder(Url.parse(address(name)))
        self.layout = Layout(LABELS, RATE)
        self.index = 0

    def lay_out(self) -> bytes:
        return self.encoder.encode_layout(self.convention.layout_out(self.layout))

    def frame(self, xyz: Floats | None = None) -> bytes:
        """The next frame; without positions a frame that tells its index."""
        self.index += 1
        xyz = self.truth(self.index) if xyz is None else xyz
        return self.encoder.encode_frame(
            self.index, self.index / RATE, self.convention.xyz_out(xyz)
        )

    @staticmethod
    def truth(index: int) -> Floats:
        """Positions that occur in this frame alone (of some thousand)."""
        marker = np.arange(len(LABELS))
        rows = [marker * 0.1 - 0.4, np.full(len(LABELS), index % 1000 * 0.001), 1 + marker * 0.01]
        return np.stack(rows, axis=1).astype(np.float32)


class Feed:
    """The host's end: hands on what it is given."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self.packets: list[bytes] = []

    def receive(self, timeout: float) -> Received | None:
        if not self.packets:
            return None
        return Received(self.packets.pop(0), self._clock.now(), "127.0.0.1:5000")

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


@dataclass
class Outcome:
    """What a run found. unaccounted: packets that gave neither a frame nor a count. deaf_after:
    packets after which good ones were not read. slow: packets that cost
    more than 10 ms of CPU. grown: bytes of memory from a tenth of the run to its end.
    """

    packets: int = 0
    unaccounted: list[bytes] = field(default_factory=list)
    deaf_after: list[bytes] = field(default_factory=list)
    slow: list[bytes] = field(default_factory=list)
    grown: int = 0
    seconds: float = 0.0
    counters: Counter[str] = field(default_factory=Counter)


def corpus(name: str) -> list[bytes]:
    """Good packets of a wire, for a dialect those of all dialects."""
    names = list(DIALECTS) if name in DIALECTS else [name]
    packets: list[bytes] = []
    for each in names:
        sender = Sender(each)
        packets += [sender.lay_out(), sender.frame(), sender.frame()]
        holed = Sender.truth(3)
        holed[[1, 4, 8]] = np.nan
        packets += [sender.frame(holed), sender.frame(np.full((9, 3), np.nan, np.float32))]
    return [packet for packet in packets if packet]


def _nested(depth: int) -> bytes:
    packet = b"/a\0\0,\0\0\0"
    for _ in range(depth):
        packet = b"#bundle\0" + bytes(8) + struct.pack(">i", len(packet)) + packet
    return packet


KILLERS = [
    b"#bundle\0" + bytes(8) + struct.pack(">i", -4),  # loops python-osc for ever
    b"#bundle\0" + bytes(8) + struct.pack(">i", 0) * 1000,
    b"/\xff\xfe\0,\0\0\0",
    b"/" + b"*" * 30 + b"\0,\0\0\0",
    _nested(100),
    _nested(2000),
    b"#bundle\0" + bytes(8) + (struct.pack(">i", 8) + b"/a\0\0,\0\0\0") * 5000,
    b"/a\0\0," + b"[" * 60_003,
    b"/a\0\0," + b"f" * 60_003,
    b"/a\0\0,b\0\0\x7f\xff\xff\xff",
    b"#bundle\0" + b"\xff" * 8 + struct.pack(">i", 8) + b"/a\0\0,\0\0\0",
]


_WORDS = (b"\xff\xff\xff\xfc", b"\x7f\xff\xff\xff", b"\0\0\0\0", b"\x7f\xc0\0\0")


def mutate(rng: random.Random, packets: list[bytes]) -> bytes:
    """One of the packets, spoilt in one to four ways."""
    packet = bytearray(rng.choice(packets))
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        kind = rng.randrange(9)
        at = rng.randrange(len(packet)) if packet else 0
        if kind == 0 and packet:
            packet[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and packet:
            packet[at] = rng.randrange(256)
        elif kind == 2:
            del packet[at:]  # cut
        elif kind == 3:
            del packet[: at + 1]  # its beginning is lost
        elif kind == 4:
            packet[at:at] = rng.randbytes(rng.randrange(1, 9))
        elif kind == 5:
            del packet[at : at + rng.randrange(1, 9)]
        elif kind == 6:
            other = rng.choice(packets)
            packet[at:] = other[rng.randrange(len(other)) :]
        elif kind == 7 and len(packet) >= 4:  # a number that is too large, negative, no number
            word = rng.choice(_WORDS)
            at -= at % 4
            packet[at : at + 4] = word
        else:
            packet += packet[at : at + rng.randrange(1, 200)]
        del packet[70_000:]
    return bytes(packet)


def run(name: str, count: int, seed: int = 0) -> Outcome:
    """Sends `count` spoilt packets over a wire; what did not go as it must is in the outcome."""
    rng = random.Random(f"{name} {seed}")
    clock = VirtualClock()
    feed = Feed(clock)
    sender, packets = Sender(name), corpus(name)
    decoder, convention = take_decoder(Url.parse(address(name)))
    source = WireSource(name, lambda: feed, decoder, clock, convention=convention)
    outcome = Outcome()

    def play(packet: bytes) -> list[Floats]:
        """What is read of a packet; its cost goes into the outcome."""
        feed.packets.append(packet)
        if not packet:
            return []
        feed.packets.append(packet)
        frames = []
        began = time.thread_time()
        while (frame := source.read(0.0)) is not None:
            frames.append(frame.xyz)
        seconds = time.thread_time() - began
        if seconds > SLOW and _cost(name, packet) > SLOW:  # and not once by chance
            outcome.slow.append(packet)
        return frames

    def good() -> bool:
        """Good frames; whether the last of them was read."""
        read: list[Floats] = []
        for _ in range(GOOD):
            clock.sleep_until(clock.now() + 1 / RATE)
            read = play(sender.frame())
        wanted = Sender.truth(sender.index)
        return any(_same(xyz, wanted, source.labels) for xyz in read)

    lay_out = sender.lay_out()
    for _ in range(4):
        play(lay_out)
        good()
    usual = Counter({"frames": GOOD})
    known = source.labels
    began = time.monotonic()
    memory = 0
    for number in range(count):
        if number == count // 10:
            memory = _memory()
        spoilt = mutate(rng, KILLERS if name in DIALECTS and number % 20 == 0 else packets)
        before = source.counters.copy()
        clock.sleep_until(clock.now() + 1 / RATE)
        play(spoilt)
        if source.labels != known:
            play(lay_out)  # a spoilt one was believed; a device says it once a second
            before["layouts"] += 1
        if not good():
            outcome.deaf_after.append(spoilt)
        counted = source.counters - before
        del counted["bytes"]
        if counted == usual and spoilt.strip(b"\0\r\n\t ,\xc0"):
            outcome.unaccounted.append(spoilt)
    outcome.packets = count
    outcome.seconds = time.monotonic() - began
    outcome.grown = _memory() - memory
    outcome.counters = source.counters
    return outcome


def _cost(name: str, packet: bytes) -> float:
    """Seconds of CPU that reading a packet takes, the least of five times."""
    seconds = []
    for _ in range(5):
        decoder, _ = take_decoder(Url.parse(address(name)))
        began = time.thread_time()
        decoder.feed(packet, 0.0)
        seconds.append(time.thread_time() - began)
    return min(seconds)


def _memory() -> int:
    """Bytes of memory that this process holds."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize()


def _same(xyz: Floats, wanted: Floats, labels: tuple[str, ...]) -> bool:
    rows = {label: row for row, label in enumerate(labels)}
    if any(label not in rows for label in LABELS):
        return False
    return bool(np.allclose(xyz[[rows[label] for label in LABELS]], wanted, atol=2e-3))
