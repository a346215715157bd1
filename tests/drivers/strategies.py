"""Random layouts and frames for the codecs' property tests."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drivers.frame import Layout

_LABEL = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=30)


def layouts(largest: int = 45) -> st.SearchStrategy[Layout]:
    return st.builds(
        Layout,
        st.lists(_LABEL, min_size=1, max_size=largest, unique=True).map(tuple),
        st.sampled_from([30.0, 59.94, 119.88, 120.0, 1000.0]),
    )


@st.composite
def frames(draw, layout: Layout) -> tuple[int, int, np.ndarray]:
    """Index, device time in µs, and positions with missing markers."""
    count = len(layout.labels)
    finite = st.floats(-1e4, 1e4, width=32)
    xyz = draw(hnp.arrays(np.float32, (count, 3), elements=finite))
    xyz[draw(hnp.arrays(bool, count))] = np.nan
    return draw(st.integers(0, 2**31 - 1)), draw(st.integers(0, 2**45)), xyz


def same_positions(a: np.ndarray, b: np.ndarray) -> bool:
    """Equal to the last bit, NaN where NaN."""
    return a.dtype == b.dtype == np.float32 and np.array_equal(a, b, equal_nan=True)
