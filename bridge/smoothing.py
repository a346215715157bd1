"""Noise of the tracked markers, taken out as they come: no look-ahead, no more than is needed.

Each marker runs through four exponential smoothers in a row, all of one memory tau. Behind a
marker in even motion each of them lags another tau, so the line through the last two, drawn on to
a lag of none, is where the marker is. That is Brown's double exponential smoothing (1959) behind
two smoothers more: noise shows most in the third difference of the estimated body, and each
smoother takes that down once more.

The memory is each marker's own, the longest that its motion allows. The bend of the line at the
last three smoothers tells how far the marker is from even motion, and so how far off the line is.
While the noise alone may have made the bend, the memory grows; where it cannot have, the memory
shrinks at once. How much noise there is the sixth differences of the stream tell, in which next to
nothing of a body's motion is left.
"""

from __future__ import annotations

import math
from math import comb

import numpy as np
import numpy.typing as npt

from bridge.compiled import compiled
from drivers.frame import Floats

Array = npt.NDArray[np.float64]

FLOOR = 0.0002  # m: noise that good captures have themselves; it is left to them
FIRST_NOISE = 0.0005  # m: taken for the noise until samples tell it
LISTENING = 0.5  # s: time constant with which the noise is measured
BEND = 4.0  # standard deviations of its noise up to which a bend is laid to it
GROWTH = 0.2  # s per s: the memory grows no faster
LONGEST = 0.05  # s: the memory is no longer
SHORTEST = 0.0001  # s: nor shorter; beside a frame's interval this is none
FORGET = 0.1  # s: a marker that was away for longer starts afresh

_STAGES = 4
_ORDER = 6
_WINDOW = _ORDER + 1  # samples that a difference takes
# The difference of white noise has the variance of the noise. From the oldest sample to the newest.
_DIFFERENCE = np.array([(-1.0) ** k * comb(_ORDER, k) for k in range(_WINDOW)])
_DIFFERENCE /= comb(2 * _ORDER, _ORDER) ** 0.5
_ROOT_MEAN = 0.8222  # mean of the square root of |n|, n standard normal: 2^(1/4) G(3/4) / sqrt(pi)
# Variance of the bend over its three coordinates: this x variance of the noise x interval / tau
# (the integral of w^4 / (1 + w^2)^4 over all w is pi / 16).
_BEND_VARIANCE = 3.0 / 32.0


class NoiseFilter:
    """Takes the noise out of markers that are followed from frame to frame.

    A clean stream goes through all but unchanged. A missing marker stays missing; the longer it
    was away, the less of what was before counts when it is back, and after `FORGET` nothing does.
    Markers do not influence each other.

    markers: how many, T. seen: how many of them were there in the last frame.
    """

    def __init__(self, markers: int) -> None:
        self._points = np.empty((markers, 3))
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        count = len(self._points)
        self._stages = np.full((count, _STAGES, 3), np.nan)
        self._memory = np.full(count, SHORTEST)  # s, tau
        self._unseen = np.full(count, np.inf)  # s since the last sighting
        self._recent = np.full((_WINDOW, count, 3), np.nan)  # a ring of the last samples
        self._newest = 0
        self._interval = 0.0
        self._heard = 0.0  # s of listening, LISTENING at most
        self.seen = 0
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
        slope = np.empty_like(self._points)
        _slopes(self._stages, self._memory, slope)
        return slope

    def update(self, xyz: npt.NDArray[np.floating], interval: float) -> Floats:
        """The next frame's markers (T, 3), metres, without their noise; NaN rows are missing.

        interval: seconds since the frame before, more than 0; where frames were lost, theirs too.
        """
        # A difference needs even steps.
        if not 0.7 * self._interval < interval < 1.4 * self._interval:
            self._recent[:] = np.nan
        self._interval = interval
        self._newest = (self._newest + 1) % _WINDOW
        self._heard = min(self._heard + interval, max(LISTENING, interval))
        self._points[:] = xyz
        found: Floats = np.empty(self._points.shape, np.float32)
        share = interval / self._heard
        _listen(self._points, self._recent, self._newest, share, self._root_noise)
        noise = self._root_noise
        self.seen = _follow(
            self._points, interval, noise, self._stages, self._memory, self._unseen, found
        )
        return found


@compiled("void(f8[:,::1], f8[:,:,::1], i8, f8, f8[::1])")
def _listen(points: Array, recent: Array, newest: int, share: float, root_noise: Array) -> None:
    """Measures the noise, by mean square roots: a knock or a stumble weighs little there."""
    for marker in range(len(points)):
        total = 0.0
        for axis in range(3):
            recent[newest, marker, axis] = points[marker, axis]
            difference = 0.0
            for age in range(_WINDOW):
                sample = recent[(newest + 1 + age) % _WINDOW, marker, axis]
                difference += _DIFFERENCE[age] * sample
            total += math.sqrt(abs(difference))
        if math.isfinite(total):
            news = total / (3.0 * _ROOT_MEAN)
            root_noise[marker] += share * (news - root_noise[marker])


@compiled("i8(f8[:,::1], f8, f8[::1], f8[:,:,::1], f8[::1], f8[::1], f4[:,::1])")
def _follow(
    points: Array,
    interval: float,
    root_noise: Array,
    stages: Array,
    memory: Array,
    unseen: Array,
    found: Floats,
) -> int:
    """Takes in the markers that are seen, and says where they are; sets their memory. Returns how
    many there are.
    """
    seen = 0
    for marker in range(len(points)):
        unseen[marker] += interval
        point, smoothers = points[marker], stages[marker]
        if not math.isfinite(point[0] + point[1] + point[2]):
            found[marker] = np.nan
            continue
        seen += 1
        elapsed, tau = unseen[marker], memory[marker]
        unseen[marker] = 0.0
        if elapsed > FORGET:
            smoothers[:] = point
            elapsed, tau = 0.0, SHORTEST
        share = elapsed / (elapsed + tau)
        actual = 1e-20
        for axis in range(3):
            ahead = point[axis]
            for stage in range(_STAGES):
                smoothers[stage, axis] += share * (ahead - smoothers[stage, axis])
                ahead = smoothers[stage, axis]
            bend = smoothers[1, axis] - 2.0 * smoothers[2, axis] + smoothers[3, axis]
            actual += bend * bend
        noise = max(root_noise[marker] ** 4 - FLOOR**2, 0.0)
        explained = BEND**2 * _BEND_VARIANCE * noise * elapsed / tau
        # The square of the bend grows with tau^4, that of its noise falls with tau.
        fitting = tau * (explained / actual) ** 0.2
        fitting = max(min(fitting, tau + GROWTH * elapsed, LONGEST), SHORTEST)
        memory[marker] = fitting
        # A change of memory changes the lags alone, not the line: position and velocity stay.
        change = 1.0 - fitting / tau
        for axis in range(3):
            position = 4.0 * smoothers[2, axis] - 3.0 * smoothers[3, axis]
            found[marker, axis] = position
            for stage in range(_STAGES):
                smoothers[stage, axis] += change * (position - smoothers[stage, axis])
    return seen


@compiled("void(f8[:,:,::1], f8[::1], f8[:,::1])")
def _slopes(stages: Array, memory: Array, slope: Array) -> None:
    """Slopes grow old from smoother to smoother as positions do: the line through the first two,
    drawn on to no lag, is the least delayed.
    """
    for marker in range(len(slope)):
        for axis in range(3):
            first, second, third = stages[marker, :3, axis]
            late = 3.0 * (first - second) - 2.0 * (second - third)
            slope[marker, axis] = late / memory[marker]
