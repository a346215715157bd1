"""What goes wrong with measured markers: noise, dropped samples, gaps. Seeded, frame by frame."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from drivers.frame import Floats

_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@dataclass(frozen=True, slots=True)
class Gaps:
    """Bursts of missing samples: share of each marker's samples, lengths uniform, in frames."""

    share: float
    shortest: int
    longest: int

    @property
    def mean_seen(self) -> float:
        """Frames between two gaps in the mean, for a share above 0."""
        return (self.shortest + self.longest) / 2 * (1 - self.share) / self.share


@dataclass(frozen=True, slots=True)
class Faults:
    """What to do to a clean stream. noise: standard deviation per coordinate, metres. drop: share
    of samples missing, frame by frame. gaps: bursts of missing samples.
    """

    noise: float = 0.0
    drop: float = 0.0
    gaps: Gaps | None = None


def parse_noise(text: str) -> float:
    """`1mm`, `0.5cm` or `0.001m` as metres. Raises ValueError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)(mm|cm|m)", text.strip())
    if not match:
        raise ValueError(f"'{text}' is no length: write for example 1mm")
    return float(match[1]) * _LENGTHS[match[2]]


def parse_share(text: str) -> float:
    """`5%` as 0.05. Raises ValueError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)%", text.strip())
    if not match or not float(match[1]) < 100:
        raise ValueError(f"'{text}' is no share below 100%: write for example 5%")
    return float(match[1]) / 100


def parse_gaps(text: str) -> Gaps:
    """`20%:10-100`: a fifth of the samples, in gaps of 10 to 100 frames. Raises ValueError."""
    share, _, lengths = text.partition(":")
    match = re.fullmatch(r"(\d+)-(\d+)", lengths.strip())
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"'{text}' are no gaps: write for example 20%:10-100 (share:frames)")
    gaps = Gaps(parse_share(share), int(match[1]), int(match[2]))
    if gaps.share and gaps.mean_seen < 1:
        raise ValueError(f"'{text}' leaves less than a frame between two gaps: make them longer")
    return gaps


class Corruption:
    """Applies faults to one stream of `markers` markers; the same seed gives the same faults."""

    def __init__(self, faults: Faults, markers: int, seed: int | list[int] = 0) -> None:
        self._faults = faults
        self._random = np.random.default_rng(seed)
        # Per marker: frames until its state changes, and whether it is in a gap now.
        self._left = np.zeros(markers, int)
        self._hidden = np.zeros(markers, bool)
        if faults.gaps and faults.gaps.share:
            self._start(faults.gaps)

    def apply(self, xyz: Floats) -> Floats:
        """The next frame, (markers, 3) metres, as the device would measure it."""
        faults = self._faults
        measured = xyz.copy()
        if faults.noise:
            measured += self._random.normal(0.0, faults.noise, xyz.shape).astype(np.float32)
        if faults.drop:
            measured[self._random.random(len(xyz)) < faults.drop] = np.nan
        if faults.gaps and faults.gaps.share:
            measured[self._hidden] = np.nan
            self._left -= 1
            for marker in np.flatnonzero(self._left <= 0):
                self._hidden[marker] = not self._hidden[marker]
                self._left[marker] = self._length(faults.gaps, bool(self._hidden[marker]))
        return measured

    def _start(self, gaps: Gaps) -> None:
        """Starts each marker at a random moment of its life, so a short clip has its share too."""
        lengths = np.arange(gaps.shortest, gaps.longest + 1)
        for marker in range(len(self._left)):
            self._hidden[marker] = self._random.random() < gaps.share
            if self._hidden[marker]:
                # A moment falls into a gap in proportion to the gap's length.
                length = self._random.choice(lengths, p=lengths / lengths.sum())
                self._left[marker] = self._random.integers(1, length + 1)
            else:
                self._left[marker] = self._length(gaps, hidden=False)

    def _length(self, gaps: Gaps, hidden: bool) -> int:
        if hidden:
            return int(self._random.integers(gaps.shortest, gaps.longest + 1))
        return int(self._random.geometric(1 / gaps.mean_seen))
