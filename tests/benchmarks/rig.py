"""Both ends of a bridge under test: a tracker on a pty, and an engine on a UDP port.

They are one thread of this process, the bridge is a process of its own. A datagram's time is the
kernel's, so how soon it is read makes no difference; a packet's is the moment before it is written.
As on a real line, what the tracker cannot send when it is due is lost; it never waits.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.frame import Layout
from drivers.wire.cobs import CobsEncoder
from simulators.performer import load_performer
from tests.benchmarks.datagrams import HEAD, Rows, Times, answered, number_of
from tests.benchmarks.machine import cpu_seconds, memory

WARM = 1.0  # s at the beginning of a stream that do not count
PATIENCE = 30.0  # s: a bridge that takes longer to do the least thing is stuck
LONGEST = 120.0  # s that a start may take: what is not compiled yet takes some
LEAD = 0.3  # s from the hello to the first packet
TRAIL = 0.5  # s that the engine listens after the last packet
RECEIVE_BUFFER = 4 << 20

_SO_TIMESTAMPNS = 35  # Linux; the socket module does not name it
_STAMP = struct.Struct("qq")

NOTHING = (str(Path(__file__).with_name("null_bridge.py")), "{pty}", "{port}")


def bridge(*sinks: str, model: str = "default") -> list[str]:
    """The command of a session with these sinks; {port} in one is the engine's."""
    to = [word for sink in sinks for word in ("--to", sink)]
    return ["-m", "bridge.cli", "run", "serial:{pty}", "--json", "--model", model, *to]


@dataclass(frozen=True, slots=True)
class Stream:
    """What a tracker sends: a packet a frame, at `rate` Hz, the layout before the first of each
    second. frame: bytes of a frame's packet without its delimiters.
    """

    rate: float
    layout: bytes
    packets: list[bytes]
    frame: int


def walking(labels: tuple[str, ...], rate: float, seconds: float) -> Stream:
    """A performer who walks, with these markers."""
    walker = load_performer("walk")
    wire, layout = CobsEncoder(), Layout(labels, rate)
    rows = [walker.layout.labels.index(label) for label in labels]
    head = wire.encode_layout(layout)
    packets = []
    for index in range(round(seconds * rate)):
        pose = walker.pose(round(index * walker.layout.rate / rate))
        packet = wire.encode_frame(index, index / rate, pose[rows])
        packets.append(packet if index % round(rate) else head + packet)
    return Stream(rate, head, packets, len(packet.strip(b"\0")))


class Engine:
    """A UDP port of this machine that notes what comes. came: of each datagram its time, seconds
    since 1970, and its first bytes. largest: bytes of the largest one.
    """

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.came: list[tuple[float, bytes]] = []
        self.largest = 0

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> None:
        """Takes all that has come."""
        while True:
            try:
                data, ancillary, *_ = self._socket.recvmsg(65_536, 64)
            except BlockingIOError:
                return
            seconds, nanoseconds = _STAMP.unpack(ancillary[0][2])
            self.came.append((seconds + nanoseconds * 1e-9, data[:HEAD]))
            self.largest = max(self.largest, len(data))

    def close(self) -> None:
        self._socket.close()


