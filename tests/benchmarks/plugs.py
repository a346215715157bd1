"""How soon a session goes on when a plug is put in again: `python -m tests.benchmarks.plugs`."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from tests.end_to_end.plugs import cycles

LIMIT = 0.5  # s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=100)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        recovered, counters = cycles(Path(folder), options.cycles)
    p50, p99 = np.quantile(recovered, [0.5, 0.99])
    print(
        f"{options.cycles} cycles: back after p50 {p50 * 1000:.0f}, p99 {p99 * 1000:.0f}, at most "
        f"{max(recovered) * 1000:.0f} ms; {sum(r > LIMIT for r in recovered)} over {LIMIT} s"
    )
    print(", ".join(f"{name} {count}" for name, count in sorted(counters.items())))


if __name__ == "__main__":
    main()
