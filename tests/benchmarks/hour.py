"""An hour of a bad line, on virtual time: `python -m tests.benchmarks.hour [--minutes 60]`.

The embedded performer walks at 120 Hz; the nine markers that the default model tracks go through
every fault that there is, over the real codec and driver, into the estimator. Printed is what
became of every packet, and whether it adds up.

Of the packets that the device makes (frames and layouts, and copies of them), each

1. is lost on the way (`loss`), finds no line (`no_line`), or a line that nobody has open
   (`unread`), or is `spoilt`, or `unended` (it lost no more than its end mark), or arrives whole;
2. if it arrives whole, it is a frame that is delivered, a layout, a copy of a frame that came
   before (`duplicates`), a frame whose turn was past (`late`), or one before the first layout or
   of another (`no_layout`, `layout_mismatch`). So is an unended one if the next closes it.

Both sums have to agree, no frame may come out that did not arrive, and none twice. On wires
without a checksum a spoilt packet may be read: there the second sum is not asked for.
"""

from __future__ import annotations

import argparse
import itertools
import logging
import resource
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.session import Session
from bridge.sinks.sink import SinkContext
from drivers.clock import VirtualClock
from drivers.frame import Floats, Layout
from drivers.url import Url
from drivers.wire.codec import Encoder
from drivers.wire.registry import CODECS, take_decoder, take_encoder
from drivers.wire_source import WireSource
from simulators.corruption import Corruption, Faults
from simulators.device import Device, Wire
from simulators.faults.chain import FaultChain
from simulators.faults.plan import parse_plan
from simulators.lines import MemoryLine
from simulators.performer import load_performer

RATE = 120.0
REORDER = 2  # frames, as the faults overtake
CHECKED = ("cobs",)  # codecs with a checksum
WARM_UP = 30.0  # s of the stream after which memory has its size
END = b"\0"  # of a packet, of codecs with a checksum
KEPT = 4096  # packets that may be under way

PLAN = """
seed = 5
[[fault]]
kind = "noise"
size = "1mm"
[[fault]]
kind = "dropout"
share = "10%"
frames = [10, 100]
[[fault]]
kind = "occlusion"
part = "right leg"
chance = 0.001
for = 0.7
[[fault]]
kind = "swap"
markers = ["LWRB", "RWRB"]
chance = 0.0005
for = 0.5
[[fault]]
kind = "ghost"
marker = "LANK"
chance = 0.001
for = 0.2
[[fault]]
kind = "ghost"
marker = "RANK"
label = "ghost"
chance = 0.001
for = 0.3
[[fault]]
kind = "drift"
ppm = 60
[[fault]]
kind = "clock_jump"
seconds = 1.5
at = 70
every = 250
[[fault]]
kind = "loss"
chance = 0.01
[[fault]]
kind = "duplicate"
chance = 0.01
[[fault]]
kind = "truncate"
chance = 0.002
[[fault]]
kind = "flip"
bits = 2
chance = 0.005
[[fault]]
kind = "jitter"
up_to = 0.006
[[fault]]
kind = "reorder"
by = 2
chance = 0.01
[[fault]]
kind = "stall"
at = 20
for = 0.4
every = 31
[[fault]]
kind = "stall"
at = 55
for = 2.5
every = 170
[[fault]]
kind = "unplug"
at = 40
for = 0.6
every = 61
"""


@dataclass
class Ledger:
    """What arrived, told by its bytes: those of a whole packet are as they were encoded."""

    there: bytearray  # per frame index, whether it arrived, whole or unended
    whole: int = 0  # packets, copies among them
    unended: int = 0
    spoilt: int = 0
    unread: int = 0
    _made: dict[bytes, int | None] = field(default_factory=dict)

    def note(self, packet: bytes, index: int | None) -> None:
        """A packet was encoded: that of a frame, or a layout (None)."""
        self._made.pop(packet, None)
        self._made[packet] = index
        if len(self._made) > KEPT:
            del self._made[next(iter(self._made))]

    def take(self, packet: bytes) -> None:
        """A packet has arrived on the line."""
        if packet in self._made:
            self.whole += 1
            index = self._made[packet]
        elif packet + END in self._made:
            self.unended += 1
            index = self._made[packet + END]
        else:
            self.spoilt += 1
            return
        if index is not None:
            self.there[index] = True


class LedgerEncoder:
    """An encoder whose packets are noted."""

    def __init__(self, encoder: Encoder, ledger: Ledger) -> None:
        self._encoder, self._ledger = encoder, ledger
        self.has_hello = encoder.has_hello

    def encode_layout(self, layout: Layout) -> bytes:
        packet = self._encoder.encode_layout(layout)
        self._ledger.note(packet, None)
        return packet

    def encode_frame(self, index: int, t_device: float, xyz: Floats) -> bytes:
        packet = self._encoder.encode_frame(index, t_device, xyz)
        self._ledger.note(packet, index)
        return packet


class LedgerLine(MemoryLine):
    """A line of which everything that arrives is noted."""

    def __init__(self, clock: VirtualClock, ledger: Ledger) -> None:
        super().__init__(clock)
        self._ledger = ledger

    def send(self, data: bytes) -> None:
        before = self.lost
        super().send(data)
        if self.lost > before:
            self._ledger.unread += 1
        else:
            self._ledger.take(data)


