from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.smoothing import LONGEST, NoiseFilter
from drivers.c3d_file import read_c3d

TRACKED = ("RTOE", "LANK", "RKNE", "LWRB", "RWRB", "LBWT", "C7", "LSHO", "RSHO")
RATE = 120.0
NOISE = 0.002  # m
MM = 1000.0


def filtered(xyz: np.ndarray, rate: float = RATE, noise_filter: NoiseFilter | None = None):
    """The frames (N, T, 3) as a filter gives them, and the filter as it is then."""
    one = noise_filter or NoiseFilter(xyz.shape[1])
    return np.array([one.update(frame, 1 / rate) for frame in xyz], float), one


def waves(seconds: float, hertz: float, rate: float = RATE, markers: int = 6) -> np.ndarray:
    """Markers that swing by 0.2 m in each coordinate, each at a phase of its own."""
    time = np.arange(round(seconds * rate))[:, None, None] / rate
    phases = np.linspace(0, 6, 3 * markers).reshape(markers, 3)
    return 0.2 * np.sin(2 * np.pi * hertz * time + phases)


def noisy(xyz: np.ndarray, noise: float = NOISE) -> np.ndarray:
    return xyz + noise * np.random.default_rng(11).normal(size=xyz.shape)


def third(xyz: np.ndarray) -> float:
    """Mean norm of the third difference, where it is known."""
    return float(np.nanmean(np.linalg.norm(np.diff(xyz, n=3, axis=0), axis=-1)))


def rms(error: np.ndarray) -> float:
    """Per coordinate, mm."""
    return float(MM * np.sqrt(np.nanmean(error**2)))


@pytest.mark.parametrize("name", ["02_01", "85_12", "135_02", "HDM_mm_01-02_03"])
def test_a_clean_capture_goes_through_unchanged(data_dir, name) -> None:
    xyz = read_c3d(data_dir / f"real/{name}.c3d", TRACKED).xyz[:600].astype(float)
    after, _ = filtered(xyz)
    assert np.linalg.norm(after - xyz, axis=2).mean() < 0.0002
    assert third(after) == pytest.approx(third(xyz), rel=0.05)


@pytest.mark.parametrize("hertz", [0.7, 3.0])
def test_clean_motion_is_not_held_back(hertz) -> None:
    xyz = waves(2, hertz)
    after, one = filtered(xyz)
    error = np.abs(after - xyz)
    assert error[:12].max() < 0.008  # what noise there is cannot be known yet
    assert error[12:].max() < 0.00001
    assert (one.noise < 0.0001).all()


@pytest.mark.parametrize(("name", "factor"), [("02_01", 20), ("HDM_mm_01-02_03", 35)])
def test_noise_on_a_capture_is_made_as_smooth_as_the_body(data_dir, name, factor) -> None:
    xyz = read_c3d(data_dir / f"real/{name}.c3d", TRACKED).xyz[:600].astype(float)
    before = noisy(xyz)
    after, one = filtered(before)
    assert third(before) / third(after) > factor
    assert np.linalg.norm(after - xyz, axis=2).mean() < 0.010
    assert one.noise == pytest.approx(np.full(len(TRACKED), NOISE), rel=0.3)


@pytest.mark.parametrize("noise", [0.0005, 0.002, 0.005])
def test_a_marker_that_stands_still_stands_still(noise) -> None:
    xyz = np.full((360, 9, 3), [1.0, -2.0, 0.5])
    after, _ = filtered(noisy(xyz, noise))
    assert rms((after - xyz)[120:]) < 0.4 * MM * noise
    assert third(after[120:]) < third(noisy(xyz, noise)) / 200


def test_even_motion_is_not_lagged_behind() -> None:
    """2 m/s: a plain low-pass of the memory that it has would lie 0.1 m behind."""
    time = np.arange(600)[:, None, None] / RATE
    xyz = np.array([1.5, -1.2, 0.5]) * time + np.zeros((1, 20, 1))
    after, one = filtered(noisy(xyz))
    behind = (after - xyz)[240:].mean(axis=(0, 1))
    assert np.abs(behind).max() < 0.0003
    assert one._memory.mean() > 0.9 * LONGEST


