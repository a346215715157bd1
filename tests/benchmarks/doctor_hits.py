"""How often the doctor names the right fix: real captures, made wrong in every way it knows.

    python -m tests.benchmarks.doctor_hits [--split test] [--all-markers]

Five seconds of each capture, through the native OSC dialect. A hit is the very address that mends
it, and nothing else found wrong or poor.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import os
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bridge.doctor.examination import examine
from bridge.doctor.finding import Grade
from bridge.doctor.heard import Heard, read_again
from bridge.doctor.worlds import WORLDS, kind
from bridge.model import Model
from drivers.c3d_file import read_c3d
from drivers.coordinates import FRAMES, UNITS, Frame
from drivers.frame import Floats, Layout
from drivers.transport import Received
from drivers.url import Url
from drivers.wire.osc_native import NativeOscEncoder

ADDRESS = "osc://127.0.0.1:9100"
SECONDS = 5.0

# What was done to it, the labels and positions on the wire, and what the address has to say:
# labels that mean others, and a world, where they are not ours.
Case = tuple[str, tuple[str, ...], Floats, dict[str, str], Frame]


def cases(labels: tuple[str, ...], tracked: tuple[str, ...], xyz: Floats) -> Iterator[Case]:
    """Everything that is tried on one capture."""
    ours = FRAMES["cmu"]
    yield "clean", labels, xyz, {}, ours
    for name, frame in FRAMES.items():
        yield f"frame {name}", labels, frame.from_ours(xyz), {}, frame
    for name, unit in UNITS.items():
        yield f"unit {name}", labels, xyz / np.float32(unit), {}, Frame("x,y,z", unit)
    for world in WORLDS:
        yield "axes", labels, world.from_ours(xyz), {}, world
    for pair in itertools.combinations(tracked, 2):
        exchange = dict([pair, pair[::-1]])
        yield "two exchanged", labels, _exchanged(labels, xyz, exchange), exchange, ours
    if labels != tracked:
        return  # on all markers, a mirror image and exchanged sides are the same
    other = {"L": "R", "R": "L"}
    sides = {name: other[name[0]] + name[1:] for name in labels if name[0] in other}
    sides = {name: across for name, across in sides.items() if across in labels}
    yield "sides exchanged", labels, _exchanged(labels, xyz, sides), sides, ours
    numbers = tuple(str(n) for n in range(1, len(labels) + 1))
    unity = FRAMES["unity"]
    named = dict(zip(numbers, labels, strict=True))
    yield "numbers, unity", numbers, unity.from_ours(xyz), named, unity
    mixed = dict(zip(labels, np.roll(labels, 1).tolist(), strict=True))
    yield "all mixed up", labels, np.roll(xyz, 1, axis=1), mixed, ours


def _exchanged(labels: tuple[str, ...], xyz: Floats, exchange: dict[str, str]) -> Floats:
    return xyz[:, [labels.index(exchange.get(label, label)) for label in labels]]


def is_hit(address: str, meant: dict[str, str], frame: Frame) -> bool:
    """Whether the address says what it should."""
    options = Url.parse(address).options
    world = FRAMES[options.get("frame", "cmu")]
    world = Frame(options.get("axes", world.axes), UNITS.get(options.get("unit", ""), world.unit))
    pairs = [pair.split(":") for pair in options.get("labels", "").split(",") if pair]
    same_world = kind(world) == kind(frame) and np.isclose(world.unit, frame.unit)
    return bool(same_world and dict(pairs) == meant)


def heard(labels: tuple[str, ...], rate: float, xyz: Floats) -> Heard:
    encoder = NativeOscEncoder()
    packets = [encoder.encode_layout(Layout(labels, rate))]
    packets += [encoder.encode_frame(n, n / rate, frame) for n, frame in enumerate(xyz)]
    received = [Received(data, 100 + n / rate) for n, data in enumerate(packets)]
    return read_again(Heard(ADDRESS, len(xyz) / rate, received=received), ADDRESS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--split", default="train")
    parser.add_argument("--all-markers", action="store_true", help="send all, not the tracked ones")
    options = parser.parse_args()
    data = Path(os.environ["MARKERBRIDGE_DATA"])
    info = Model("default").info
    tried: Counter[str] = Counter()
    hits: Counter[str] = Counter()
    began = time.process_time()
    with (data / "manifest.csv").open(newline="") as file:
        rows = [
            r for r in csv.DictReader(file) if (r["kind"], r["split"]) == ("real", options.split)
        ]
    for row in rows:
        clip = read_c3d(data / row["file"], None if options.all_markers else info.tracked)
        rate = clip.layout.rate
        some = clip.xyz[: round(SECONDS * rate)]
        for name, labels, xyz, meant, frame in cases(clip.layout.labels, info.tracked, some):
            findings, address = examine(heard(labels, rate, xyz), info)
            bad = [finding for finding in findings if finding.grade is not Grade.NOTE]
            spurious = [finding for finding in bad if not finding.options]
            tried[name] += 1
            if is_hit(address, meant, frame) and not spurious:
                hits[name] += 1
            else:
                print(f"{row['file']}, {name}: {address}", *(f.text for f in bad), sep="\n    ")
    for name, count in tried.items():
        print(f"{name:<18}{hits[name]:>5} of {count}")
    print(
        f"{len(rows)} captures, {(time.process_time() - began) / tried.total():.2f} s of CPU each"
    )


if __name__ == "__main__":
    main()
