"""What a recording keeps when its session is killed: `python -m tests.benchmarks.kill`.

Sessions that record, and send their poses to somebody else as well, are killed (SIGKILL) at random
moments. Printed is what that other one had got by then, and what the log holds.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bridge.model import Model
from drivers.frame import Layout
from drivers.marker_set import MARKERS
from drivers.session_log import LineBytes, SessionLog
from drivers.udp_sender import UdpSender
from drivers.wire.osc_native import NativeOscEncoder
from simulators.performer import load_performer
from tests.end_to_end.peers import Receiver, free_port, listening, running, wait_for

RATE = 120.0  # Hz
AT_ONCE = 4  # sessions side by side


@dataclass(frozen=True, slots=True)
class Kill:
    """What was seen of one session. seconds: of its recording. heard: the index of the last pose
    that the other one got. logged, raw: those of the last pose and the last packet in the log.
    holes: indices that neither has in between.
    """

    seconds: float
    heard: int
    logged: int
    raw: int
    holes: int

    @property
    def lost(self) -> float:
        """Seconds that are not in the log."""
        return max(0, self.heard - min(self.logged, self.raw)) / RATE


def killed(folder: Path, count: int, seed: int, longest: float = 3.0) -> Iterator[Kill]:
    """Starts and kills `count` sessions, each within `longest` seconds of its first pose."""
    chance = random.Random(seed)
    while count > 0:
        together = min(AT_ONCE, count)
        count -= together
        with tempfile.TemporaryDirectory(dir=folder) as scratch, ExitStack() as stack:
            ports = [free_port() for _ in range(together)]
            paths = [Path(scratch, f"{port}.mcap") for port in ports]
            receivers = [stack.enter_context(Receiver()) for _ in ports]
            sessions = [
                stack.enter_context(
                    running(
                        *("run", f"osc://127.0.0.1:{port}", "--json"),
                        *("--to", f"log:{path}", "--to", f"osc://127.0.0.1:{receiver.port}"),
                    )
                )
                for port, path, receiver in zip(ports, paths, receivers, strict=True)
            ]
            for port in ports:
                wait_for(lambda port=port: listening(f"osc://127.0.0.1:{port}"), "a session")
            stack.enter_context(_tracker(ports))
            for receiver in receivers:
                wait_for(lambda receiver=receiver: len(receiver.datagrams) > 1, "poses")
            began = time.monotonic()
            moments = sorted((chance.uniform(0.05, longest), at) for at in range(together))
            lived = {}
            for moment, at in moments:
                time.sleep(max(0.0, began + moment - time.monotonic()))
                os.kill(sessions[at].process.pid, signal.SIGKILL)
                sessions[at].process.wait()
                lived[at] = time.monotonic() - began
            for at, path in enumerate(paths):
                yield _found(path, lived[at], receivers[at])


def _found(path: Path, seconds: float, receiver: Receiver) -> Kill:
    log = SessionLog(path)
    packets = [line.received.data for line in log.lines("source") if isinstance(line, LineBytes)]
    raw = _indices(packets, b"/markerbridge/frame")
    heard = _indices(receiver.datagrams, b"/markerbridge/pose")
    logged = [pose.index for pose in log.poses()]
    frames = [frame.index for frame in log.frames()]
    holes = sum(max(found) - min(found) + 1 - len(found) for found in (raw, frames, logged))
    return Kill(seconds, heard[-1], logged[-1], raw[-1], holes)


def _indices(datagrams: list[bytes], address: bytes) -> list[int]:
    """The first argument of each OSC message of an address."""
    found = []
    for data in datagrams:
        if data.startswith(address + b"\0"):
            types = data.index(b",")
            found.append(struct.unpack_from(">i", data, (data.index(b"\0", types) // 4 + 1) * 4)[0])
    return found


@contextmanager
def _tracker(ports: list[int]) -> Iterator[None]:
    """A tracker that sends a walk to all ports."""
    walker, tracked = load_performer("walk"), Model("default").info.tracked
    rows = [MARKERS.index(label) for label in tracked]
    encoder, senders = NativeOscEncoder(), [UdpSender("127.0.0.1", port) for port in ports]
    layout = encoder.encode_layout(Layout(tracked, RATE))
    stop = threading.Event()

    def play() -> None:
        start, index = time.monotonic(), 0
        while not stop.wait(max(0.0, start + index / RATE - time.monotonic())):
            frame = encoder.encode_frame(index, index / RATE, walker.pose(index)[rows])
            for sender in senders:
                for datagram in (layout, frame) if index % 60 == 0 else (frame,):
                    try:
                        sender.send(datagram)
                    except OSError:  # its session is dead
                        continue
            index += 1

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        for sender in senders:
            sender.close()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("| kill | after s | last pose heard | in the log | last packet | holes | lost s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        found = killed(Path(folder), options.kills, options.seed, 10.0)
        for number, kill in enumerate(found, 1):
            print(
                f"| {number} | {kill.seconds:.2f} | {kill.heard} | {kill.logged} | {kill.raw} "
                f"| {kill.holes} | {kill.lost:.3f} |",
                flush=True,
            )
            worst = max(worst, kill.lost)
    print(f"every log opens; at most {worst:.3f} s are lost")
    return int(worst > 1.0)


if __name__ == "__main__":
    sys.exit(main())
