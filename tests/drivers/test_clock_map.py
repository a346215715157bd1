from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.clock_map import JUMP, ClockMap

RATE = 120.0


def through(stamps: np.ndarray, received: np.ndarray) -> tuple[np.ndarray, ClockMap, Counter]:
    counters: Counter[str] = Counter()
    clock_map = ClockMap(counters)
    mapped = [clock_map.map(t, d) for t, d in zip(received, stamps, strict=True)]
    return np.array(mapped), clock_map, counters


def line(
    seconds: float, ppm: float = 0.0, offset: float = 1000.0, jitter: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """When frames were measured on the host's clock, their stamps, and when they came."""
    true = np.arange(round(seconds * RATE)) / RATE
    stamps = true * (1 + ppm * 1e-6)
    delay = np.random.default_rng(seed).exponential(jitter, len(true)) if jitter else 0.0
    return true + offset, stamps, np.maximum.accumulate(true + offset + delay)


def test_a_perfect_line_is_mapped_to_when_it_came() -> None:
    true, stamps, received = line(30.0)
    mapped, clock_map, counters = through(stamps, received)
    np.testing.assert_allclose(mapped, true, atol=1e-9)
    assert clock_map.drift == pytest.approx(0, abs=1e-12)
    assert clock_map.offset == pytest.approx(1000.0)
    assert not +counters


def test_a_wire_without_stamps_keeps_the_time_of_receipt() -> None:
    counters: Counter[str] = Counter()
    clock_map = ClockMap(counters)
    assert clock_map.map(3.0, math.nan) == 3.0
    assert math.isnan(clock_map.offset)


@pytest.mark.parametrize("ppm", [-300, -50, 0, 5, 50, 300])
@pytest.mark.parametrize("seed", range(3))
def test_drift_and_delay_are_told_apart(ppm: float, seed: int) -> None:
    true, stamps, received = line(120.0, ppm, jitter=0.003, seed=seed)
    mapped, clock_map, counters = through(stamps, received)
    assert -clock_map.drift * 1e6 == pytest.approx(ppm, abs=5)
    assert np.abs(mapped - true)[30 * 120 :].max() < 1e-3
    assert counters["clock_jumps"] == 0


def test_over_an_hour_of_drift_nothing_adds_up() -> None:
    true, stamps, received = line(3600.0, 80, jitter=0.002)
    step = slice(None, None, 10)
    mapped, _, counters = through(stamps[step], received[step])
    assert np.abs(mapped - true[step])[600:].max() < 1e-3
    assert counters["clock_jumps"] == 0


@given(
    st.floats(-1e6, 1e6),
    st.lists(st.floats(0, 0.2), min_size=1, max_size=300),
)
def test_no_frame_is_mapped_to_after_it_came(offset: float, delays: list[float]) -> None:
    stamps = np.arange(len(delays)) / RATE
    received = np.maximum.accumulate(stamps + offset + delays)
    mapped, _, counters = through(stamps, received)
    assert (mapped <= received + 1e-6).all()
    assert counters["clock_jumps"] == 0


@settings(max_examples=50)
@given(st.floats(1.5 * JUMP, 1e6), st.booleans(), st.integers(0, 100))
def test_a_clock_that_is_set_is_one_jump(jump: float, back: bool, seed: int) -> None:
    true, stamps, received = line(20.0, jitter=0.002, seed=seed)
    stamps[1200:] += -jump if back else jump
    mapped, _, counters = through(stamps, received)
    assert counters["clock_jumps"] == 1
    assert np.abs(mapped - true)[1300:].max() < 0.01


@pytest.mark.parametrize("wrong", [-5.0, 5.0, 1e9])
def test_a_single_wrong_stamp_is_not_believed_for_long(wrong: float) -> None:
    true, stamps, received = line(20.0)
    stamps[1200] += wrong
    mapped, _, counters = through(stamps, received)
    assert 1 <= counters["clock_jumps"] <= 2
    np.testing.assert_allclose(np.delete(mapped, 1200), np.delete(true, 1200), atol=1e-6)


@pytest.mark.parametrize("pause", [0.5, 5.0, 300.0])
def test_a_pause_of_both_clocks_is_no_jump(pause: float) -> None:
    true, stamps, received = line(40.0, ppm=50)
    for times, passed in ((true, pause), (stamps, pause * (1 + 50e-6)), (received, pause)):
        times[2400:] += passed
    mapped, _, counters = through(stamps, received)
    assert counters["clock_jumps"] == 0
    assert np.abs(mapped - true).max() < 1e-3


def test_a_stall_does_not_shift_what_came_before_or_after() -> None:
    true, stamps, received = line(20.0)
    held = (true >= 1010.0) & (true < 1012.0)
    received[held] = 1012.0
    mapped, _, counters = through(stamps, received)
    np.testing.assert_allclose(mapped, true, atol=1e-6)
    assert counters["clock_jumps"] == 0


@given(
    st.lists(st.tuples(st.floats(0, 1), st.floats(allow_infinity=False, width=32)), max_size=100)
)
def test_no_stamp_at_all_does_harm(steps: list[tuple[float, float]]) -> None:
    counters: Counter[str] = Counter()
    clock_map = ClockMap(counters)
    t = 100.0
    for step, stamp in steps:
        t += step
        assert math.isfinite(clock_map.map(t, stamp))


@pytest.mark.parametrize("stamp", [0.0, 5.0])
def test_a_stamp_that_stands_still_says_nothing(stamp: float) -> None:
    true, _, received = line(20.0)
    mapped, _, counters = through(np.full(len(true), stamp), received)
    np.testing.assert_allclose(mapped, received)
    assert not +counters


def test_coarse_stamps_do_not_make_frames_later_than_they_came() -> None:
    _, stamps, received = line(20.0, jitter=0.002)
    mapped, _, counters = through(np.floor(stamps), received)
    assert (mapped <= received + 1e-9).all()
    assert (mapped >= received - 1.5).all()
    assert not +counters


@pytest.mark.parametrize("stamp", [1e29, -1e29, 1e15, math.inf])
def test_a_stamp_that_is_no_time_is_none(stamp: float) -> None:
    true, stamps, received = line(20.0)
    stamps[1200] = stamp
    mapped, _, counters = through(stamps, received)
    np.testing.assert_allclose(mapped, true, atol=1e-6)
    assert not +counters