@pytest.mark.parametrize(("rate", "bound"), [(60.0, 16.0), (120.0, 12.0), (240.0, 9.0)])
def test_fast_motion_is_followed_through_noise(rate, bound) -> None:
    """3 Hz and 0.2 m: peaks of 3.8 m/s and 71 m/s². RMS error per coordinate, mm."""
    xyz = waves(3, 3.0, rate)
    after, _ = filtered(noisy(xyz), rate)
    error = (after - xyz)[round(rate) :]
    assert rms(error) < bound
    assert rms(after[round(rate) :]) == pytest.approx(rms(xyz[round(rate) :]), rel=0.11)


@pytest.mark.parametrize("rate", [60.0, 120.0, 240.0])
def test_any_rate_will_do(rate) -> None:
    xyz = waves(4, 0.7, rate)
    after, one = filtered(noisy(xyz), rate)
    settled = slice(round(rate), None)
    assert one.noise == pytest.approx(np.full(6, NOISE), rel=0.35)
    assert rms((after - xyz)[settled]) < 9.0
    velocity_error = np.diff(after - xyz, axis=0)[settled] * rate
    assert rms(velocity_error) < 80.0  # mm/s; without the filter 170, 340 and 680


def test_it_hears_noise_begin_and_end() -> None:
    xyz = waves(6, 0.7)
    before = xyz.copy()
    before[240:480] = noisy(xyz)[240:480]
    after, _ = filtered(before)
    np.testing.assert_allclose(after[120:240], xyz[120:240], atol=1e-5)
    assert third(after[360:480]) < third(before[360:480]) / 20
    assert rms((after - xyz)[600:]) < 0.1
    assert third(after[600:]) == pytest.approx(third(xyz[600:]), rel=0.05)


def test_quantised_positions_become_smoother() -> None:
    xyz = waves(4, 0.7)
    steps = np.round(xyz, 3)
    after, _ = filtered(steps)
    assert third(after[120:]) < third(steps[120:]) / 5
    assert rms((after - xyz)[120:]) < 3.0


def test_a_noisy_marker_is_filtered_and_the_clean_ones_are_left() -> None:
    xyz = waves(3, 0.7)
    before = xyz.copy()
    before[:, 2] = noisy(xyz)[:, 2]
    after, _ = filtered(before)
    clean = np.arange(6) != 2
    np.testing.assert_allclose(after[60:, clean], xyz[60:, clean], atol=1e-4)
    assert third(after[120:, 2]) < third(before[120:, 2]) / 20


def test_each_marker_is_on_its_own() -> None:
    before = noisy(waves(1, 1.0, markers=3))
    before[40:60, 1] = np.nan
    together, _ = filtered(before)
    for marker in range(3):
        alone, _ = filtered(before[:, [marker]])
        np.testing.assert_allclose(together[:, [marker]], alone, atol=1e-6)


def test_where_the_world_has_its_origin_does_not_matter() -> None:
    before = noisy(waves(1, 1.0))
    here, _ = filtered(before)
    away = np.array([8.0, -16.0, 4.0])
    there, _ = filtered(before + away)
    np.testing.assert_allclose(there - away, here, atol=1e-5)


def test_what_is_missing_stays_missing_and_comes_back() -> None:
    xyz = waves(3, 0.7)
    before = noisy(xyz)
    before[150:200, 1] = np.nan
    before[210, 1, 2] = np.nan  # half a sample is none
    before[np.random.default_rng(2).random(before.shape[:2]) < 0.05] = np.nan
    after, _ = filtered(before)
    missing = np.isnan(before).any(axis=2)
    assert np.isnan(after[missing]).all()
    assert not np.isnan(after[~missing]).any()
    assert MM * np.linalg.norm(after[200:203, 1] - xyz[200:203, 1], axis=1).max() < 15
    assert rms((after - xyz)[120:]) < 9.0


def test_dropped_samples_do_not_make_it_rough() -> None:
    xyz = waves(4, 0.7)
    before = noisy(xyz)
    whole, _ = filtered(before)
    before[np.random.default_rng(2).random(before.shape[:2]) < 0.05] = np.nan
    holed, _ = filtered(before)
    assert third(holed[120:]) < 3 * third(whole[120:])


