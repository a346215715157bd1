from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frame import Layout, MarkerFrame
from drivers.sequence import LEAP, RESTART, Sequence

LAYOUT = Layout(("C7",), 120.0)
XYZ = np.zeros((1, 3), np.float32)
MOST = 3  # frames that the buffer may hold

DEPTHS = st.integers(0, MOST)


def frame(index: int) -> MarkerFrame:
    return MarkerFrame(index, 0.0, 0.0, LAYOUT, XYZ)


def through(indices: list[int], depth: int = 0, flush: bool = True) -> tuple[list[int], Counter]:
    """The indices that come out, in order, and what was counted."""
    counters: Counter[str] = Counter()
    sequence = Sequence(counters, depth)
    out = [one.index for index in indices for one in sequence.put(frame(index))]
    if flush:
        out += [one.index for one in sequence.flush()]
        assert not sequence.waiting
    return out, +counters


@st.composite
def rough_lines(draw, depth: int | None = None) -> tuple[list[int], int]:
    """Indices as they may come: some lost, some doubled, some overtaken by at most `depth` others.

    The first and the last come, each once and in time.
    """
    depth = draw(DEPTHS) if depth is None else depth
    start = draw(st.integers(0, 10**6))
    fates = draw(st.lists(st.tuples(st.integers(0, 3), st.integers(0, depth)), max_size=60))
    indices = range(start + depth + 1, start + depth + 1 + len(fates))
    sent = []
    for index, (copies, held) in zip(indices, fates, strict=True):
        copies = (0, 1, 1, 2)[copies]
        sent += [(index + held + (0.5 if held else 0.0), index)] * copies
    came = [index for _, index in sorted(sent)]
    return [start, *came, indices.stop + depth], depth


@given(rough_lines())
def test_each_index_comes_once_and_in_order_and_everything_is_counted(
    line: tuple[list[int], int],
) -> None:
    came, depth = line
    out, counters = through(came, depth)
    assert out == sorted(set(out))
    assert set(out) <= set(came)
    late = set(came) - set(out)
    assert counters["late"] == len(late)
    assert counters["duplicates"] == len(came) - len(out) - len(late)
    span = came[-1] - came[0] + 1
    assert len(out) + counters["missing"] + counters["late"] == span
    assert counters["restarts"] == 0


@given(rough_lines())
def test_a_buffer_that_is_deep_enough_leaves_nothing_late(line: tuple[list[int], int]) -> None:
    came, depth = line
    # What is lost lets the others wait as well; without loss the depth is enough.
    present = set(came)
    if len(present) == max(present) - min(present) + 1:
        out, counters = through(came, depth)
        assert out == sorted(present)
        assert counters["missing"] == counters["late"] == 0


@given(st.permutations(range(4)), st.integers(0, 100))
def test_any_order_of_as_many_as_the_buffer_holds_is_put_right(order: list[int], at: int) -> None:
    came = [at, *(at + 1 + place for place in order), at + 5]
    out, counters = through(came, MOST)
    assert out == list(range(at, at + 6))
    behind = sum(any(later < one for later in order[i:]) for i, one in enumerate(order))
    assert bool(counters["reordered"]) == bool(behind)


@given(st.lists(st.integers(-5, 2**31), max_size=60), DEPTHS)
def test_whatever_comes_nothing_is_delivered_twice_in_a_row_or_held_for_ever(
    came: list[int], depth: int
) -> None:
    counters: Counter[str] = Counter()
    sequence = Sequence(counters, depth)
    put = 0
    for index in came:
        put += len(sequence.put(frame(index)))
        assert len(sequence._waiting) <= depth
    put += len(sequence.flush())
    assert put + counters["duplicates"] + counters["late"] == len(came)


@given(st.lists(st.booleans(), min_size=1, max_size=100))
def test_gaps_are_missing(lost: list[bool]) -> None:
    came = [0, *(i + 1 for i, gone in enumerate(lost) if not gone), len(lost) + 1]
    out, counters = through(came)
    assert out == came
    assert counters["missing"] == sum(lost)


def test_a_late_frame_is_told_from_a_copy() -> None:
    assert through([0, 1, 3, 2, 3, 4]) == ([0, 1, 3, 4], Counter(late=1, duplicates=1))


def test_frames_wait_only_while_one_before_them_is_late() -> None:
    assert through([0, 1, 2], 3, flush=False)[0] == [0, 1, 2]
    assert through([0, 2, 3], 3, flush=False)[0] == [0]
    assert through([0, 2, 3, 4, 5], 3, flush=False) == ([0, 2, 3, 4, 5], Counter(missing=1))


@pytest.mark.parametrize("depth", range(MOST + 1))
@pytest.mark.parametrize("first", [0, 5, 500])
def test_a_device_that_starts_anew_is_followed_after_a_moment(depth: int, first: int) -> None:
    before, after = list(range(1000)), list(range(first, first + 300))
    out, counters = through(before + after, depth)
    assert out[:1000] == before
    assert counters["restarts"] == 1
    followed = out[1000:]
    assert followed == after[-len(followed) :]
    assert len(after) - len(followed) < RESTART
    assert counters["missing"] == 0


def test_a_leap_is_another_count_at_once() -> None:
    came = [0, 1, 2, *range(10 * LEAP, 10 * LEAP + 3), 0, 1]
    assert through(came) == (came, Counter(restarts=2))


@pytest.mark.parametrize("depth", range(MOST + 1))
@pytest.mark.parametrize("wrong", [0, 50, 101, 103, 160, 99 + LEAP, 2**31])
def test_a_single_wrong_index_does_not_stop_the_stream(depth: int, wrong: int) -> None:
    came = list(range(200))
    came[100] = wrong
    out, _ = through(came, depth)
    lost = set(range(200)) - set(out)
    assert len(lost) <= RESTART + 1
    assert out[-1] == 199


@pytest.mark.parametrize("first", [0, 700, 5 * LEAP])
def test_what_was_lost_before_a_device_started_anew_stays_lost(first: int) -> None:
    came = [*range(800, 900), *range(910, 1000), *range(first, first + 100)]
    _, counters = through(came)
    assert counters["restarts"] == 1
    assert counters["missing"] == 10


def test_what_an_unconfirmed_leap_gave_up_is_not_lost() -> None:
    out, counters = through([*range(100), 900, *range(100, 200)])
    assert out == [*range(100), 900, *range(100, 200)]
    assert counters == Counter(bad_indices=1)
