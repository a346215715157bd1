"""Poses of many to many: `python -m tests.benchmarks.fanout`.

Performers send 120 poses a second each through the real sinks, all from one process; every reader
takes the poses of all of them, all readers in another process, which does nothing but look at the
time in each. Over `mqtt://` the real Mosquitto stands between; over `osc://` the performer sends to
each reader. Late is a pose by the time from just before the sink is called until its reader has it.
"""

from __future__ import annotations

import argparse
import select
import socket
import struct
import tempfile
import time
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkError
from tests.benchmarks.machine import calibration, cpu_seconds, machine
from tests.bridge.mosquitto import Broker
from tests.bridge.poses import CONTEXT, made, standing

PERFORMERS = (1, 10, 32, 100)
READERS = (1, 2, 4, 8)
RATE = 120.0  # Hz, of each performer
QUIET = 1.0  # s without a pose after which all have come
BURST = 0.0005  # s: sooner than this nobody is woken
TIME_AT = 4  # bytes from the index to the time, in the pose message
KEEPALIVE = 600  # s: readers never ping


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--performers", type=int, nargs="*", default=PERFORMERS)
    parser.add_argument("--readers", type=int, nargs="*", default=READERS)
    options = parser.parse_args()
    print(" ".join(f"{name} {value}," for name, value in machine().items()))
    print(" ".join(f"{name} {value:.1f} µs" for name, value in calibration().items()))
    print(
        f"{'':5}{'performers':>11}{'readers':>8}{'wanted/s':>10}{'came/s':>9}{'refused':>9}"
        f"{'lost':>7}{'p50':>8}{'p99':>8} ms{'sender':>9}{'broker':>8}{'readers':>8}  CPU"
    )
    for performers in options.performers:
        for readers in options.readers:
            for scheme in ("mqtt", "osc"):
                found = measure(scheme, performers, readers, options.seconds)
                wanted = RATE * performers * readers
                print(
                    f"{scheme:5}{performers:11}{readers:8}{wanted:10.0f}"
                    f"{found.came / found.seconds:9.0f}{found.refused:9}{found.lost:7}"
                    f"{found.p50:8.2f}{found.p99:8.2f}   "
                    f"{found.sender:9.0%}{found.broker:8.0%}{found.readers:8.0%}",
                    flush=True,
                )


class Sent(NamedTuple):
    """What the performers' process has to tell. poses: those that the sinks took."""

    poses: int
    refused: int
    seconds: float
    cpu: float  # s


class Came(NamedTuple):
    """What the readers' process has to tell. ages: s, of each pose at each reader."""

    ages: npt.NDArray[np.float64]
    cpu: float  # s


@dataclass(frozen=True)
class Found:
    """A row of the table. sender, broker, readers: CPU in share of one core. p50, p99: ms."""

    came: int
    refused: int
    lost: int
    seconds: float
    p50: float
    p99: float
    sender: float
    broker: float
    readers: float


def measure(scheme: str, performers: int, readers: int, seconds: float) -> Found:
    """Sends for so many seconds, and waits until nothing comes any more."""
    with tempfile.TemporaryDirectory() as folder, Broker(Path(folder)) as broker:
        context = get_context("spawn")
        line, theirs = context.Pipe()
        reading = context.Process(target=read, args=(theirs, scheme, broker.port, readers))
        reading.start()
        ports: list[int] = line.recv()
        if scheme == "mqtt":
            addresses = [[f"mqtt://127.0.0.1:{broker.port}/{n:03}"] for n in range(performers)]
        else:
            addresses = [[f"osc://127.0.0.1:{port}" for port in ports]] * performers
        sending_line, theirs = context.Pipe()
        sending = context.Process(target=send, args=(theirs, addresses, seconds))
        before = cpu_seconds(broker.process.pid)
        sending.start()
        sent: Sent = sending_line.recv()
        came: Came = line.recv()
        passing = cpu_seconds(broker.process.pid) - before
        for process in (sending, reading):
            process.join()
    total = sent.poses * (readers if scheme == "mqtt" else 1)
    return Found(
        *(len(came.ages), sent.refused, total - len(came.ages), sent.seconds),
        *(float(percentile) * 1000 for percentile in np.percentile(came.ages, (50, 99))),
        *(cpu / sent.seconds for cpu in (sent.cpu, passing, came.cpu)),
    )


