"""All tracked markers at all times: those that are missing where they are likely to be, and none
with a jump.

A marker that goes missing goes on as it went for a moment, and then comes to where the model
expects it from the others; one that is back comes to where it is measured.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bridge.body_frame import BodyFrame
from bridge.regression import Regression
from drivers.frame import Floats

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MOMENT = 0.05  # s: a marker missing for less is taken to go on as it went
FADE = 0.5  # s: time constant with which the last sighting is forgotten (docs/decisions/0005)
COAST = 0.1  # s: time constant with which a marker that went missing loses its speed
RETURN = 0.2  # s: a marker that is back is where it is measured after so long at most
SPEED = 1.0  # m/s: and sooner if this speed brings it there
NEAR = 0.001  # m: nearer than this to where it is measured, a marker is back


class Imputer:
    """The tracked markers of one performer, T of them, from frame to frame.

    body: the performer's frame, which it places while markers are missing. memory: (T,), how much
    of the last sighting is in each marker, from 1 to 0. away: (T,) metres, how far a marker that
    came back still is from where it is measured. unseen: (T,), seconds since each was seen. whole:
    there is nothing to blend, and all were seen in the frame before.
    """

    def __init__(self, regression: Regression, body: BodyFrame, markers: int) -> None:
        self._regression = regression
        self._body = body
        # Offsets from where each frame by itself has the markers, in the body's axes, m: what is
        # remembered of the last sighting, with its speed in m/s, and what is left of a return,
        # with the time until it is gone, s.
        self._remembered = np.zeros((markers, 3))
        self._speed = np.zeros((markers, 3))
        self._rest = np.zeros((markers, 3))
        self._left = np.zeros(markers)
        self.memory = np.zeros(markers)
        self.reset()

    def reset(self) -> None:
        """Forgets all: a new performer or sequence."""
        self.forget()
        self._before: Floats | None = None  # what was measured in the frame before
        self._shown: Floats | None = None  # and what was given out

    def forget(self) -> None:
        """There is nothing to blend with any more."""
        for state in (self._remembered, self._speed, self._rest, self._left, self.memory):
            state[:] = 0.0
        self._last: Floats = np.full(self._rest.shape, np.nan, np.float32)
        self.unseen = np.full(len(self._rest), np.inf)
        self._quiet = True
        self.whole = False

    @property
    def away(self) -> Array:
        distance: Array = np.sqrt((self._rest**2).sum(axis=1))
        return distance

    def complete(
        self, measured: Floats, present: Mask, velocity: Array, interval: float
    ) -> tuple[Floats, Floats | None]:
        """All tracked markers (T, 3) in the world, and, where some are missing, the sigma (M,) of a
        pose of which only the others are known.

        measured: (T, 3) metres, world, NaN where missing; present: (T,), at least one; velocity:
        (T, 3) m/s, of each at its last sighting. interval: s since the frame before.
        """
        # The frame before's, of all tracked markers: it does not leap as markers come and go.
        rotation = self._body.rotation
        before = None if self._before is None else ~np.isnan(self._before[:, 0])
        if not self._quiet:
            self._advance(interval)
        measured, present = self._going_on(measured, present, velocity, interval, rotation)
        sigma = None
        if present.all() and (before is None or before.all()):
            found = measured
        else:
            found, sigma = self._guess(measured, present)
            if before is not None and (before != present).any():
                self._change(measured, before, present, found, velocity, interval, rotation)
        self._before = measured
        if not self._quiet:
            moved = found + (self._remembered + self._rest) @ rotation.T
            found = moved.astype(np.float32)
        self._shown = found
        self.whole = self._quiet and not self.unseen.any()
        return found, sigma

    def pass_on(self, measured: Floats) -> Floats:
        """As `complete`, where `whole` is true and all markers are present again."""
        self._last = self._before = self._shown = measured
        return measured

    def hold(self, shown: Floats) -> None:
        """The markers were shown (T, 3) where nothing could be estimated from them."""
        self.forget()
        self._before, self._shown = np.full_like(shown, np.nan), shown

    def _going_on(
        self, measured: Floats, present: Mask, velocity: Array, interval: float, rotation: Array
    ) -> tuple[Floats, Mask]:
        """The markers with those that have just gone missing as if there: a dropped sample or two
        are not worth a change.
        """
        gone_on = self._last + (velocity * interval).astype(np.float32)
        back = present & (self.unseen > 0.0) & (self.unseen + interval < MOMENT)
        if back.any():
            self._rest[back] += (gone_on - measured)[back] @ rotation
            self._return(back, interval)
        self.unseen = np.where(present, 0.0, self.unseen + interval)
        self._last = np.where(present[:, None], measured, gone_on)
        there = self.unseen < MOMENT
        return np.where(there[:, None], self._last, np.float32(np.nan)), there

    def _advance(self, interval: float) -> None:
        slows = float(np.exp(-interval / COAST))
        keeps = float(np.exp(-interval / FADE))
        self._remembered += self._speed * (COAST * (1.0 - slows))
        self._remembered *= keeps
        self._speed *= slows
        self.memory *= keeps
        self._approach(interval)
        still = np.abs(self._remembered).max() < 1e-6 and not self._rest.any()
        self._quiet = bool(still and not self._speed.any())

    def _guess(self, measured: Floats, present: Mask) -> tuple[Floats, Floats | None]:
        """The markers (T, 3) in the world as one frame by itself has them, and the pose's sigma."""
        if present.all():
            self._body.place(measured)
            return measured, None
        seen = np.where(present[:, None], measured, np.float32(np.nan))
        self._body.place(seen)
        guess, sigma = self._regression.guess(self._body.to_body(seen), present, self._body.sigma)
        return np.where(present[:, None], measured, self._body.to_world(guess)), sigma

    def _change(
        self,
        measured: Floats,
        before: Mask,
        present: Mask,
        found: Floats,
        velocity: Array,
        interval: float,
        rotation: Array,
    ) -> None:
        """Others are present than before: the offsets take the leap of `found`.

        Of markers that went: what the frame before has with them, less what it has without. Of
        markers that came: what this frame has without them, less what it has with them; those that
        are still missing give back what they took when the others went, or leaps would sum up.
        """
        kept, gone, come = before & present, before & ~present, present & ~before
        if self._shown is not None and not kept.any():
            self._rest[:] = (self._shown - found) @ rotation
            self._remembered[:] = self._speed[:] = 0.0
            self.memory[:] = 0.0
            self._return(np.ones_like(present), interval)
            return
        now = found if not come.any() else self._guess(measured, kept)[0]
        if gone.any() and self._before is not None:
            earlier, _ = self._guess(self._before, before)
            without, _ = self._guess(self._before, kept)
            self._remembered += (earlier - without) @ rotation
            speed = (velocity[gone] - (now - without)[gone] / interval) @ rotation
            self._speed[gone] = speed
            self.memory[gone] = 1.0
        if come.any():
            self._remembered += (now - found) @ rotation
            self._rest[come] += self._remembered[come]
            self._remembered[come] = self._speed[come] = 0.0
            self.memory[come] = 0.0
            self._return(come, interval)
        self._quiet = False
        # Back from what might have been seen.
        self._body.place(np.where(present[:, None], measured, np.float32(np.nan)))

    def _return(self, moved: Mask, interval: float) -> None:
        """Gives the markers moved the time that they need, and takes the first step."""
        needed = np.clip(self.away / SPEED, 0.0, RETURN)
        self._left = np.where(moved, np.maximum(self._left, needed), self._left)
        self._approach(interval)
        self._quiet = False

    def _approach(self, interval: float) -> None:
        """The markers that are back come nearer to where they are measured."""
        ahead = np.maximum(self._left - interval, 0.0)
        share = np.divide(ahead, self._left, out=np.zeros_like(ahead), where=self._left > 0.0)
        self._rest *= share[:, None]
        self._left = ahead
