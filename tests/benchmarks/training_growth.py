"""How the time of each step of training grows with the captures:
`python -m tests.benchmarks.training_growth DATA`.

The captures of DATA are taken once, twice and four times, each time on other bodies and at another
speed (see `training_size`, which measures the whole command and its memory). Each row's figures are
seconds, and beside them how many times those of the row before: twice the data should take no more
than about twice the time. The steps are those of one fit by the recipe `local`, as the command runs
them: on all cores, with one thread for linear algebra.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from bridge.body_frame import PAPER_FRAME
from drivers.errors import MarkerbridgeError
from tests.benchmarks.training_size import SIX, write_others
from training.corpus import read_corpus
from training.dataset import Take, load_training, training_captures
from training.export import to_onnx
from training.fitting import cluster, fit_mixture, forest_rows
from training.forest import grow_forest, sparse_forest
from training.moments import columns_of
from training.recipe import RECIPES, MixtureRecipe
from training.workers import workers

STEPS = ("read and cut", "cluster", "forest", "whole fit", "file")

T = TypeVar("T")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="a folder of C3D files")
    parser.add_argument(
        "--repeats", default="1,2,4", help="how often the captures are taken (default: 1,2,4)"
    )
    options = parser.parse_args()
    takes = load_training(options.data, print)
    print(f"|  frames | segments | leaves | poses | {' | '.join(f'{s}, s' for s in STEPS)} |")
    print(f"|{' --- |' * (4 + len(STEPS))}", flush=True)
    before: list[float] = []
    for repeats in map(int, options.repeats.split(",")):
        counts, seconds = measured(takes, repeats)
        ratios = [f" (× {a / b:.1f})" for a, b in zip(seconds, before, strict=False)]
        cells = [f"{one:,}" for one in counts]
        told = ratios or [""] * len(seconds)
        cells += [f"{one:.2f}{ratio}" for one, ratio in zip(seconds, told, strict=True)]
        print(f"| {' | '.join(cells)} |", flush=True)
        before = seconds
    return 0


def measured(takes: Sequence[Take], repeats: int) -> tuple[tuple[int, ...], list[float]]:
    """Frames, segments, leaves and poses of so many times the takes; seconds of each of STEPS."""
    recipe = RECIPES["local"]
    assert isinstance(recipe, MixtureRecipe)
    principal = tuple(SIX.split(","))
    inputs = columns_of(PAPER_FRAME.features((*principal, *PAPER_FRAME.references)))
    seconds: list[float] = []

    def timed(step: Callable[[], T]) -> T:
        start = time.perf_counter()
        found = step()
        seconds.append(time.perf_counter() - start)
        return found

    with tempfile.TemporaryDirectory() as scratch, threadpool_limits(1), workers(None):
        folder = Path(scratch, "captures")
        write_others(folder, takes, repeats)
        chosen = training_captures(folder)
        corpus = timed(lambda: read_corpus(folder, chosen, recipe, lambda *_: None, unusable))
        everything = np.arange(len(corpus.frames))
        leaves = timed(lambda: cluster(corpus, everything, recipe, 0))
        rows = forest_rows(corpus, leaves, inputs)
        timed(lambda: sparse_forest(grow_forest(rows.x, rows.leaf, recipe.forest, 0), hard=False))
        fitted = timed(lambda: fit_mixture(corpus, everything, principal, recipe, 0))
        timed(lambda: to_onnx(fitted.graph, fitted.info))
    counts = int(corpus.frames.sum()), len(everything), leaves.count, len(corpus.poses)
    return counts, seconds


def unusable(why: str) -> None:
    """A capture written here that cannot be read is a fault of this program."""
    raise MarkerbridgeError(why)


if __name__ == "__main__":
    sys.exit(main())
