"""How fast it is, as a table of ratios: `python -m tests.benchmarks [PART ...] [--quick]`.

Absolute times say little without the machine: it is told first, with the times of two loops that
never change, measured before and after.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.benchmarks import (
    growth,
    highest_rate,
    latency,
    nearest,
    performers,
    resources,
    speed,
    training_time,
)
from tests.benchmarks.machine import calibration, machine
from tests.benchmarks.plan import Plan
from tests.benchmarks.table import HEAD, Row, as_json

# In this order: training leaves the model that others work on.
PARTS: dict[str, Callable[[Plan], Iterator[Row]]] = {
    "training": training_time.rows,
    "estimator": speed.rows,
    "nearest": nearest.rows,
    "latency": latency.rows,
    "rate": highest_rate.rows,
    "performers": performers.rows,
    "resources": resources.rows,
    "growth": growth.rows,
}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks", description=__doc__.splitlines()[0]
    )
    add = parser.add_argument
    add("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)} (default: all)")
    add("--quick", action="store_true", help="a few minutes: to see that it works")
    add(
        "--data",
        type=Path,
        default=os.environ.get("MARKERBRIDGE_DATA"),
        metavar="FOLDER",
        help="captures with a manifest.csv (default: $MARKERBRIDGE_DATA)",
    )
    add(
        "--local",
        type=Path,
        metavar="FILE",
        help="a model of `markerbridge train FOLDER "
        "--estimator local`, in place of training one; written there where there is none",
    )
    add("--json", type=Path, metavar="FILE", help="writes the rows there as well")
    options = parser.parse_args()
    unknown = [part for part in options.parts if part not in PARTS]
    if unknown:
        parser.error(f"no part {', '.join(unknown)}: there are {', '.join(PARTS)}")
    if options.data is None or not (options.data / "manifest.csv").is_file():
        parser.error("--data FOLDER, or MARKERBRIDGE_DATA: a folder of captures with manifest.csv")
    chosen = [part for part in PARTS if part in options.parts or not options.parts]
    with tempfile.TemporaryDirectory() as scratch:
        local = options.local or Path(scratch, "local.onnx")
        told = _run(Plan(options.data, local, local.is_file(), options.quick), chosen)
    if options.json is not None:
        options.json.write_text(json.dumps(told, indent=2) + "\n")
    return 1 if told["failed"] else 0


def _run(plan: Plan, chosen: list[str]) -> dict[str, object]:
    here, before = machine(), calibration()
    print(", ".join(f"{name} {value}" for name, value in here.items()))
    print(f"calibration: {_told(before)}\n\n{HEAD}", flush=True)
    found: dict[str, list[Row]] = {}
    failed: dict[str, str] = {}
    for part in chosen:
        began = time.monotonic()
        found[part] = []
        try:
            for row in PARTS[part](plan):
                found[part].append(row)
                print(row, flush=True)
        except Exception as error:  # the others have taken minutes, and are as good as before
            failed[part] = str(error) or type(error).__name__
            print(f"{part} failed: {failed[part]}", file=sys.stderr)
        print(f"{part}: {time.monotonic() - began:.0f} s", file=sys.stderr)
    after = calibration()
    print(f"\ncalibration after: {_told(after)}")
    return {
        "machine": here,
        "calibration": [before, after],
        "rows": as_json(found),
        "failed": failed,
    }


def _told(times: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:,.1f} µs" for name, value in times.items())


if __name__ == "__main__":
    sys.exit(main())