class Rig:
    """The two ends, and how often the bridge has said hello: `asked`."""

    def __init__(self) -> None:
        self._device, self._host = os.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._device, False)
        self._rest = b""  # of a packet of which not all could be written yet
        self.engine = Engine()
        self.asked = 0

    def command(self, words: Sequence[str]) -> list[str]:
        """The words of a bridge's command with this rig's line and port in them."""
        pty = os.ttyname(self._host)
        return [word.format(pty=pty, port=self.engine.port) for word in words]

    def play(self, stream: Stream, until: Callable[[], bool] = lambda: False) -> Times:
        """Sends the stream, or its beginning; when each packet was written, (m,) seconds since
        1970, NaN where it was lost.
        """
        written = np.full(len(stream.packets), np.nan)
        start, asked = time.monotonic(), self.asked
        for row, packet in enumerate(stream.packets):
            self.listen(start + row / stream.rate - time.monotonic())
            if self.asked > asked and not math.isnan(self._write(stream.layout)):
                asked = self.asked  # a device answers a hello with its layout, at once
            written[row] = self._write(packet)
            if until():
                break
        return written

    def listen(self, seconds: float) -> None:
        """Takes what comes for so long; at least what has come."""
        end = time.monotonic() + seconds
        self._take(max(0.0, seconds))
        while (left := end - time.monotonic()) > 0:
            self._take(left)

    def close(self) -> None:
        self.engine.close()
        os.close(self._device)
        os.close(self._host)

    def __enter__(self) -> Rig:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _take(self, timeout: float) -> None:
        """What comes next, if it comes in time."""
        unsent = [self._device] if self._rest else []
        readable, writable, _ = select.select([self.engine, self._device], unsent, [], timeout)
        if writable:
            self._rest = self._rest[os.write(self._device, self._rest) :]
        if self._device in readable and os.read(self._device, 4096):
            self.asked += 1
        if self.engine in readable:
            self.engine.receive()

    def _write(self, packet: bytes) -> float:
        if self._rest:
            return math.nan
        now = time.time()
        try:
            self._rest = packet[os.write(self._device, packet) :]
        except BlockingIOError:
            return math.nan
        return now


@contextmanager
def started(command: Sequence[str], **environment: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process, killed at the end if it still runs."""
    process = subprocess.Popen(
        [sys.executable, "-P", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """What went through a bridge.

    rate: Hz, as frames were sent in fact. sent: frames. refused: of them, for which the line had no
    room. lost: of them, not answered. ages: seconds from a packet's writing to its datagram, but
    for the first second. cpu: of the bridge, in share of one core. memory, peak: its MB, at the end
    and at most. datagram: bytes of the largest. report: what `run --json` says.
    """

    rate: float
    sent: int
    refused: int
    lost: int
    ages: Times
    cpu: float
    memory: float
    peak: float
    datagram: int
    report: dict[str, Any]

    def age(self, percent: float) -> float:
        """A percentile of the ages, ms; NaN where nothing came."""
        return float(np.percentile(self.ages, percent)) * 1000 if len(self.ages) else math.nan


def measure(words: Sequence[str], stream: Stream) -> Passage:
    """Sends a stream through the bridge of a command, with {pty} and {port} in it."""
    with Rig() as rig, started(rig.command(words)) as process:
        _await_hello(rig, process)
        rig.listen(LEAD)
        cpu, began = cpu_seconds(process.pid), time.monotonic()
        written = rig.play(stream)
        rig.listen(TRAIL)
        cpu, took = cpu_seconds(process.pid) - cpu, time.monotonic() - began
        now, peak = memory(process.pid), memory(process.pid, "VmHWM")
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
    times, rows = answers(rig.engine, stream.rate, written)
    ages = times - written[rows]
    return Passage(
        pace(written),
        len(written),
        int(np.isnan(written).sum()),
        len(written) - len(np.unique(rows)),
        ages[rows >= WARM * stream.rate],
        cpu / (took - TRAIL),
        now,
        peak,
        rig.engine.largest,
        json.loads(said) if said else {},
    )


def _await_hello(rig: Rig, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + LONGEST
    while not rig.asked:
        rig.listen(0.01)
        if process.poll() is not None:
            raise RuntimeError(f"the bridge ended: {process.communicate()[1]}")
        if time.monotonic() > deadline:
            raise RuntimeError(f"no hello from the bridge in {LONGEST:.0f} s")


def pace(written: Times) -> float:
    """Frames a second, by when each was sent, (m,) seconds; NaN where it was not."""
    rows = np.flatnonzero(~np.isnan(written))
    return float((rows[-1] - rows[0]) / (written[rows[-1]] - written[rows[0]]))


def answers(engine: Engine, rate: float, written: Times) -> tuple[Times, Rows]:
    """When each datagram that tells of a frame came, and the row of the packet that it answers."""
    told = [(at, number_of(head, rate)) for at, head in engine.came]
    known = [(at, number) for at, number in told if number is not None]
    times = np.array([at for at, _ in known], float)
    return times, answered([number for _, number in known], times, written)
