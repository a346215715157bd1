"""All tracked markers at all times: those that are missing where they are likely to be, and none
with a jump.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from bridge.body_frame import BodyFrame
from bridge.compiled import compiled
from bridge.regression import Regression, Sightings
from bridge.vectors import about_z, at, minus, plus, put, seen_in, turned
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.intp]

RETURN = 0.2  # s: a marker that is back is where it is measured after so long at most
SPEED = 1.0  # m/s: and sooner if this speed brings it there
NEAR = 0.001  # m: nearer than this to where it is measured, a marker is back
NEVER = 1e6  # s: the age of a sighting that there never was


class Imputer:
    """The tracked markers of one performer, T of them, from frame to frame.

    Of each missing marker the frame before it went is remembered, and the regression says where it
    is by that and by the markers that are there. Whenever others are there than before, what it
    says leaps; the leap is walked off, as is the way of a marker that came back from where it was
    taken to be.

    body: the performer's frame, which it places while markers are missing. usual: (T, 3) metres, in
    the body frame, where markers are that were never seen. away: (T,) metres, how far each is from
    where it is measured, or said to be. unseen: (T,), seconds since each was seen. whole: there is
    nothing to walk off, and all were seen in the frame before.
    """

    def __init__(self, regression: Regression, body: BodyFrame, usual: npt.ArrayLike) -> None:
        self._regression = regression
        self._body = body
        self._usual = np.array(usual, np.float32)
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        count = len(self._usual)
        self._shown: Floats | None = None  # what was given out in the frame before
        self._meant: Floats = self._usual  # where they were measured, or said to be, in it
        self._moving: Array = np.zeros((count, 3))  # and how it moved, m/s, world
        self._present: Mask = np.zeros(count, bool)  # and who was there
        # The last frame with each marker: all tracked markers in the body frame, where that was in
        # the world, and how they moved there.
        self._then: Floats = np.tile(self._usual, (count, 1, 1))
        self._place: Array = np.full((count, count, 3), np.nan)
        self._pace: Array = np.zeros_like(self._place)
        self.unseen = np.full(count, NEVER)
        self._rest: Array = np.zeros((count, 3))  # what is still to be walked off, world
        self._left = np.zeros(count)  # and the time for it, s
        self.away: Array = np.zeros(count)
        self.whole = False

    def complete(
        self, measured: Floats, present: Mask, velocity: Array, interval: float
    ) -> tuple[Floats, Floats]:
        """All tracked markers (T, 3) in the world, and the sigma (T,) of those that are missing;
        zero of others.

        measured: (T, 3) metres, world, NaN where missing; present: (T,), at least one; velocity:
        (T, 3) m/s, of each at its last sighting. interval: s since the frame before.
        """
        before, shown = self._present, self._shown
        moving = self._moving_on(velocity)
        self._remember(before & ~present, moving)
        self.unseen += interval
        self.unseen[present] = 0.0
        self._meant, sigma = self._found(measured, present)
        found = self._meant.copy()
        if shown is not None:
            _walk(
                *(shown, before, present, moving, interval),
                *(self._rest, self._left, self.away, self._moving, found),
            )
        self._shown, self._present = found, present
        self.whole = bool(present.all()) and not self.away.any()
        return found, sigma

    def pass_on(self, measured: Floats) -> Floats:
        """As `complete`, where `whole` is true and all markers are present again."""
        self._shown = self._meant = measured
        return measured

    def hold(self, held: Floats, velocity: Array, interval: float) -> None:
        """Nothing can be estimated from the markers: they are shown where the pose held has them,
        (T, 3) metres, world. velocity, interval: as for `complete`.
        """
        self._remember(self._present, self._moving_on(velocity))
        self.unseen += interval
        self._shown, self._present = held, np.zeros(len(held), bool)
        self._moving = np.zeros_like(self._moving)
        self.whole = False

    def _moving_on(self, velocity: Array) -> Array:
        """How the markers moved (T, 3) in the frame before, m/s."""
        moving: Array = np.where(self._present[:, None], velocity, self._moving)
        return moving

    def _remember(self, gone: Mask, moving: Array) -> None:
        """The markers went missing after the frame before. Where they were measured then counts,
        not how far on the way there they were shown.
        """
        if gone.any():
            self._body.place(self._meant)
            self._then[gone] = self._body.to_body(self._meant)
            self._place[gone], self._pace[gone] = self._meant, moving

    def _found(self, measured: Floats, present: Mask) -> tuple[Floats, Floats]:
        """The markers in the world as they are measured or said to be, and the sigma of these."""
        sigma: Floats = np.zeros(len(measured), np.float32)
        if present.all():
            return measured, sigma
        body, missing = self._body, np.flatnonzero(~present)
        body.place(measured)
        tracked = np.empty_like(measured)
        then: Floats = np.empty((len(missing), *measured.shape), np.float32)
        sightings = Sightings(then, np.empty_like(then), np.empty_like(then), self.unseen[missing])
        _tell(
            *(measured, body.placement, missing, self._then, self._place, self._pace),
            *(tracked, then, sightings.left, sightings.pace),
        )
        said, deviation = self._regression.recall(tracked, present, sightings, body.sigma)
        found = measured.copy()
        _take_over(said, deviation, body.placement, missing, found, sigma)
        return found, sigma


@compiled(
    "void(f4[:,::1], f8[::1], i8[::1], f4[:,:,::1], f8[:,:,::1], f8[:,:,::1],"
    " f4[:,::1], f4[:,:,::1], f4[:,:,::1], f4[:,:,::1])"
)
def _tell(
    measured: Floats,
    placement: Array,
    missing: Rows,
    thens: Floats,
    places: Array,
    paces: Array,
    tracked: Floats,
    then: Floats,
    left: Floats,
    pace: Floats,
) -> None:
    """The markers in the body frame, and the last sightings of those that are missing."""
    body, origin = about_z(placement[3]), (placement[0], placement[1], placement[2])
    for row in range(len(measured)):
        put(tracked, row, seen_in(body, minus(at(measured, row), origin)))
    for one in range(len(missing)):
        marker = missing[one]
        then[one] = thens[marker]
        for row in range(len(measured)):
            if math.isnan(places[marker, row, 0]):  # never seen anywhere
                left[one, row] = then[one, row]
            else:
                put(left[one], row, seen_in(body, minus(at(places[marker], row), origin)))
            put(pace[one], row, seen_in(body, at(paces[marker], row)))


@compiled("void(f4[:,:,:], f4[:,:], f8[::1], i8[::1], f4[:,::1], f4[::1])")
def _take_over(
    said: Floats, deviation: Floats, placement: Array, missing: Rows, found: Floats, sigma: Floats
) -> None:
    """Puts each missing marker where it is said to be, in the world, by its own last sighting."""
    body, origin = about_z(placement[3]), (placement[0], placement[1], placement[2])
    for one in range(len(missing)):
        marker = missing[one]
        put(found, marker, plus(turned(body, at(said[one], marker)), origin))
        sigma[marker] = deviation[one, marker]


@compiled(
    "void(f4[:,::1], b1[::1], b1[::1], f8[:,::1], f8,"
    " f8[:,::1], f8[::1], f8[::1], f8[:,::1], f4[:,::1])"
)
def _walk(
    shown: Floats,
    before: Mask,
    present: Mask,
    moving: Array,
    interval: float,
    rest: Array,
    left: Array,
    away: Array,
    paces: Array,
    found: Floats,
) -> None:
    """Lets the markers found (T, 3) go evenly from where they were shown before to where they are
    said to be, wherever others are there than before; and says how they move, `paces`.
    """
    others = False
    for row in range(len(found)):
        others |= before[row] != present[row]
    for row in range(len(found)):
        if others and not (present[row] and before[row]):
            square = 0.0
            for axis in range(3):
                leap = shown[row, axis] + moving[row, axis] * interval - found[row, axis]
                rest[row, axis] = leap
                square += leap * leap
            left[row] = min(math.sqrt(square) / SPEED, RETURN)
        # What is to be walked off gets less, evenly.
        ahead = max(left[row] - interval, 0.0)
        kept = ahead / left[row] if left[row] > 0.0 else 0.0
        left[row] = ahead
        square = 0.0
        for axis in range(3):
            rest[row, axis] *= kept
            square += rest[row, axis] ** 2
            found[row, axis] += rest[row, axis]
            paces[row, axis] = (float(found[row, axis]) - float(shown[row, axis])) / interval
        away[row] = math.sqrt(square)
