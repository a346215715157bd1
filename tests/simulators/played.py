"""A device with faults and its host, on virtual time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.clock import VirtualClock
from drivers.frame import Layout, MarkerFrame
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.codec import Decoder, Encoder
from drivers.wire_source import WireSource
from simulators.corruption import Corruption, Faults
from simulators.device import Device, Wire
from simulators.faults.chain import FaultChain
from simulators.faults.plan import parse_plan
from simulators.lines import MemoryLine

LAYOUT = Layout(("LFHD", "RFHD", "LUPA", "LELB", "LWRB", "RSHN", "LTOE"), 120.0)
START = 50.0  # s on the host's clock when the stream begins


def position(index: int) -> np.ndarray:
    """Markers, (7, 3) metres, that tell frame and row: x is the index / 1000, y the row."""
    rows = np.arange(len(LAYOUT.labels))
    return np.stack([np.full(7, index / 1000), rows, rows + 0.5], axis=1).astype(np.float32)


class TappedLine(MemoryLine):
    """A line that remembers what went over it: when, and a digest of all."""

    def __init__(self, clock: VirtualClock) -> None:
        super().__init__(clock)
        self.clock = clock
        self.packets: list[tuple[float, bytes]] = []

    def send(self, data: bytes) -> None:
        self.packets.append((self.clock.now() - START, data))
        super().send(data)

    @property
    def digest(self) -> str:
        return hashlib.sha256(b"".join(data for _, data in self.packets)).hexdigest()


@dataclass
class Played:
    """What came of it. now: when the host got each frame, seconds of the stream."""

    device: Device
    source: WireSource
    line: TappedLine
    frames: list[MarkerFrame] = field(default_factory=list)
    now: list[float] = field(default_factory=list)

    @property
    def indices(self) -> list[int]:
        return [frame.index for frame in self.frames]


def play(
    plan: str,
    seconds: float = 10.0,
    *,
    seed: int | None = None,
    reorder: int = 0,
    encoder: Encoder | None = None,
    decoder: Decoder | None = None,
    reopens: bool = True,
) -> Played:
    """Plays so many seconds with the faults of a fault file's text to its end."""
    clock = VirtualClock(START)
    line = TappedLine(clock)
    faults = FaultChain(parse_plan(plan, LAYOUT.labels), LAYOUT, seed)
    source = WireSource(
        "memory:",
        line.connect,
        decoder or CobsDecoder(),
        clock,
        reorder=reorder,
        reopens=reopens,
    )
    device = Device(
        poses(round(seconds * LAYOUT.rate)),
        list(range(len(LAYOUT.labels))),
        Corruption(Faults(), len(LAYOUT.labels)),
        Wire(line, encoder or CobsEncoder(), faults.layout),
        clock,
        faults=faults,
    )
    device.schedule(clock)
    played = Played(device, source, line)
    while not device.done:
        while (frame := source.read(0.5)) is not None:
            played.frames.append(frame)
            played.now.append(clock.now() - START)
    return played


def poses(count: int) -> Iterator[np.ndarray]:
    return map(position, range(count))
