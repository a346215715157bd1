import numpy as np

from drivers.marker_set import MARKERS
from training.mirroring import mirrored


def test_left_and_right_are_exchanged():
    pose = np.arange(123, dtype=np.float32).reshape(1, 41, 3)
    twin = mirrored(pose)[0]
    row = {label: pose[0, MARKERS.index(label)] for label in MARKERS}
    other = {"LFHD": "RFHD", "RBHD": "LBHD", "LWRA": "RWRA", "RMT5": "LMT5", "LBWT": "RBWT"}
    for label, source in other.items():
        np.testing.assert_array_equal(twin[MARKERS.index(label)], row[source] * [-1, 1, 1])
    for label in ("C7", "T10", "CLAV", "STRN", "RBAC"):  # on the middle, or without a twin
        np.testing.assert_array_equal(twin[MARKERS.index(label)], row[label] * [-1, 1, 1])


def test_twice_is_nothing():
    poses = np.random.default_rng(0).normal(size=(5, 41, 3)).astype(np.float32)
    np.testing.assert_array_equal(mirrored(mirrored(poses)), poses)
