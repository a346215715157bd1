"""What calibration on another take of a person gains:
`python -m tests.benchmarks.another_take DATA`.

For each person with real captures in the splits train and test: a model is trained on everybody
else, calibrated on the person's train captures, one after the other, and scored on the test ones.
Printed as a table, RMS in mm. It takes as long as training, times the people.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from bridge.model import Model
from drivers.frame import Floats
from training.calibration import adapted
from training.corpus import read_corpus
from training.dataset import TEST, UNKNOWN, Take, captures, read_take, training_captures
from training.evaluation import evaluate, mean_scores
from training.export import to_onnx
from training.pipeline import fit_model
from training.recipe import RECIPES
from training.train_command import check_principal
from training.workers import workers

LONGEST = 30.0  # s of the train captures that are taken: of each its start, all alike


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="a folder of C3D files with splits")
    parser.add_argument("--estimator", choices=tuple(RECIPES), default="best")
    parser.add_argument("--principal", default="LWRB,RWRB,RBWT,LANK,RSHN,RANK")
    options = parser.parse_args()
    principal = check_principal(options.principal)
    recipe = RECIPES[options.estimator]
    known = training_captures(options.data)
    tests = [one for one in captures(options.data, TEST) if one.real]
    people = {one.subject for one in known if one.real} & {one.subject for one in tests}
    print("| person | seconds | generic | calibrated | ratio |")
    print("| --- | --- | --- | --- | --- |", flush=True)
    reached = []
    with threadpool_limits(1), workers(None), tempfile.TemporaryDirectory() as scratch:
        corpus = read_corpus(options.data, known, recipe, lambda *_: None, print)
        for person in sorted(people - {UNKNOWN}):
            theirs = [one for one in known if one.subject == person]
            others = corpus.without(frozenset(one.name for one in theirs))
            fitted = fit_model(corpus, others, principal, recipe, 0)
            path = Path(scratch, f"without-{person}.onnx")
            path.write_bytes(to_onnx(fitted.graph, fitted.info))
            generic = Model(path)
            xyz, rate = recording([read_take(options.data, one) for one in theirs if one.real])
            takes = [read_take(options.data, one) for one in tests if one.subject == person]
            before, after = scored(generic, takes), scored(adapted(generic, xyz, rate), takes)
            reached.append((before, after))
            print(
                f"| {person} | {len(xyz) / rate:.0f} | {before:.1f} | {after:.1f} "
                f"| {after / before:.2f} |",
                flush=True,
            )
    before, after = np.mean(reached, axis=0)
    print(f"| mean | | {before:.1f} | {after:.1f} | {after / before:.2f} |")
    return 0


def recording(takes: Sequence[Take]) -> tuple[Floats, float]:
    """The starts of the takes, LONGEST seconds together, and their rate, Hz."""
    rate = takes[0].rate
    share = round(LONGEST * rate / len(takes))
    return np.concatenate([take.xyz[:share] for take in takes]), rate


def scored(model: Model, takes: Sequence[Take]) -> float:
    """The mean RMS over the takes, mm."""
    found = mean_scores(evaluate(model, takes)).rms_mm
    return np.nan if found is None else found


if __name__ == "__main__":
    sys.exit(main())
