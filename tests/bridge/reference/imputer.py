"""`bridge.imputer` in numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bridge.imputer import NEVER, RETURN, SPEED
from bridge.regression import Regression, Sightings
from drivers.frame import Floats
from tests.bridge.reference.body_frame import BodyFrame

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Imputer:
    """See `bridge.imputer.Imputer`."""

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
        self.unseen = np.where(present, 0.0, self.unseen + interval)
        found, sigma = self._found(measured, present)
        changed = ~present | ~before
        if shown is not None and (before != present).any():
            leap: Array = shown + moving * interval - found.astype(float)
            self._rest = np.where(changed[:, None], leap, self._rest)
            needed = np.clip(_lengths(leap) / SPEED, 0.0, RETURN)
            self._left = np.where(changed, needed, self._left)
        self._approach(interval)
        self._meant = found
        if self.away.any():
            found = (found + self._rest).astype(np.float32)
        if shown is not None:
            self._moving = (found - shown).astype(float) / interval
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
        sigma = np.zeros(len(measured), np.float32)
        if present.all():
            return measured, sigma
        body, missing = self._body, np.flatnonzero(~present)
        body.place(measured)
        then = self._then[missing]
        left = body.to_body(self._place[missing])
        sightings = Sightings(
            then,
            np.where(np.isnan(left), then, left),  # never seen anywhere
            (self._pace[missing] @ body.rotation).astype(np.float32),
            self.unseen[missing],
        )
        tracked = body.to_body(measured)
        said, deviation = self._regression.recall(tracked, present, sightings, body.sigma)
        found = measured.copy()
        own = np.arange(len(missing))
        found[missing] = body.to_world(said[own, missing])
        sigma[missing] = deviation[own, missing]
        return found, sigma

    def _approach(self, interval: float) -> None:
        """What is to be walked off gets less, evenly."""
        ahead = np.maximum(self._left - interval, 0.0)
        kept = np.divide(ahead, self._left, out=np.zeros_like(ahead), where=self._left > 0.0)
        self._rest = self._rest * kept[:, None]
        self._left = ahead
        self.away = _lengths(self._rest)


def _lengths(vectors: Array) -> Array:
    found: Array = np.sqrt((vectors**2).sum(axis=1))
    return found
