"""Which moment is shown: what comes now, or a recording, played, paused, stepped through."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from typing import NamedTuple, Protocol

from bridge.pose import Pose
from drivers.frame import Floats

SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)
KEPT = 1200  # moments of what comes now that can be gone back through: 10 s at 120 Hz
TRAIL = 3.0  # s
TRAIL_STEP = 0.04  # s, about
TRAIL_POINTS = 115  # at most: rounded to whole moments the step is two thirds of that, or more
_OVER = 60  # moments over which the time between two is measured


class Moment(NamedTuple):
    """A pose, and the true one (M, 3) where it is known."""

    pose: Pose
    truth: Floats | None


class Moments(Protocol):
    """In order of time."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Moment: ...


class Player:
    """Plays moments in order of time from the first to the last, and stops there.

    playing: whether time passes. speed: how fast. index: of the moment shown.
    """

    def __init__(self, moments: Moments) -> None:
        self.moments = moments
        self.playing = True
        self.speed = 1.0
        self.index = 0
        self._time = self._start

    @property
    def moment(self) -> Moment | None:
        """What is shown now; None while there is nothing."""
        return self.moments[self.index] if len(self.moments) else None

    @property
    def seconds(self) -> float:
        """Where it is, from the beginning."""
        return min(self._time, self._end) - self._start

    @property
    def length(self) -> float:
        """From the first moment to the last, in seconds."""
        return self._end - self._start

    @property
    def ended(self) -> bool:
        """Whether there is nothing after what is shown."""
        return self.index >= len(self.moments) - 1

    def advance(self, seconds: float) -> None:
        """Lets so much time of the viewer's pass."""
        if self.playing:
            self.seek(self.seconds + seconds * self.speed)
            self.playing = self._time < self._end

    def toggle(self) -> None:
        """Pauses or goes on; from the end, anew."""
        self.playing = not self.playing
        if self.playing and self.ended:
            self.seek(0.0)

    def step(self, count: int) -> None:
        """Pauses, so many moments on or back."""
        if not len(self.moments):
            return
        self.playing = False
        self.index = max(0, min(self.index + count, len(self.moments) - 1))
        self._time = self.moments[self.index].pose.t

    def jump(self, seconds: float) -> None:
        """So far on or back."""
        self.seek(self.seconds + seconds)

    def seek(self, seconds: float) -> None:
        """To so far from the beginning."""
        self._time = min(max(self._start + seconds, self._start), self._end)
        after = bisect_right(self.moments, self._time, key=lambda moment: moment.pose.t)
        self.index = max(0, after - 1)

    def faster(self, steps: int) -> None:
        """One or more speeds up, or down."""
        at = SPEEDS.index(self.speed) + steps
        self.speed = SPEEDS[max(0, min(at, len(SPEEDS) - 1))]

    def trail(self) -> list[Moment]:
        """What was shown in the last seconds, the newest first, at times that stay the same."""
        before = min(self.index, _OVER)
        if not before:
            return []
        now = self.moments[self.index]
        each = (now.pose.t - self.moments[self.index - before].pose.t) / before
        stride = max(1, round(TRAIL_STEP / max(each, 1e-6)))
        newest = self.index - self._number(self.index) % stride
        found = [now]
        for index in range(newest, -1, -stride):
            moment = self.moments[index]
            if now.pose.t - moment.pose.t > TRAIL or len(found) == TRAIL_POINTS:
                break
            found.append(moment)
        return found

    def _number(self, index: int) -> int:
        """Of a moment, the same however many have gone."""
        return index

    @property
    def _start(self) -> float:
        return self.moments[0].pose.t if len(self.moments) else 0.0

    @property
    def _end(self) -> float:
        return self.moments[-1].pose.t if len(self.moments) else 0.0


class LivePlayer(Player):
    """What comes now: the newest is shown at once. Paused, it can be gone through from 10 s before
    to 10 s after; then it goes on with what is the newest.
    """

    def __init__(self) -> None:
        self._kept: deque[Moment] = deque()
        self._gone = 0
        super().__init__(self._kept)

    def add(self, moment: Moment) -> None:
        if self.playing:
            while len(self._kept) >= KEPT:
                self._kept.popleft()
                self._gone += 1
            self._kept.append(moment)
            self.index = len(self._kept) - 1
        elif len(self._kept) < self.index + KEPT:
            self._kept.append(moment)

    @property
    def ended(self) -> bool:
        """Never: more may come."""
        return False

    def advance(self, seconds: float) -> None:
        """Nothing: it goes as it comes."""

    def toggle(self) -> None:
        self.playing = not self.playing
        if self.playing:
            self.index = max(0, len(self._kept) - 1)

    def _number(self, index: int) -> int:
        return index + self._gone
