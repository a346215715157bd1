"""Frames whose markers are wanted in another order."""

from __future__ import annotations

import numpy as np

from drivers.frame import Layout, MarkerFrame

XYZ = np.arange(9, dtype=np.float32).reshape(3, 3)
FRAME = MarkerFrame(0, 0.0, 0.0, Layout(("a", "b", "c"), 100.0), XYZ)


def test_markers_are_put_in_the_order_asked_for() -> None:
    found = FRAME.ordered(("c", "nobody", "a"))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, [XYZ[2], [np.nan] * 3, XYZ[0]])


def test_of_labels_that_nobody_has_nothing_is_known() -> None:
    rows, own = FRAME.layout.places(("x", "y"))
    assert len(rows) == len(own) == 0
    assert np.isnan(FRAME.ordered(("x", "y"))).all()
