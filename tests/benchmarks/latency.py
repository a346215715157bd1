"""From bytes on a serial line to VMC bytes on UDP: `python -m tests.benchmarks.latency`.

The tracker and the engine are this process, the bridge is a process of its own: `markerbridge run`,
and beside it, in the same run, one that does nothing between (`null_bridge`). A datagram's time is
the kernel's, so how soon this process reads it makes no difference; a packet's is the moment before
it is written to the pty.
"""

from __future__ import annotations

import argparse
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bridge.model import DEFAULT, Model
from drivers.frame import Layout
from drivers.wire.cobs import CobsEncoder
from simulators.performer import load_performer
from tests.end_to_end.peers import wait_for

RATES = (120, 240, 480, 1000)
WARM = 1.0  # s at the beginning that do not count
SO_TIMESTAMPNS = 35
_STAMP = struct.Struct("qq")


@dataclass(frozen=True)
class Passage:
    """What went through a bridge. ages: seconds from the packet's writing to the datagram."""

    sent: int
    came: int
    ages: npt.NDArray[np.float64]
    cpu: float  # of the bridge, in share of one core
    datagram: int  # bytes

    def at(self, percent: float) -> float:
        """ms."""
        return float(np.percentile(self.ages, percent)) * 1000 if len(self.ages) else float("nan")


def packets(model: Model, rate: float, count: int) -> list[bytes]:
    """The packets of a walking performer, layouts among them once a second."""
    walker = load_performer("walk")
    wire, layout = CobsEncoder(), Layout(model.info.tracked, rate)
    rows = [walker.layout.labels.index(label) for label in layout.labels]
    made = []
    for index in range(count):
        head = wire.encode_layout(layout) if index % int(rate) == 0 else b""
        pose = walker.pose(round(index * walker.layout.rate / rate))
        made.append(head + wire.encode_frame(index, index / rate, pose[rows]))
    return made


class Engine:
    """Keeps when each datagram came, as the kernel has it: seconds since 1970."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.port: int = self._socket.getsockname()[1]
        self.times: list[float] = []
        self.size = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._collect)
        self._thread.start()

    def _collect(self) -> None:
        while not self._stop.is_set():
            try:
                data, ancillary, *_ = self._socket.recvmsg(65_536, 64)
            except TimeoutError:
                continue
            seconds, nanoseconds = _STAMP.unpack(ancillary[0][2])
            self.times.append(seconds + nanoseconds * 1e-9)
            self.size = max(self.size, len(data))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()


@contextmanager
def bridge_under_test(command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-P", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def cpu_of(pid: int) -> float:
    """Seconds of CPU that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(command: Sequence[str], made: Sequence[bytes], rate: float) -> Passage:
    """Sends packets through a bridge at a rate. command: its module and arguments, where PTY and
    UDP stand for the line and the engine's port.
    """
    device, host = os.openpty()
    tty.setraw(host)
    engine = Engine()
    words = [
        word.replace("PTY", os.ttyname(host)).replace("UDP", str(engine.port)) for word in command
    ]
    written = np.zeros(len(made))
    try:
        with bridge_under_test(words) as process:
            os.close(host)
            heard = _hello(device)
            wait_for(heard, "the bridge's hello")
            time.sleep(0.3)
            spent = cpu_of(process.pid)
            start = time.monotonic() + 0.1
            for row, packet in enumerate(made):
                time.sleep(max(0.0, start + row / rate - time.monotonic()))
                written[row] = time.time()
                os.write(device, packet)
            time.sleep(0.5)
            spent = cpu_of(process.pid) - spent
    finally:
        engine.close()
        os.close(device)
    times = np.array(engine.times)
    return Passage(
        len(made), len(times), _ages(written, times, WARM), spent * rate / len(made), engine.size
    )


def _hello(device: int):
    os.set_blocking(device, False)

    def heard() -> bool:
        try:
            return bool(os.read(device, 4096))
        except OSError:  # nothing yet, or nobody has opened the other end
            return False

    def blocking_again() -> bool:
        if not heard():
            return False
        os.set_blocking(device, True)
        return True

    return blocking_again


def _ages(written: np.ndarray, times: np.ndarray, warm: float) -> np.ndarray:
    """Of datagrams that answer packets one by one, in order."""
    if len(times) == len(written):
        ages = times - written
    else:  # some never came: each answers the last packet before it
        ages = times - written[np.searchsorted(written, times) - 1]
    return ages[times > written[0] + warm]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rates", type=float, nargs="*", default=RATES)
    parser.add_argument("--options", default="", help="of the vmc:// sink")
    parser.add_argument("--model", default=DEFAULT)
    options = parser.parse_args()
    model = Model(options.model)
    print(f"{'Hz':>6}{'':8}{'sent':>7}{'came':>7}{'p50':>8}{'p99':>8}{'p99.9':>8} ms{'CPU':>8}")
    for rate in options.rates:
        made = packets(model, rate, int(options.seconds * rate))
        target = f"vmc://127.0.0.1:UDP?rate=100000{options.options}"
        run = ["-m", "bridge.cli", "run", "serial:PTY", "--to", target, "--model", options.model]
        ours = measure(run, made, rate)
        nothing = measure(
            ["-m", "tests.benchmarks.null_bridge", "PTY", "UDP", str(ours.datagram)], made, rate
        )
        for name, found in (("ours", ours), ("nothing", nothing)):
            ages = "".join(f"{found.at(percent):8.3f}" for percent in (50, 99, 99.9))
            print(f"{rate:6.0f} {name:7}{found.sent:7}{found.came:7}{ages}   {found.cpu:8.1%}")
        beyond = "".join(f"{ours.at(p) - nothing.at(p):8.3f}" for p in (50, 99, 99.9))
        print(f"{rate:6.0f} {'beyond':7}{'':14}{beyond}")


if __name__ == "__main__":
    main()
