"""What all faults share: when they act, their random numbers, and what they did."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from drivers.frame import Layout
from simulators.corruption import parse_share

Seconds = Annotated[float, Field(ge=0)]


def _share(value: object) -> object:
    return parse_share(value) if isinstance(value, str) else value


Share = Annotated[float, BeforeValidator(_share), Field(gt=0, le=1)]  # 0.05, or "5%"


@dataclass(frozen=True, slots=True)
class Stream:
    """What a fault acts on: the markers that are sent, random numbers of its own, and where to
    count."""

    layout: Layout
    random: np.random.Generator
    counters: Counter[str]


class Fault(BaseModel):
    """One fault. It acts throughout, or in episodes: at a moment, again and again, or by chance.

    at: seconds of the stream. for: how long an episode lasts, seconds; without it, one frame or
    packet. every: seconds from one beginning to the next. chance: that an episode begins with a
    frame or packet. Counts under its kind what it did.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    needs: ClassVar[tuple[str, ...]] = ()  # "when" and "for", where it can do nothing without

    kind: str
    at: Seconds | None = None
    for_: Seconds = Field(0.0, alias="for")
    every: Annotated[float, Field(gt=0)] | None = None
    chance: Share | None = None

    _stream: Stream = PrivateAttr()
    _next: float = PrivateAttr(0.0)  # when the next episode begins
    _until: float = PrivateAttr(-math.inf)  # when this one ends

    @model_validator(mode="after")
    def _check_when(self) -> Self:
        if self.at is not None and self.chance is not None:
            raise ValueError("it has either a moment (at) or a chance, not both")
        if self.every is not None and (self.at is None or self.every <= self.for_):
            raise ValueError("every goes with at, and is longer than for")
        if self.for_ and self.at is None and self.chance is None:
            raise ValueError("for goes with at or chance")
        if "when" in self.needs and self.at is None and self.chance is None:
            raise ValueError("it needs at or chance")
        if "for" in self.needs and not self.for_:
            raise ValueError("it needs for, in seconds")
        return self

    def start(self, stream: Stream) -> None:
        """Begins anew on a stream."""
        self._stream = stream
        self._next = self.at or 0.0
        self._until = -math.inf

    def acts(self, t: float) -> bool:
        """Whether it acts on the frame or packet of `t`, seconds of the stream."""
        if self.at is None and self.chance is None:
            return True
        return t < self._until or self.begins(t)

    def begins(self, t: float) -> bool:
        """Whether an episode begins with the frame or packet of `t`."""
        if self.chance is not None:
            if not self._stream.random.random() < self.chance:
                return False
            self._until = t + self.for_
            return True
        if t < self._next:
            return False
        self._until = self._next + self.for_
        while self._next <= t:
            self._next += self.every or math.inf
        return True

    def count(self, number: int = 1) -> None:
        """Counts what was done."""
        self._stream.counters[self.kind] += number
