"""Faults of what the device sees: markers hidden, in the wrong place, under the wrong name."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    model_validator,
)

from drivers.frame import Floats
from simulators.body_parts import BODY_PARTS
from simulators.corruption import Corruption, Faults, Gaps, parse_noise
from simulators.faults.fault import Fault, Share, Stream


def _sent(label: str, info: ValidationInfo) -> str:
    labels = (info.context or {}).get("labels")
    if labels is not None and label not in labels:
        raise ValueError(f"the device sends no marker {label} (it sends {', '.join(labels)})")
    return label


Label = Annotated[str, AfterValidator(_sent)]
Length = Annotated[float, BeforeValidator(lambda value: parse_noise(str(value)))]  # "1mm"


class MarkerFault(Fault):
    """A fault of (M, 3) positions in metres, before they are encoded."""

    def apply(self, t: float, xyz: Floats) -> None:
        """Changes the frame of `t` in place, if it is its turn; counts the markers it changed."""
        if self.acts(t):
            before = xyz.copy()
            self._change(xyz)
            changed = (xyz != before) & ~(np.isnan(xyz) & np.isnan(before))
            self.count(int(changed.any(axis=1).sum()))

    @abstractmethod
    def _change(self, xyz: Floats) -> None: ...

    def _rows(self, labels: list[str] | None) -> list[int]:
        known = self._stream.layout.labels
        return list(range(len(known))) if labels is None else [known.index(one) for one in labels]


class Swap(MarkerFault):
    """Two labels exchange their markers."""

    kind: Literal["swap"]
    markers: Annotated[list[Label], Field(min_length=2, max_length=2)]

    def _change(self, xyz: Floats) -> None:
        rows = self._rows(self.markers)
        xyz[rows] = xyz[rows[::-1]]


class Ghost(MarkerFault):
    """A reflection is taken for the marker, or comes as well, under a label that nobody knows.

    mirror: one coordinate of the reflecting plane, metres, Z up; the floor unless it is named.
    label: of the reflection where the marker stays.
    """

    kind: Literal["ghost"]
    marker: Label
    mirror: Annotated[
        dict[Literal["x", "y", "z"], float],
        Field(default_factory=lambda: {"z": 0.0}, min_length=1, max_length=1),
    ]
    label: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check_label(self, info: ValidationInfo) -> Self:
        if self.label is not None and self.label in (info.context or {}).get("labels", ()):
            raise ValueError(f"label {self.label} is that of a marker that is sent")
        return self

    def _change(self, xyz: Floats) -> None:
        ((axis, at),) = self.mirror.items()
        (row,) = self._rows([self.marker])
        reflection = xyz[row].copy()
        reflection["xyz".index(axis)] = 2 * at - reflection["xyz".index(axis)]
        (there,) = self._rows([self.label or self.marker])
        xyz[there] = reflection


class Noise(MarkerFault):
    """Gaussian noise. size: standard deviation per coordinate. markers: all unless named."""

    kind: Literal["noise"]
    size: Length
    markers: list[Label] | None = None

    def _change(self, xyz: Floats) -> None:
        rows = self._rows(self.markers)
        noise = self._stream.random.normal(0.0, self.size, (len(rows), 3))
        xyz[rows] += noise.astype(np.float32)


class Dropout(MarkerFault):
    """Markers are missing: all at once, or each for itself in bursts.

    markers: all unless named. share: of each marker's samples, in bursts of `frames`, shortest and
    longest.
    """

    kind: Literal["dropout"]
    markers: list[Label] | None = None
    share: Share | None = None
    frames: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None

    _gaps: Corruption = PrivateAttr()

    @model_validator(mode="after")
    def _check_bursts(self) -> Self:
        if (self.share is None) != (self.frames is None):
            raise ValueError("share and frames go together: share = 0.2, frames = [10, 100]")
        if self.share is not None and self.frames is not None:
            if not 1 <= self.frames[0] <= self.frames[1]:
                raise ValueError("frames are the shortest and the longest burst, from 1")
            if self.share == 1 or Gaps(self.share, *self.frames).mean_seen < 1:
                raise ValueError("less than a frame is left between two bursts: make them longer")
        return self

    def start(self, stream: Stream) -> None:
        super().start(stream)
        if self.share is not None and self.frames is not None:
            gaps = Gaps(self.share, *self.frames)
            seed = int(stream.random.integers(2**32))
            self._gaps = Corruption(Faults(gaps=gaps), len(self._rows(self.markers)), seed)

    def _change(self, xyz: Floats) -> None:
        rows = self._rows(self.markers)
        xyz[rows] = np.nan if self.share is None else self._gaps.apply(xyz[rows])


class Occlusion(MarkerFault):
    """All markers of a part of the body are missing."""

    kind: Literal["occlusion"]
    part: str

    @model_validator(mode="after")
    def _check_part(self, info: ValidationInfo) -> Self:
        if self.part not in BODY_PARTS:
            raise ValueError(f"part '{self.part}' is unknown (known: {', '.join(BODY_PARTS)})")
        labels = (info.context or {}).get("labels", BODY_PARTS[self.part])
        if not set(BODY_PARTS[self.part]) & set(labels):
            raise ValueError(
                f"the device sends no marker of the {self.part} (it sends {', '.join(labels)})"
            )
        return self

    def _change(self, xyz: Floats) -> None:
        there = [label for label in BODY_PARTS[self.part] if label in self._stream.layout.labels]
        xyz[self._rows(there)] = np.nan
