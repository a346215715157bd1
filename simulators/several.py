"""Several performers in one stream: `ann:LFHD` is ann's LFHD."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.frame import Floats, Layout
from drivers.performers import labels_of

APART = 1.5  # m, to the side, from one to the next


def side_by_side(
    layout: Layout, poses: Iterator[Floats], names: Sequence[str]
) -> tuple[Layout, Iterator[Floats]]:
    """All of them do the same beside each other: (n M, 3) metres for each pose (M, 3)."""
    shifts = np.zeros((len(names), 1, 3), np.float32)
    shifts[:, 0, 1] = APART * np.arange(len(names))
    together = ((pose + shifts).reshape(-1, 3) for pose in poses)
    return Layout(labels_of(layout.labels, names), layout.rate), together
