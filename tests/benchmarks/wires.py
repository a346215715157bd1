"""What a stream of 1,000 frames a second costs on each wire: `python -m tests.benchmarks.wires`.

A simulated device, a process of its own, sends nine markers over a real pty or UDP on loopback; the
source reads them here. CPU is this process's own, in share of one core; beside it that of reading
the bytes and doing nothing with them, in the same run.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from drivers.clock import SYSTEM_CLOCK
from drivers.frame import Source
from drivers.osc_udp import UdpTransport
from drivers.registry import open_source
from drivers.serial_port import SerialTransport
from drivers.transport import Transport, TransportLost
from drivers.url import Url
from drivers.wire.registry import CODECS, DIALECTS, take_decoder
from tests.drivers.mutations import address
from tests.end_to_end.peers import free_port

RATE = 1000.0
PERFORMER = 120.0  # Hz


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("wires", nargs="*", default=[*CODECS, *DIALECTS])
    options = parser.parse_args()
    print(f"{'wire':16}{'sent':>8}{'read':>8}{'lost':>6}{'frames/s':>10}{'CPU':>8}{'bare':>8}")
    for name in options.wires:
        with tempfile.TemporaryDirectory() as folder:
            bare = measure(name, Path(folder) / "bare", options.seconds, reads=False)
            found = measure(name, Path(folder) / "port", options.seconds, reads=True)
        sent, read, seconds, cpu = found
        print(
            f"{name:16}{sent:8}{read:8}{sent - read:6}{read / seconds:10.0f}"
            f"{cpu / seconds:8.1%}{bare[3] / bare[2]:8.1%}"
        )


def measure(name: str, path: Path, seconds: float, *, reads: bool) -> tuple[int, int, float, float]:
    """Frames sent and read, seconds that it took, and seconds of CPU of this process."""
    port = free_port()
    where = address(name).replace("/dev/none", str(path)).replace("9100", str(port))
    command = [
        sys.executable,
        "-P",
        "-m",
        "bridge.cli",
        "simulate",
        "performer:walk",
        "--to",
        where,
    ]
    command += ["--speed", str(RATE / PERFORMER), "--seconds", str(seconds * RATE / PERFORMER)]
    serial = where.startswith("serial:")
    listener = None if serial else _open(where, path, port, reads=reads)
    device = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        while serial and not path.is_symlink():
            time.sleep(0.01)
        end = _open(where, path, port, reads=reads) if listener is None else listener
        read, first, last, cpu = _listen(end)
        _, said = device.communicate(timeout=30)
        end.close()
    finally:
        device.kill()
    sent = int(said.split(" frames of ")[0].split()[-1])
    return sent, read, last - first, cpu


def _open(where: str, path: Path, udp: int, *, reads: bool) -> Source | Transport:
    if reads:
        return open_source(where)
    if where.startswith("serial:"):
        port = SerialTransport(str(path), 921_600, SYSTEM_CLOCK)
        port.send(take_decoder(Url.parse(where))[0].hello)
        return port
    return UdpTransport("127.0.0.1", udp, SYSTEM_CLOCK)


def _listen(end: Source | Transport) -> tuple[int, float, float, float]:
    """Reads until a second of silence: how much, when first and last, and the CPU between."""
    read, first, last = 0, 0.0, 0.0
    cpu = spent = 0.0
    while True:
        try:
            patience = 1.0 if read else 20.0
            got = end.read(patience) if isinstance(end, Source) else end.receive(patience)
        except TransportLost:
            got = None
        if got is None:
            return read, first, last, spent
        last = time.monotonic()
        if not read:
            first, cpu = last, time.process_time()
        spent = time.process_time() - cpu
        read += 1


if __name__ == "__main__":
    main()
