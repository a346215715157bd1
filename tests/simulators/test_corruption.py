from __future__ import annotations

import numpy as np
import pytest

from simulators.corruption import Corruption, Faults, Gaps, parse_gaps, parse_noise, parse_share

STILL = np.ones((9, 3), np.float32)


def apply(faults: Faults, frames: int, seed: int = 0) -> np.ndarray:
    corruption = Corruption(faults, len(STILL), seed)
    return np.stack([corruption.apply(STILL) for _ in range(frames)])


def runs(hidden: np.ndarray) -> list[int]:
    """Lengths of the runs of True, those at the ends left out."""
    edges = np.flatnonzero(np.diff(hidden.astype(int)))
    starts = [e for e in edges if not hidden[e]]
    return [int(e - s) for s in starts for e in [next((x for x in edges if x > s), None)] if e]


def test_nothing_asked_for_is_nothing_done() -> None:
    np.testing.assert_array_equal(apply(Faults(), 10), np.broadcast_to(STILL, (10, 9, 3)))


def test_noise_has_the_deviation_asked_for_per_coordinate() -> None:
    noisy = apply(Faults(noise=0.002), 4000) - STILL
    np.testing.assert_allclose(noisy.std(axis=(0, 1)), 0.002, rtol=0.02)
    assert abs(noisy.mean()) < 1e-4


def test_dropped_samples_are_whole_markers_and_of_the_share_asked_for() -> None:
    missing = np.isnan(apply(Faults(drop=0.05), 8000))
    assert (missing.any(axis=2) == missing.all(axis=2)).all()
    assert missing.mean() == pytest.approx(0.05, abs=0.003)


@pytest.mark.parametrize("frames", [120, 20_000])
def test_gaps_have_their_share_and_lengths_in_short_clips_too(frames: int) -> None:
    shares, lengths = [], []
    for seed in range(max(1, 40_000 // frames)):
        missing = np.isnan(apply(Faults(gaps=Gaps(0.2, 10, 100)), frames, seed)).any(axis=2)
        shares.append(missing.mean())
        for marker in range(missing.shape[1]):
            lengths += runs(missing[:, marker])
    assert np.mean(shares) == pytest.approx(0.2, abs=0.02)
    assert min(lengths) >= 10
    assert max(lengths) <= 100
    if frames > 1000:
        assert np.mean(lengths) == pytest.approx(55, abs=3)


def test_the_same_seed_gives_the_same_faults() -> None:
    faults = Faults(0.001, 0.05, Gaps(0.2, 10, 100))
    np.testing.assert_array_equal(apply(faults, 200, 1), apply(faults, 200, 1))
    assert not np.array_equal(apply(faults, 200, 1), apply(faults, 200, 2), equal_nan=True)


def test_what_is_on_the_command_line_is_read_as_it_is_meant() -> None:
    assert parse_noise("1mm") == pytest.approx(0.001)
    assert parse_noise("0.2cm") == pytest.approx(0.002)
    assert parse_share("5%") == pytest.approx(0.05)
    assert parse_gaps("20%:10-100") == Gaps(0.2, 10, 100)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (parse_noise, "1"),
        (parse_noise, "-1mm"),
        (parse_share, "0.05"),
        (parse_share, "100%"),
        (parse_gaps, "20%"),
        (parse_gaps, "20%:100-10"),
        (parse_gaps, "20%:0-10"),
        (parse_gaps, "90%:1-3"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_an_example(read, text: str) -> None:
    with pytest.raises(ValueError, match=r"write for example|make them longer"):
        read(text)
