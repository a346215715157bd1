"""The embedded performer walks as people do."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from drivers.c3d_file import read_c3d
from drivers.marker_set import MARKERS
from simulators.performer import load_performer

RATE = 120.0
SECONDS = 40


@pytest.fixture(scope="module")
def walk() -> np.ndarray:
    walker = load_performer("walk")
    return np.stack([walker.pose(index) for index in range(int(RATE * SECONDS))])


def row(label: str) -> int:
    return MARKERS.index(label)


def slide(xyz: np.ndarray) -> float:
    """Median speed along the floor, m/s, of a heel while it is within 2 cm of its lowest."""
    speeds = []
    for label in ("LHEE", "RHEE"):
        heel = xyz[:, row(label)]
        speed = np.linalg.norm(np.diff(heel[:, :2], axis=0), axis=1) * RATE
        low = heel[1:, 2] < np.nanpercentile(heel[:, 2], 2) + 0.02
        speeds.append(np.nanmedian(speed[low]))
    return float(np.mean(speeds))


def test_it_takes_a_few_kilobytes() -> None:
    assert len((files("simulators") / "data" / "walk.json").read_bytes()) < 8000


def test_unknown_performers_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"no performer 'moonwalk' \(known: walk\)"):
        load_performer("moonwalk")


def test_it_has_the_proportions_and_the_pace_of_a_walking_adult(walk) -> None:
    assert walk.shape == (4800, 41, 3)
    assert walk.dtype == np.float32
    assert 1.4 < walk[:, row("LFHD"), 2].mean() < 1.9
    assert 0.0 < walk[:, [row("LTOE"), row("RTOE")], 2].min() < 0.06
    centre = walk[:, row("C7"), :2]
    speed = np.linalg.norm(np.diff(centre, axis=0), axis=1).sum() / SECONDS
    assert 1.0 < speed < 1.6
    # It stays around, so a camera and a play area can hold it.
    assert np.ptp(centre, axis=0).max() < 30


def test_it_moves_without_a_jump(walk) -> None:
    steps = np.linalg.norm(np.diff(walk, axis=0), axis=2) * RATE
    assert steps.max() < 6  # m/s: a swinging foot
    jerk = np.linalg.norm(np.diff(walk, n=2, axis=0), axis=2) * RATE**2
    assert jerk.max() < 150  # m/s²


def test_it_never_ends_and_repeats_itself_exactly(walk) -> None:
    walker = load_performer("walk")
    far = walker.pose(10**9)
    assert np.isfinite(far).all()
    assert np.abs(far[:, 2] - walk[:, :, 2].mean(axis=0)).max() < 0.6
    np.testing.assert_array_equal(walker.pose(77), walk[77])


def test_left_and_right_are_where_they_belong(walk) -> None:
    """Left of the direction of walking."""
    ahead = np.diff(walk[:, row("C7"), :2], axis=0)
    across = walk[1:, row("LSHO"), :2] - walk[1:, row("RSHO"), :2]
    left = ahead[:, 0] * across[:, 1] - ahead[:, 1] * across[:, 0]
    assert (left > 0).all()


def test_its_limbs_keep_their_lengths(walk) -> None:
    for a, b in (("LKNE", "LANK"), ("RKNE", "RANK"), ("LELB", "LWRA"), ("RELB", "RWRA")):
        length = np.linalg.norm(walk[:, row(a)] - walk[:, row(b)], axis=1)
        assert length.std() / length.mean() < 0.03, (a, b)


def test_its_feet_stand_as_firmly_as_captured_ones(walk, data_dir) -> None:
    captured = slide(read_c3d(data_dir / "real/07_01.c3d").xyz)
    assert slide(walk) < max(0.15, 1.5 * captured)