def test_a_dropped_frame_is_no_noise() -> None:
    """The caller says how long it was: the gap is neither a jump nor a knock."""
    xyz = waves(2, 1.5)
    one, other = NoiseFilter(6), NoiseFilter(6)
    for index, frame in enumerate(xyz):
        one.update(frame, 1 / RATE)
        if index % 20:
            other.update(frame, (2 if index % 20 == 1 else 1) / RATE)
    assert (other.noise < 0.0001).all()
    np.testing.assert_allclose(other.velocity, one.velocity, atol=0.02)


def test_the_velocity_is_known_from_the_second_sample_on() -> None:
    speed = np.array([1.0, -2.0, 0.25])
    one = NoiseFilter(1)
    assert np.isnan(one.velocity).all()
    for index in range(30):
        one.update(speed * index / RATE + np.zeros((1, 3)), 1 / RATE)
        if index:
            np.testing.assert_allclose(one.velocity, [speed], rtol=0.1)
    np.testing.assert_allclose(one.velocity, [speed], rtol=0.01)
    one.update(np.full((1, 3), np.nan), 1 / RATE)
    np.testing.assert_allclose(one.velocity, [speed], rtol=0.01)


def test_the_velocity_is_right_in_noise_and_after_a_gap() -> None:
    seconds = np.arange(480)[:, None, None] / RATE
    speed = np.array([1.0, -2.0, 0.25])
    before = noisy(speed * seconds + np.zeros((1, 40, 1)))
    before[300:340] = np.nan
    one, found = NoiseFilter(40), []
    for frame in before:
        one.update(frame, 1 / RATE)
        found.append(one.velocity)
    error = np.linalg.norm(np.array(found) - speed, axis=2)
    assert error[240:300].mean() < 0.05
    np.testing.assert_array_equal(found[300], found[339])
    np.testing.assert_array_equal(found[340], 0)  # nothing is known of it yet
    assert error[341:350].mean() < 0.4  # a difference of two samples is 0.54 off
    assert error[400:].mean() < 0.05


def test_after_reset_it_is_as_new() -> None:
    before = noisy(waves(1, 1.0))
    one = NoiseFilter(6)
    first, _ = filtered(before, noise_filter=one)
    filtered(5 * before[::-1], noise_filter=one)
    one.reset()
    again, _ = filtered(before, noise_filter=one)
    np.testing.assert_array_equal(again, first)


def test_what_it_is_given_is_left_as_it_was() -> None:
    frame = noisy(waves(1, 1.0))[7].astype(np.float32)
    frame[3] = np.nan
    copy = frame.copy()
    after = NoiseFilter(6).update(frame, 1 / RATE)
    np.testing.assert_array_equal(frame, copy)
    np.testing.assert_array_equal(after, frame)  # the first sighting is taken as it is
    assert after.dtype == np.float32


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0, 0.95),
    st.sampled_from([0.0, 1e-6, 0.002, 1.0]),
    st.sampled_from([1 / 30, 1 / 60, 1 / 120, 1 / 1000, 2.0]),
)
def test_it_stays_finite_and_near_whatever_comes(seed, missing, noise, interval) -> None:
    """Gaps of any length, jumps, stalls, infinities: no warning, no NaN that was not there."""
    random = np.random.default_rng(seed)
    steps = random.choice([0.0, 0.0, 0.01, 1.0], size=(80, 4, 1)) * random.normal(size=(80, 4, 3))
    before = np.cumsum(steps, axis=0) + noise * random.normal(size=(80, 4, 3))
    before[random.random((80, 4)) < missing] = np.nan
    before[random.random((80, 4)) < 0.02] = np.inf
    present = np.isfinite(before).all(axis=2)
    one, seen = NoiseFilter(4), np.zeros(4, bool)
    reach = 0.001 + 8 * np.abs(before[present]).max(initial=0.0)
    for frame, here in zip(before, present, strict=True):
        after = one.update(frame, interval * random.choice([1.0, 1.0, 1.0, 3.0]))
        seen |= here
        np.testing.assert_array_equal(np.isfinite(after).all(axis=1), here)
        assert np.abs(after[here]).max(initial=0.0) < reach
        np.testing.assert_array_equal(np.isfinite(one.velocity).all(axis=1), seen)
        assert np.isfinite(one.noise).all()