def send(line: Connection, addresses: Sequence[Sequence[str]], seconds: float) -> None:
    """The performers' process: each has its sinks, and its turn within 1/120 s."""
    performers = [[open_sink(address, CONTEXT) for address in each] for each in addresses]
    for sinks in performers:  # those that are sent later tell the time itself
        for sink in sinks:
            sink(standing(0, 0.0))
    time.sleep(QUIET / 2)
    pose = standing()
    poses = refused = 0
    cpu, start = time.process_time(), time.monotonic()
    for index in range(1, round(seconds * RATE) + 1):
        for number, sinks in enumerate(performers):
            ahead = start + (index + number / len(performers)) / RATE - time.monotonic()
            if ahead > BURST:
                time.sleep(ahead)
            for sink in sinks:
                try:
                    sink(replace(pose, index=index, t=time.monotonic()))
                    poses += 1
                except SinkError:
                    refused += 1
    elapsed, cpu = time.monotonic() - start, time.process_time() - cpu
    line.send(Sent(poses, refused, elapsed, cpu))
    for sinks in performers:
        for sink in sinks:
            sink.close()


def read(line: Connection, scheme: str, port: int, count: int) -> None:
    """The readers' process. It sends the ports that it reads, and what came once all is quiet."""
    (message,) = made("osc://127.0.0.1:1", standing())[0][1:]
    readers: list[Reader] = [
        BrokerReader(port, message) if scheme == "mqtt" else UdpReader(message)
        for _ in range(count)
    ]
    line.send([reader.port for reader in readers])
    cpu: float | None = None  # when the first came
    while True:
        ready, _, _ = select.select(readers, [], [], QUIET)
        if not ready and cpu is not None:
            break
        for reader in ready:
            reader.take()
        if cpu is None and any(reader.ages for reader in readers):
            cpu = time.process_time()
    ages = np.concatenate([age for reader in readers for age in reader.ages])
    line.send(Came(ages, time.process_time() - cpu))
    for reader in readers:
        reader.close()


class Reader:
    """Takes the time out of each pose. ages: how late they were, an array per look."""

    def __init__(self, line: socket.socket, message: bytes) -> None:
        self._line = line
        self.ages: list[npt.NDArray[np.float64]] = []
        self._time_at = message.index(struct.pack(">i", 60)) + TIME_AT

    @property
    def port(self) -> int:
        return int(self._line.getsockname()[1])

    def fileno(self) -> int:
        return self._line.fileno()

    def close(self) -> None:
        self._line.close()

    @abstractmethod
    def take(self) -> None:
        """All that has come by now."""

    def _count(self, times: npt.NDArray[np.float64]) -> None:
        times = times[times > 0]  # the first has none
        if len(times):
            self.ages.append(time.monotonic() - times)


class UdpReader(Reader):
    """A port that everybody sends to."""

    def __init__(self, message: bytes) -> None:
        line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        line.bind(("127.0.0.1", 0))
        line.setblocking(False)
        super().__init__(line, message)
        self._size = len(message)

    def take(self) -> None:
        while True:
            try:
                datagram = self._line.recv(65_536)
            except BlockingIOError:
                return
            if len(datagram) == self._size:  # else it is a layout
                self._count(np.frombuffer(datagram, ">f8", 1, self._time_at))


class BrokerReader(Reader):
    """Subscribes to the poses of all, whose packets are all of one length (MQTT 3.1.1)."""

    def __init__(self, port: int, message: bytes) -> None:
        line = socket.create_connection(("127.0.0.1", port))
        name = f"reader{line.getsockname()[1]}".encode()
        connect = b"\x00\x04MQTT\x04\x02" + struct.pack(">H", KEEPALIVE) + _text(name)
        line.sendall(_packet(0x10, connect))
        _expect(line, b"\x20\x02\x00\x00")
        line.sendall(_packet(0x82, b"\x00\x01" + _text(b"+/pose") + b"\x00"))
        _expect(line, b"\x90\x03\x00\x01\x00")
        line.setblocking(False)
        super().__init__(line, message)
        head = len(_packet(0x30, _text(b"000/pose") + message)) - len(message)
        self._size = head + len(message)
        self._time_at += head
        self._rest = b""

    def take(self) -> None:
        try:
            data = self._rest + self._line.recv(1 << 20)
        except BlockingIOError:
            return
        whole = len(data) - len(data) % self._size
        packets = np.frombuffer(data[:whole], np.uint8).reshape(-1, self._size)
        self._rest = data[whole:]
        times = packets[:, self._time_at : self._time_at + 8]
        self._count(np.ascontiguousarray(times).view(">f8")[:, 0])


def _text(data: bytes) -> bytes:
    return struct.pack(">H", len(data)) + data


def _packet(kind: int, body: bytes) -> bytes:
    """Its length is in groups of seven bits, the lowest first."""
    size, length = len(body), b""
    while not length or size:
        size, group = divmod(size, 128)
        length += bytes([group | (0x80 if size else 0)])
    return bytes([kind]) + length + body


def _expect(line: socket.socket, answer: bytes) -> None:
    found = line.recv(len(answer), socket.MSG_WAITALL)
    assert found == answer, f"the broker says {found.hex()}"


if __name__ == "__main__":
    main()
