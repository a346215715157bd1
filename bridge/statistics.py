"""What a session counts, in constant memory."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from statistics import median_low

import numpy as np
import numpy.typing as npt

from bridge.pose import Provenance

LATELY = 1.0  # s that "now" means
KEPT = 1024  # passages of the last second that a hop knows: fewer than that at most rates

_EDGES: list[float] = np.geomspace(1e-6, 100.0, 801).tolist()  # s; 2.3 % a step


class Durations:
    """Quantiles of durations, to within 2.3 %."""

    def __init__(self) -> None:
        self._counts = [0] * (len(_EDGES) + 1)
        self.count = 0
        self.maximum = 0.0

    def add(self, seconds: float) -> None:
        """Counts a duration, 0 or more."""
        self._counts[bisect_left(_EDGES, seconds)] += 1
        self.count += 1
        self.maximum = max(self.maximum, seconds)

    def quantiles(self, *shares: float) -> list[float | None]:
        """For each share the seconds that so much of the durations does not exceed; None where
        there are none.
        """
        sums = list(accumulate(self._counts))
        if not sums[-1]:
            return [None] * len(shares)
        bins = [bisect_left(sums, share * sums[-1]) for share in shares]
        return [min(_EDGES[min(bin_, len(_EDGES) - 1)], self.maximum) for bin_ in bins]


@dataclass(frozen=True, slots=True)
class Ages:
    """How old what passed a hop was, in seconds; None where nothing did.

    now, worst: median and maximum of the last second. p50, p99, max: of all.
    """

    count: int
    now: float | None
    worst: float | None
    p50: float | None
    p99: float | None
    max: float | None


class Hop:
    """A point on the way of a frame, and how old what passes it is by then.

    One thread may add while others ask.
    """

    def __init__(self) -> None:
        self._all = Durations()
        self._lately: deque[tuple[float, float]] = deque(maxlen=KEPT)

    def passed(self, born: float, now: float) -> None:
        """Something of that time passes; not counted where it is of a time to come, as in a clip
        that is played faster than it was recorded.
        """
        if now >= born:
            self._all.add(now - born)
            self._lately.append((now, now - born))

    def ages(self, now: float) -> Ages:
        """What passed until now."""
        known = self._all
        p50, p99 = known.quantiles(0.50, 0.99)
        lately = [age for at, age in self._lately.copy() if at > now - LATELY]
        return Ages(
            count=known.count,
            now=median_low(lately) if lately else None,
            worst=max(lately, default=None),
            p50=p50,
            p99=p99,
            max=known.maximum if known.count else None,
        )


@dataclass(frozen=True, slots=True)
class MarkerStatus:
    """A tracked marker: measured, imputed or lost (as Provenance), for so many seconds now; and the
    frames in which it was not measured.
    """

    state: str
    seconds: float
    missing: int


class Presence:
    """Which markers are measured, since when, and how often they were not.

    imputed: samples of markers that were filled in. lost: poses of which nothing is known.
    """

    def __init__(self, rows: Mapping[str, int]) -> None:
        """rows: where each marker is in a pose, by label."""
        self.imputed = self.lost = 0
        self._labels = tuple(rows)
        self._rows = np.array([*rows.values()], int)
        self._states: npt.NDArray[np.uint8] | None = None
        self._since = np.zeros(len(rows))
        self._missing = np.zeros(len(rows), int)
        # Of the provenance that was last: it is that of most poses to come.
        self._known = b""
        self._away = np.zeros(len(rows), bool)
        self._imputed = 0
        self._lost = False

    def add(self, provenance: npt.NDArray[np.uint8], now: float) -> None:
        """Counts a pose by its provenance (M,)."""
        if (given := provenance.tobytes()) != self._known:
            self._known = given
            self._change(provenance, now)
        if self._imputed or self._lost:
            self._missing += self._away
            self.imputed += self._imputed
            self.lost += self._lost

    def _change(self, provenance: npt.NDArray[np.uint8], now: float) -> None:
        states = provenance[self._rows]
        if self._states is None:
            self._since[:] = now
        else:
            self._since[states != self._states] = now
        self._states, self._away = states, states != Provenance.MEASURED
        self._imputed = int((provenance == Provenance.IMPUTED).sum())
        self._lost = bool((provenance == Provenance.LOST).all())

    def markers(self, now: float) -> dict[str, MarkerStatus]:
        """By label, in the model's order; none before the first pose."""
        if self._states is None:
            return {}
        known = zip(self._labels, self._states, self._since, self._missing, strict=True)
        return {
            label: MarkerStatus(
                Provenance(state).name.lower(), max(0.0, now - float(since)), int(missing)
            )
            for label, state, since, missing in known
        }


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
