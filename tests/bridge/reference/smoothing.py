"""`bridge.smoothing` in numpy, all markers at once."""

from __future__ import annotations

from math import comb

import numpy as np
import numpy.typing as npt

from bridge.smoothing import (
    BEND,
    FIRST_NOISE,
    FLOOR,
    FORGET,
    GROWTH,
    LISTENING,
    LONGEST,
    SHORTEST,
)
from drivers.frame import Floats

Array = npt.NDArray[np.float64]

_STAGES = 4
_ORDER = 6
_WINDOW = _ORDER + 1  # samples that a difference takes
# The difference of white noise has the variance of the noise. Row i: for a ring with its newest
# sample at i.
_DIFFERENCE = np.array([(-1.0) ** k * comb(_ORDER, k) for k in range(_WINDOW)])
_DIFFERENCE /= comb(2 * _ORDER, _ORDER) ** 0.5
_DIFFERENCES = np.array([np.roll(_DIFFERENCE, newest + 1) for newest in range(_WINDOW)])
_ROOT_MEAN = 0.8222  # mean of the square root of |n|, n standard normal: 2^(1/4) G(3/4) / sqrt(pi)
# Variance of the bend over its three coordinates: this x variance of the noise x interval / tau
# (the integral of w^4 / (1 + w^2)^4 over all w is pi / 16).
_BEND_VARIANCE = 3.0 / 32.0
_COORDINATES = np.ones(3)  # to sum over them


class NoiseFilter:
    """Takes the noise out of markers that are followed from frame to frame.

    A clean stream goes through all but unchanged. A missing marker stays missing; the longer it
    was away, the less of what was before counts when it is back, and after `FORGET` nothing does.
    Markers do not influence each other.

    markers: how many, T.
    """

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        count = self._markers
        self._stages = np.full((_STAGES, count, 3), np.nan)
        self._memory = np.full(count, SHORTEST)  # s, tau
        self._unseen = np.full(count, np.inf)  # s since the last sighting
        self._recent = np.full((_WINDOW, 3 * count), np.nan)  # a ring of the last samples
        self._newest = 0
        self._interval = 0.0
        self._heard = 0.0  # s of listening, LISTENING at most
        self._root_noise = np.full(count, FIRST_NOISE**0.5)

    @property
    def noise(self) -> Array:
        """Standard deviation (T,) of each marker's noise per coordinate, metres."""
        squared: Array = self._root_noise**2
        return squared

    @property
    def velocity(self) -> Array:
        """The velocity (T, 3) of each marker at its last sighting, m/s.

        NaN before the first sighting; zero after a single one, as nothing is known of it yet.
        """
        # Slopes grow old from smoother to smoother as positions do: the line through the first
        # two, drawn on to no lag, is the least delayed.
        first, second, third, _ = self._stages
        slope: Array = (3.0 * (first - second) - 2.0 * (second - third)) / self._memory[:, None]
        return slope

    def update(self, xyz: npt.NDArray[np.floating], interval: float) -> Floats:
        """The next frame's markers (T, 3), metres, without their noise; NaN rows are missing.

        interval: seconds since the frame before, more than 0; where frames were lost, theirs too.
        """
        points = xyz.astype(float)
        present = np.isfinite(points @ _COORDINATES)
        whole = bool(present.all())
        if not whole:
            points[~present] = np.nan
        self._listen(points, interval)
        self._unseen += interval
        if whole:
            return self._follow(slice(None), points).astype(np.float32)
        points[present] = self._follow(present, points[present])
        return points.astype(np.float32)

    def _listen(self, points: Array, interval: float) -> None:
        """Measures the noise, by mean square roots: a knock or a stumble weighs little there."""
        # A difference needs even steps.
        if not 0.7 * self._interval < interval < 1.4 * self._interval:
            self._recent[:] = np.nan
        self._interval = interval
        self._newest = (self._newest + 1) % _WINDOW
        self._recent[self._newest] = points.ravel()
        left = np.abs(_DIFFERENCES[self._newest] @ self._recent).reshape(-1, 3)
        self._heard = min(self._heard + interval, max(LISTENING, interval))
        news = np.sqrt(left) @ _COORDINATES / (3.0 * _ROOT_MEAN) - self._root_noise
        news[np.isnan(news)] = 0.0
        self._root_noise += interval / self._heard * news

    def _follow(self, seen: slice | npt.NDArray[np.bool_], points: Array) -> Array:
        """Takes in the markers that are seen, and returns where they are; sets their memory."""
        stages, memory, elapsed = self._stages[:, seen], self._memory[seen], self._unseen[seen]
        afresh = elapsed > FORGET
        if afresh.any():
            stages = np.where(afresh[:, None], points, stages)
            memory = np.where(afresh, SHORTEST, memory)
            elapsed = np.where(afresh, 0.0, elapsed)
        share = (elapsed / (elapsed + memory))[:, None]
        ahead = points
        for stage in stages:
            stage += share * (ahead - stage)
            ahead = stage
        _, second, third, fourth = stages
        last = third - fourth
        bend = second - third - last
        position: Array = third + 3.0 * last

        noise = np.maximum(self._root_noise[seen] ** 4 - FLOOR**2, 0.0)
        explained = BEND**2 * _BEND_VARIANCE * noise * elapsed / memory
        actual = (bend * bend) @ _COORDINATES + 1e-20
        # The square of the bend grows with tau^4, that of its noise falls with tau.
        fitting = memory * (explained / actual) ** 0.2
        fitting = np.minimum(fitting, np.minimum(memory + GROWTH * elapsed, LONGEST))
        fitting = np.maximum(fitting, SHORTEST)
        # A change of memory changes the lags alone, not the line: position and velocity stay.
        stages += (1.0 - fitting / memory)[:, None] * (position - stages)
        self._stages[:, seen], self._memory[seen], self._unseen[seen] = stages, fitting, 0.0
        return position
