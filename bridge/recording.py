"""What was recorded, on one time axis: the poses or frames of a log, or a capture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bridge.pose import Provenance
from bridge.sinks.c3d import lost_between
from drivers.c3d_file import Clip
from drivers.frame import Floats, Layout
from drivers.session_log import SessionLog


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Markers at a frame index: (M, 3) metres, NaN where missing; of a pose also the provenance
    (M,) and sigma (M,) in metres.
    """

    index: int
    layout: Layout
    xyz: Floats
    provenance: npt.NDArray[np.uint8] | None = None
    sigma: Floats | None = None


class Recording:
    """Samples in order, a row for each index: those that never came are missing throughout.

    A step of the index over 1,200, or back, is another take: it follows at once. layout: all
    labels that occur, in the order they do, at the rate that most samples have. rows: how many.
    `read` begins anew at each call, so that a recording of any length takes no memory.
    """

    def __init__(self, read: Callable[[], Iterator[Sample]]) -> None:
        """Raises ValueError where there is no sample."""
        self._read = read
        seen: Counter[Layout] = Counter()
        self.rows = 0
        last = None
        for sample in read():
            seen[sample.layout] += 1
            self.rows += 1 if last is None else 1 + lost_between(last, sample.index)
            last = sample.index
        if not seen:
            raise ValueError("nothing in it can be read")
        labels = tuple(dict.fromkeys(label for layout in seen for label in layout.labels))
        self.layout = Layout(labels, seen.most_common(1)[0][0].rate)

    def __iter__(self) -> Iterator[Sample]:
        """`rows` samples, all of `layout`."""
        places: dict[Layout, npt.NDArray[np.intp]] = {}
        nowhere: Floats = np.full((len(self.layout.labels), 3), np.nan, np.float32)
        last = None
        for sample in self._read():
            if last is not None:
                for index in range(last + 1, last + 1 + lost_between(last, sample.index)):
                    yield Sample(index, self.layout, nowhere)
            last = sample.index
            if sample.layout.labels == self.layout.labels:
                yield sample
                continue
            if sample.layout not in places:
                rows = [self.layout.labels.index(label) for label in sample.layout.labels]
                places[sample.layout] = np.array(rows)
            xyz = nowhere.copy()
            xyz[places[sample.layout]] = sample.xyz
            yield Sample(sample.index, self.layout, xyz)


def poses_of(log: SessionLog) -> Iterator[Sample]:
    """The poses of a log; what is lost is missing."""
    for pose in log.poses():
        lost = pose.provenance[:, None] == Provenance.LOST
        xyz = np.where(lost, np.float32(np.nan), pose.xyz)
        yield Sample(pose.index, pose.layout, xyz, pose.provenance, pose.sigma)


def frames_of(log: SessionLog) -> Iterator[Sample]:
    """The frames of a log."""
    for frame in log.frames():
        yield Sample(frame.index, frame.layout, frame.xyz)


def samples_of(clip: Clip) -> Iterator[Sample]:
    """The frames of a capture."""
    for index, xyz in enumerate(clip.xyz):
        yield Sample(index, clip.layout, xyz)
