"""Several performers in one stream: `ann:LFHD` is ann's LFHD."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from drivers.frame import Floats, Layout

APART = 1.5  # m, to the side, from one to the next


def parse_names(text: str) -> tuple[str, ...]:
    """`ann,bob`. Raises ValueError."""
    names = tuple(text.split(","))
    if any(not re.fullmatch(r"[A-Za-z0-9_-]{1,32}", name) for name in names):
        raise ValueError(f"'{text}' are no names: letters, digits, - and _, as ann,bob")
    if len(set(names)) < len(names):
        raise ValueError("a performer is named twice")
    return names


def labels_of(labels: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """The labels of one, for each of them in turn."""
    return tuple(f"{name}:{label}" for name in names for label in labels)


def side_by_side(
    layout: Layout, poses: Iterator[Floats], names: Sequence[str]
) -> tuple[Layout, Iterator[Floats]]:
    """All of them do the same beside each other: (n M, 3) metres for each pose (M, 3)."""
    shifts = np.zeros((len(names), 1, 3), np.float32)
    shifts[:, 0, 1] = APART * np.arange(len(names))
    together = ((pose + shifts).reshape(-1, 3) for pose in poses)
    return Layout(labels_of(layout.labels, names), layout.rate), together
