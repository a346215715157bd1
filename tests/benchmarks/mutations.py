"""Spoilt packets by the million: `python -m tests.benchmarks.mutations [--count N] [WIRE ...]`.

Each codec gets so many, shared by its variants; so do the OSC dialects among them, as they share
the corpus. Fails where a packet was not accounted for, cost over 10 ms of CPU, or kept a good one
from being read.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from drivers.wire.registry import DIALECTS
from tests.drivers.mutations import ADDRESSES, Outcome, run


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("wires", nargs="*", metavar="WIRE", default=list(ADDRESSES))
    options = parser.parse_args()
    shares = Counter(_family(name) for name in ADDRESSES)
    counts = [options.count // shares[_family(name)] for name in options.wires]
    seeds = [options.seed] * len(counts)
    print(f"{'wire':15}{'packets':>9}{'not told':>9}{'deaf':>6}{'slow':>6}{'memory':>9}{'each':>8}")
    failed = False
    with ProcessPoolExecutor(options.processes) as pool:
        outcomes = pool.map(run, options.wires, counts, seeds)
        for name, outcome in zip(options.wires, outcomes, strict=True):
            _tell(name, outcome)
            failed |= bool(outcome.unaccounted or outcome.deaf_after or outcome.slow)
    return int(failed)


def _family(name: str) -> str:
    """The codec of a wire, by the beginning of its address; all dialects are one."""
    address = ADDRESSES[name]
    return "osc" if name in DIALECTS else address.partition("codec=")[2].partition("&")[0]


def _tell(name: str, outcome: Outcome) -> None:
    print(
        f"{name:15}{outcome.packets:9}{len(outcome.unaccounted):9}{len(outcome.deaf_after):6}"
        f"{len(outcome.slow):6}{outcome.grown / 1e6:6.1f} MB"
        f"{outcome.seconds / outcome.packets * 1e6:5.0f} µs",
        flush=True,
    )
    for kind in ("unaccounted", "deaf_after", "slow"):
        for packet in getattr(outcome, kind)[:3]:
            print(f"    {kind}: {packet[:200]!r}")
    bad = {name: count for name, count in outcome.counters.items() if name != "bytes" and count}
    print("    " + ", ".join(f"{name} {count}" for name, count in sorted(bad.items())))


if __name__ == "__main__":
    sys.exit(main())
