"""Faults of the device's clock."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Literal

from pydantic import PrivateAttr

from simulators.faults.fault import Fault, Stream


class StampFault(Fault):
    """A fault that sets the device's clock wrong, from then on."""

    _gained: float = PrivateAttr(0.0)
    _last: float = PrivateAttr(0.0)

    def start(self, stream: Stream) -> None:
        super().start(stream)
        self._gained = self._last = 0.0

    def gained(self, t: float) -> float:
        """Seconds that the clock is ahead at `t`, seconds of the stream."""
        if self.acts(t):
            self._gained += self._gain(t - self._last)
            self.count()
        self._last = t
        return self._gained

    @abstractmethod
    def _gain(self, passed: float) -> float:
        """Seconds won since the frame before, `passed` seconds ago."""


class Drift(StampFault):
    """The clock runs too fast, by parts per million; below 0 too slow. Counts frames."""

    kind: Literal["drift"]
    ppm: float

    def _gain(self, passed: float) -> float:
        return self.ppm * 1e-6 * passed


class ClockJump(StampFault):
    """The clock is set, `seconds` ahead or back. Counts jumps."""

    needs: ClassVar = ("when",)
    kind: Literal["clock_jump"]
    seconds: float

    def acts(self, t: float) -> bool:
        return self.begins(t)

    def _gain(self, passed: float) -> float:
        return self.seconds
