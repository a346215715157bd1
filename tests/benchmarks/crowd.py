"""Both ends of a bridge of several performers: their trackers, which send our OSC dialect over UDP,
and an engine for each.

The bridge has a core to itself, and all its threads are on it; both ends are one thread of this
process, on another core.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

import numpy as np

from drivers.frame import Layout
from drivers.performers import labels_of
from drivers.wire.osc_native import NativeOscEncoder
from simulators.corruption import Corruption, Faults
from simulators.performer import load_performer
from simulators.several import APART
from tests.benchmarks.datagrams import Times
from tests.benchmarks.machine import cpu_seconds, memory
from tests.benchmarks.rig import (
    LEAD,
    LONGEST,
    PATIENCE,
    TRAIL,
    WARM,
    Engine,
    Passage,
    Stream,
    answers,
    pace,
    started,
)
from tests.end_to_end.peers import free_port

SHIFTED = 37  # frames by which each is ahead of the one before


def stream_of(
    names: Sequence[str], labels: tuple[str, ...], rate: float, seconds: float, faults: Faults
) -> Stream:
    """What a tracker sends of these performers: each walks beside the others, at another moment of
    the walk, and has faults of their own. The layout is a datagram by itself.
    """
    walker, wire = load_performer("walk"), NativeOscEncoder()
    rows = [walker.layout.labels.index(label) for label in labels]
    length = round(seconds * rate)
    steps = walker.layout.rate / rate
    walk = [
        walker.pose(round(index * steps))[rows] for index in range(length + SHIFTED * len(names))
    ]
    shown = []
    for number in range(len(names)):
        corrupt = Corruption(faults, len(labels), number).apply
        aside = np.array([0.0, APART * number, 0.0], np.float32)
        first = SHIFTED * number
        shown.append([corrupt(pose + aside) for pose in walk[first : first + length]])
    layout = wire.encode_layout(Layout(labels_of(labels, names), rate))
    packets = [
        wire.encode_frame(index, index / rate, np.concatenate(poses))
        for index, poses in enumerate(zip(*shown, strict=True))
    ]
    return Stream(rate, layout, packets, len(packets[0]))


def measure(
    companies: Sequence[Sequence[str]], streams: Sequence[Stream], sink: str
) -> tuple[Passage, int]:
    """Sends streams through a bridge, and how many frames it estimated of the performer of whom it
    estimated fewest. companies: who is in each stream. sink: each performer's, with {name} in it
    and {port}, which is of an engine of their own.
    """
    names = [name for company in companies for name in company]
    with ExitStack() as opened:
        engines = [opened.enter_context(closing(Engine())) for _ in names]
        ports = [free_port() for _ in companies]
        trackers = [opened.enter_context(_tracker(port)) for port in ports]
        words = ["-m", "bridge.cli", "run", "--json"]
        for port, company in zip(ports, companies, strict=True):
            words.append(f"osc://127.0.0.1:{port}?performers={','.join(company)}")
        for name, engine in zip(names, engines, strict=True):
            words += ["--to", sink.format(name=name, port=engine.port)]
        process = opened.enter_context(_apart(words))
        _await(process, trackers, streams, engines)
        _listen(engines, LEAD)
        cpu, began = cpu_seconds(process.pid), time.monotonic()
        written = _play(trackers, streams, engines)
        took = time.monotonic() - began
        _listen(engines, TRAIL)
        cpu = cpu_seconds(process.pid) - cpu
        now, peak = memory(process.pid), memory(process.pid, "VmHWM")
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
    rate, sent, lost, ages = streams[0].rate, 0, 0, []
    following = iter(engines)
    for company, times in zip(companies, written, strict=True):
        for _ in company:
            came, rows = answers(next(following), rate, times)
            sent, lost = sent + len(times), lost + len(times) - len(np.unique(rows))
            ages.append((came - times[rows])[rows >= WARM * rate])
    report = json.loads(said)
    fewest = min(one["frames"] for one in (report["performers"] or {"": report}).values())
    largest = max(engine.largest for engine in engines)
    every = np.concatenate(ages)
    return Passage(
        pace(written[0]), sent, 0, lost, every, cpu / took, now, peak, largest, report
    ), fewest


@contextmanager
def _tracker(port: int) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))
        yield out


@contextmanager
def _apart(words: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """A bridge on the first of this process's cores, which meanwhile has the others.

    Raises RuntimeError where there is but one core.
    """
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        raise RuntimeError("a bridge and its trackers need two cores")
    os.sched_setaffinity(0, cores[:1])  # a process starts where the one that starts it is
    try:
        with started(words) as process:
            os.sched_setaffinity(0, cores[1:])
            yield process
    finally:
        os.sched_setaffinity(0, cores)


def _await(
    process: subprocess.Popen[str],
    trackers: Sequence[socket.socket],
    streams: Sequence[Stream],
    engines: Sequence[Engine],
) -> None:
    """Sends layouts until somebody listens to all: what nobody listens to is refused, which the
    next to be sent tells.
    """
    deadline, deaf = time.monotonic() + LONGEST, True
    while deaf:
        deaf = False
        for tracker, stream in zip(trackers, streams, strict=True):
            try:
                tracker.send(stream.layout)
                time.sleep(0.001)
                tracker.send(stream.layout)
            except ConnectionRefusedError:
                deaf = True
        _listen(engines, 0.05)
        if process.poll() is not None:
            raise RuntimeError(f"the bridge ended: {process.communicate()[1]}")
        if time.monotonic() > deadline:
            raise RuntimeError(f"nobody listened in {LONGEST:.0f} s")


def _play(
    trackers: Sequence[socket.socket], streams: Sequence[Stream], engines: Sequence[Engine]
) -> Times:
    """Sends the streams; when each frame was sent, (streams, frames) seconds since 1970. Trackers
    know nothing of each other: they send one after the other, evenly.
    """
    rate, frames = streams[0].rate, len(streams[0].packets)
    written = np.empty((len(streams), frames))
    start = time.monotonic()
    for frame in range(frames):
        for number, (tracker, stream) in enumerate(zip(trackers, streams, strict=True)):
            due = start + (frame + number / len(streams)) / rate
            _listen(engines, due - time.monotonic())
            if frame % round(rate) == 0:
                tracker.send(stream.layout)
            written[number, frame] = time.time()
            tracker.send(stream.packets[frame])
    return written


def _listen(engines: Sequence[Engine], seconds: float) -> None:
    """Takes what comes for so long; at least what has come."""
    end, left = time.monotonic() + seconds, max(0.0, seconds)
    while left >= 0.0:
        readable, _, _ = select.select(engines, [], [], left)
        for engine in readable:
            engine.receive()
        left = end - time.monotonic()
