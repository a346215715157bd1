"""What a run of the benchmarks works on, and how long it takes."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from drivers.c3d_file import Clip, read_c3d

T = TypeVar("T")

WALK, RUN = "real/02_02.c3d", "real/02_03.c3d"  # of the test split


@dataclass(frozen=True, slots=True)
class Plan:
    """data: a folder of captures with a manifest. local: a model of `train --estimator local` on
    them, made when it is first asked for. given: whether it was there already.
    """

    data: Path
    local: Path
    given: bool
    quick: bool

    def either(self, whole: T, quick: T) -> T:
        """What is right for a whole run, or for a quick one."""
        return quick if self.quick else whole

    def local_model(self) -> Path:
        """The model file; quickly trained, without folds, where there is none yet."""
        if not self.local.is_file():
            train(self, "--no-folds")
        return self.local

    def clips(self, labels: tuple[str, ...]) -> list[Clip]:
        """A walk and a run that no model has seen, these markers of them."""
        return [read_c3d(self.data / name, labels) for name in (WALK, RUN)]


def train(plan: Plan, *options: str) -> None:
    """Trains the local model by the real command. Raises CalledProcessError."""
    command = [sys.executable, "-P", "-m", "bridge.cli", "train", str(plan.data)]
    command += ["--estimator", "local", "--out", str(plan.local), *options]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
