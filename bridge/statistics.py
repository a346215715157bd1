"""What a session counts, in constant memory."""

from __future__ import annotations

import numpy as np

_EDGES = np.geomspace(1e-6, 100.0, 801)  # s; 2.3 % a step


class Durations:
    """Quantiles of durations, to within 2.3 %."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(_EDGES) + 1, int)
        self.count = 0
        self.maximum = 0.0
        self.last: float | None = None

    def add(self, seconds: float) -> None:
        """Counts a duration; a negative one (a clip played ahead of its time) is none."""
        if seconds < 0:
            return
        self._counts[np.searchsorted(_EDGES, seconds)] += 1
        self.count += 1
        self.last = seconds
        self.maximum = max(self.maximum, seconds)

    def quantile(self, share: float) -> float | None:
        """Seconds that this share of the durations does not exceed; None where there are none."""
        if not self.count:
            return None
        bin_ = int(np.searchsorted(np.cumsum(self._counts), share * self.count))
        return float(min(_EDGES[min(bin_, len(_EDGES) - 1)], self.maximum))


class Mean:
    """A running mean; NaN values do not count."""

    def __init__(self) -> None:
        self.count = 0
        self._sum = 0.0
        self.last: float | None = None

    def add(self, value: float) -> None:
        if value == value:
            self.count += 1
            self._sum += value
            self.last = value

    @property
    def mean(self) -> float | None:
        return self._sum / self.count if self.count else None