@dataclass
class Outcome:
    """What became of it all."""

    sent: int
    delivered: int
    device: Counter[str]
    host: Counter[str]
    ledger: Ledger
    poses: int
    records: list[str]  # what was logged
    grown: float  # MB, from the end of the warm-up
    seconds: float  # that it took
    wrong: list[str] = field(default_factory=list)

    @property
    def read(self) -> int:
        """Packets that the host made out."""
        names = ("layouts", "duplicates", "late", "no_layout", "layout_mismatch")
        return self.delivered + sum(self.host[name] for name in names)


class _Records(logging.Handler):
    def __init__(self) -> None:
        super().__init__()
        self.records: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record.getMessage())


def play(minutes: float, codec: str = "cobs", plan: str = PLAN) -> Outcome:
    """Plays so much of the hour."""
    began = time.monotonic()
    model = Model("default")
    walker = load_performer("walk")
    clock = VirtualClock(1000.0)
    frames = round(minutes * 60 * RATE)
    labels = model.info.tracked
    faults = FaultChain(parse_plan(plan, labels), Layout(labels, RATE))
    ledger = Ledger(bytearray(frames))
    line = LedgerLine(clock, ledger)
    address = f"serial:hour?codec={codec}"
    if codec == "fastrak":  # it has numbers in place of labels
        stations = enumerate(faults.layout.labels, 1)
        address += "&labels=" + ",".join(f"{number}:{label}" for number, label in stations)
    url = Url.parse(address)
    decoder, convention = take_decoder(url)
    encoder, _ = take_encoder(Url.parse(url.text))
    source = WireSource(
        "hour", line.connect, decoder, clock, convention=convention, reorder=REORDER, reopens=True
    )
    device = Device(
        itertools.islice(map(walker.pose, itertools.count()), frames),
        [walker.layout.labels.index(label) for label in labels],
        Corruption(Faults(), len(labels)),
        Wire(line, LedgerEncoder(encoder, ledger), faults.layout, convention),
        clock,
        faults=faults,
    )
    context = SinkContext(model.info, lambda index: None)
    session = Session(source, PoseEstimator(model), [], context, clock=clock)
    device.schedule(clock)
    records = _Records()
    logging.getLogger().addHandler(records)
    delivered = bytearray(frames)
    wrong: list[str] = []
    poses, warm = 0, 0.0
    try:
        while not device.done:
            while (frame := source.read(0.5)) is not None:
                poses += session.handle(frame).index == frame.index
                if codec in CHECKED:
                    if delivered[frame.index]:
                        wrong.append(f"frame {frame.index} came out twice")
                    if not ledger.there[frame.index]:
                        wrong.append(f"frame {frame.index} came out, but did not arrive")
                    delivered[frame.index] = True
                if not warm and clock.now() > 1000.0 + WARM_UP:
                    warm = _memory()
    finally:
        logging.getLogger().removeHandler(records)
    grown = _memory() - warm if warm else 0.0
    outcome = Outcome(
        device.sent,
        source.counters["frames"],
        device.counters,
        source.counters,
        ledger,
        poses,
        records.records,
        grown,
        time.monotonic() - began,
        wrong,
    )
    _check(outcome, codec)
    return outcome


def _check(outcome: Outcome, codec: str) -> None:
    """Adds what does not add up to `wrong`."""
    did, ledger, wrong = outcome.device, outcome.ledger, outcome.wrong
    made = did["packets"] + did["duplicate"]
    arrived = ledger.whole + ledger.unended + ledger.spoilt
    ended = did["loss"] + did["no_line"] + ledger.unread + arrived
    if made != ended:
        wrong.append(f"{made} packets were made, but {ended} have an end")
    if codec in CHECKED and not 0 <= outcome.read - ledger.whole <= ledger.unended:
        wrong.append(
            f"{ledger.whole} packets arrived whole and {ledger.unended} without their ends, but "
            f"{outcome.read} were read"
        )
    if outcome.poses != outcome.delivered:
        wrong.append(f"{outcome.delivered} frames gave {outcome.poses} poses")


def _memory() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def table(outcome: Outcome) -> str:
    """What became of it all, for the eye."""
    rows = [
        ("frames sent", outcome.sent),
        ("frames delivered", outcome.delivered),
        *((f"device: {name}", count) for name, count in sorted(outcome.device.items())),
        ("line: unread", outcome.ledger.unread),
        ("line: spoilt", outcome.ledger.spoilt),
        ("line: unended", outcome.ledger.unended),
        ("line: arrived whole", outcome.ledger.whole),
        *((f"host: {name}", count) for name, count in sorted(outcome.host.items())),
        ("host: packets read", outcome.read),
        ("log records", len(outcome.records)),
    ]
    lines = [f"| {name} | {count:,} |" for name, count in rows]
    lines += [f"| memory grown, MB | {outcome.grown:.1f} |", f"| seconds | {outcome.seconds:.0f} |"]
    return "\n".join(["| | |", "| --- | --- |", *lines])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Raw)
    parser.add_argument("--minutes", type=float, default=60.0, help="of the stream")
    parser.add_argument("--codec", choices=tuple(CODECS), default="cobs")
    options = parser.parse_args()
    outcome = play(options.minutes, options.codec)
    print(table(outcome))
    for text in outcome.wrong[:20]:
        print(f"WRONG: {text}")
    return 1 if outcome.wrong else 0


_Raw = argparse.RawDescriptionHelpFormatter


if __name__ == "__main__":
    sys.exit(main())
