"""Findings about tracked markers that are never there, never move, or are missing too often."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from bridge.doctor.finding import Finding, Grade
from bridge.model import ModelInfo
from drivers.frame import Floats

OFTEN_MISSING = 0.2  # share of the frames
USED = 0.5  # share of the frames that a marker has to be in to be judged by
ENOUGH = 10  # frames that tell whether it moves
STILL = 1e-6  # m: nothing that is measured moves less


@dataclass
class Faults:
    """Tracked markers that are not what they should be. missing: in which share of the frames."""

    never: list[str] = field(default_factory=list)
    at_origin: list[str] = field(default_factory=list)
    still: list[str] = field(default_factory=list)
    missing: dict[str, float] = field(default_factory=dict)

    @property
    def useless(self) -> set[str]:
        """Those by which nothing can be judged."""
        rare = [label for label, share in self.missing.items() if share > 1 - USED]
        return {*self.never, *self.at_origin, *self.still, *rare}


def faults_of(info: ModelInfo, labels: tuple[str, ...], xyz: Floats) -> Faults:
    """Of a stream of these labels, (N, M, 3) metres, NaN where a marker is missing."""
    faults = Faults()
    for label in info.tracked:
        if label not in labels:
            continue
        path = xyz[:, labels.index(label)]
        path = path[~np.isnan(path[:, 0])]
        share = 1 - len(path) / len(xyz)
        if not len(path):
            faults.never.append(label)
        elif np.mean(~path.any(axis=1)) > USED:
            faults.at_origin.append(label)
        elif len(path) >= ENOUGH and np.ptp(path, axis=0).max() < STILL:
            faults.still.append(label)
        if len(path) and share > OFTEN_MISSING:
            faults.missing[label] = share
    return faults


def presence_findings(faults: Faults) -> Iterator[Finding]:
    """What is said of them."""
    if faults.never:
        yield Finding(Grade.WRONG, "never-seen", f"never seen: {', '.join(faults.never)}")
    if faults.at_origin:
        yield Finding(
            Grade.WRONG,
            "at-origin",
            f"at the origin most of the time: {', '.join(faults.at_origin)}. A sender that means "
            "missing has to leave them out, or send NaN",
        )
    if faults.still:
        yield Finding(
            Grade.WRONG,
            "still",
            f"not moving at all: {', '.join(faults.still)}. Does the sender repeat an old value of "
            "what it lost?",
        )
    if faults.missing:
        table = ", ".join(f"{label} {share:.0%}" for label, share in faults.missing.items())
        yield Finding(
            Grade.POOR, "missing", f"missing in over {OFTEN_MISSING:.0%} of the frames: {table}"
        )
