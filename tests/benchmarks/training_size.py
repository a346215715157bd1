"""Time and memory of training as the captures grow:
`python -m tests.benchmarks.training_size DATA`.

Sets of several sizes are made from the captures of DATA by repeating them with other bodies (each
marker shifted, all scaled) at another speed, so that no two segments are the same. Each is trained
on by the command in a process of its own, without folds. Printed as a table, and the ratio of each
to the first: that is what carries over to another machine.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bridge.model import Model
from drivers.c3d_file import write_c3d
from drivers.frame import Floats, Layout
from drivers.marker_set import MARKERS
from training.dataset import Take, load_training

SIX = "LFHD,RELB,LUPA,RSHN,LTOE,RTOE"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="a folder of C3D files")
    parser.add_argument(
        "--repeats", default="1,4,16", help="how often the captures are taken (default: 1,4,16)"
    )
    options = parser.parse_args()
    takes = load_training(options.data, print)
    print("|   frames | captures | segments | leaves | seconds | peak MB | ratio of time, memory |")
    print("| --- | --- | --- | --- | --- | --- | --- |", flush=True)
    first = None
    for repeats in map(int, options.repeats.split(",")):
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch, "captures")
            write_others(folder, takes, repeats)
            seconds, peak, training = train(folder, Path(scratch, "model.onnx"))
        first = first or (seconds, peak)
        print(
            f"| {training['frames']:,} | {training['sequences']} | {training['segments']} "
            f"| {training['leaves']} | {seconds:.0f} | {peak:.0f} "
            f"| {seconds / first[0]:.1f}, {peak / first[1]:.2f} |",
            flush=True,
        )
    return 0


def write_others(folder: Path, takes: Sequence[Take], repeats: int) -> None:
    """Writes the takes so many times, each time by somebody else: always the same for a number."""
    for number in range(repeats):
        (folder / str(number)).mkdir(parents=True)
        for index, take in enumerate(takes):
            random = np.random.default_rng([number, index])
            path = folder / str(number) / f"{index}.c3d"
            write_c3d(path, Layout(MARKERS, take.rate), another(take.xyz, random))


def another(xyz: Floats, random: np.random.Generator) -> Floats:
    """The motion (N, 41, 3) by somebody else: at another speed, on another body."""
    frames = round(len(xyz) * random.uniform(0.9, 1.1))
    place = np.linspace(0, len(xyz) - 1, frames)
    before = np.minimum(place.astype(int), len(xyz) - 2)
    share = (place - before)[:, None, None]
    moved = (1 - share) * xyz[before] + share * xyz[before + 1]
    scaled = moved * random.normal(1.0, 0.05)
    return (scaled + random.normal(scale=0.008, size=(1, *xyz.shape[1:]))).astype(np.float32)


TRAIN = """
import sys
from pathlib import Path
from bridge.cli import main
status = main(sys.argv[1:])
print(next(l for l in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in l))
sys.exit(status)
"""


def train(folder: Path, out: Path) -> tuple[float, float, dict[str, int]]:
    """Seconds, peak of resident memory in MB, and the training record."""
    argv = ["train", str(folder), "--out", str(out), "--principal", SIX, "--no-folds"]
    start = time.monotonic()
    # The kernel's own record of a child's peak counts the parent's memory before exec.
    done = subprocess.run(
        [sys.executable, "-c", TRAIN, *argv],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        check=True,
    )
    seconds = time.monotonic() - start
    return seconds, int(done.stdout.split()[1]) / 1024, Model(out).info.training


if __name__ == "__main__":
    sys.exit(main())
