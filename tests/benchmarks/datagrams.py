"""Which frame a datagram tells of: its number as the bridge under test has it, and from these which
packet it answers, also where some were lost on the way.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tests.benchmarks.null_bridge import MARK, NOTHING

HEAD = 256  # bytes of a datagram in which its number is

_OK, _OK_AT = b"/VMC/Ext/OK\0,i\0\0", 20  # after `#bundle`, a time tag and a size
_T, _T_AT = b"/VMC/Ext/T\0\0,f\0\0", 44
_POSE = re.compile(rb"/markerbridge/(?:[^/\0]+/)?pose\0+")  # of one of several, with a name

Times = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int64]


def number_of(head: bytes, rate: float) -> float | None:
    """The number of the frame, in frames since the first, by the first bytes of a datagram; None in
    one that tells of none. VMC has no numbers, but seconds since the first pose. rate: Hz.
    """
    if head.startswith(MARK):
        return float(NOTHING.unpack_from(head)[1])
    if pose := _POSE.match(head):
        tags_end = head.index(b"\0", pose.end())
        return float(struct.unpack_from(">i", head, (tags_end // 4 + 1) * 4)[0])
    if head.startswith(_T, _T_AT):
        return float(struct.unpack_from(">f", head, _T_AT + len(_T))[0]) * rate
    return None


def has_pose(head: bytes) -> bool:
    """Whether a VMC datagram says that there is a pose to show."""
    return head.startswith(_OK, _OK_AT) and head[_OK_AT + len(_OK) + 3] == 1


def answered(numbers: Sequence[float], came: Times, written: Times) -> Rows:
    """For each datagram, in the order in which they came, the row of the packet that it answers.

    numbers: of their frames; came: (n,) seconds. written: (m,) seconds, in order, NaN where a
    packet never went out. VMC's seconds, mapped from clock to clock, are out by a little: what
    counts is how many frames one datagram comes after the other, one at the least, and none answers
    a packet that was not written yet.
    """
    if not len(numbers):
        return np.zeros(0, np.int64)
    out = np.flatnonzero(~np.isnan(written))
    if len(numbers) == len(out):  # each packet that went out has its answer
        return out
    steps = np.maximum(1, np.rint(np.diff(numbers)))
    rows = np.concatenate([[0], np.cumsum(steps)]) + np.rint(numbers[0])
    latest = out[np.maximum(np.searchsorted(written[out], came, "right") - 1, 0)]
    return np.minimum(rows.astype(np.int64), latest)
