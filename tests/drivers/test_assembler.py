"""Frames put together from single markers: each marker says which frame it is of."""

from __future__ import annotations

import itertools
import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.frame import MarkerFrame
from drivers.wire.assembler import Assembler

LABELS = tuple("ABCDEFGHI")
RATE = 120.0
WARM = 6  # frames after which labels and order are known

Marker = tuple[str, int, float]  # label, number of its frame, time


def prompt(frames: Iterable[tuple[int, Iterable[str]]], rate: float = RATE) -> Iterator[Marker]:
    """Markers that come when they are sent: in bursts."""
    for number, labels in frames:
        for place, label in enumerate(labels):
            yield label, number, number / rate + place * 1e-4


def whole(labels: Iterable[str], numbers: Iterable[int]) -> Iterator[tuple[int, Iterable[str]]]:
    return ((number, labels) for number in numbers)


def put_together(assembler: Assembler, markers: Iterable[Marker]) -> list[MarkerFrame]:
    frames = []
    for label, number, t in markers:
        frames += assembler.add(label, (number, ord(label[0]), 0.0), t)
    return frames + assembler.end()


def numbers_in(frame: MarkerFrame) -> set[int]:
    """The frames of which its markers are."""
    return {int(x) for x in frame.xyz[:, 0] if not math.isnan(x)}


def check_labels(frame: MarkerFrame) -> None:
    for label, xyz in zip(frame.layout.labels, frame.xyz, strict=True):
        assert math.isnan(xyz[1]) or xyz[1] == ord(label)


gaps = st.lists(
    st.sampled_from([0.0, 0.0, 0.0, 1e-4, 4e-3, 0.016, 0.3]), min_size=200, max_size=200
)


@given(st.integers(1, 9), gaps)
def test_however_the_line_groups_the_markers_each_frame_is_whole(count, gaps) -> None:
    labels, assembler = LABELS[:count], Assembler(Counter())
    put_together(assembler, prompt(whole(labels, range(WARM))))
    t, markers = WARM / RATE, []
    for (number, label), gap in zip(
        itertools.product(range(WARM, WARM + 200 // count), labels), gaps, strict=False
    ):
        t += gap
        markers.append((label, number, t))
    frames = put_together(assembler, markers)
    assert [numbers_in(frame) for frame in frames] == [
        {number} for number in range(WARM, WARM + 200 // count)
    ]
    assert not any(np.isnan(frame.xyz).any() for frame in frames)


@settings(max_examples=100)
@given(st.data(), st.integers(3, 9), gaps)
def test_a_missing_marker_costs_no_more_than_its_own_place(data, count, gaps) -> None:
    labels, assembler = LABELS[:count], Assembler(Counter())
    put_together(assembler, prompt(whole(labels, range(WARM))))
    hidden = st.sets(st.sampled_from(labels), max_size=(count - 1) // 2)
    t, markers, sent = WARM / RATE, [], {}
    gap = iter(gaps)
    for number in range(WARM, WARM + 200 // count):
        lost = data.draw(hidden)
        sent[number] = set(labels) - lost
        for label in labels:
            t += next(gap)
            if label not in lost:
                markers.append((label, number, t))
    frames = put_together(assembler, markers)
    assert [numbers_in(frame) for frame in frames] == [{number} for number in sent]
    late = 0
    for frame, there in zip(frames, sent.values(), strict=True):
        check_labels(frame)
        rows = zip(frame.layout.labels, frame.xyz, strict=True)
        came = {label for label, xyz in rows if not np.isnan(xyz).any()}
        assert came <= there
        late += len(there - came)
    # One that was away for more than a second is no longer waited for when it comes back.
    assert assembler.counters["late_markers"] == late


@given(st.integers(1, 8), st.integers(0, 8), st.integers(0, 30))
def test_a_new_marker_never_shifts_the_frames(count, place, since) -> None:
    labels = LABELS[:count]
    more = (*labels[:place], "Z", *labels[place:])
    assembler = Assembler(Counter())
    frames = put_together(
        assembler,
        prompt((number, more if number >= WARM + since else labels) for number in range(60)),
    )
    assert all(len(numbers_in(frame)) == 1 for frame in frames)
    last = frames[-1]
    assert set(last.layout.labels) == set(more)
    assert numbers_in(last) == {59}
    assert not np.isnan(last.xyz).any()
    for frame in frames:
        check_labels(frame)


@settings(max_examples=50)
@given(st.integers(0, 2**32), st.integers(1, 20))
def test_labels_that_are_rubbish_do_not_enter_the_layout_and_take_no_memory(seed, each) -> None:
    rng = random.Random(seed)
    assembler = Assembler(Counter())
    put_together(assembler, prompt(whole(LABELS, range(WARM))))
    rubbish = (f"~{rng.getrandbits(60)}" for _ in itertools.count())
    markers = []
    for marker in prompt(whole(LABELS, range(WARM, 60))):
        markers += [(next(rubbish), *marker[1:]) for _ in range(rng.randrange(each))]
        markers.append(marker)
    frames = put_together(assembler, markers)
    assert {frame.layout.labels for frame in frames} == {LABELS}
    assert [numbers_in(frame) for frame in frames] == [{number} for number in range(WARM, 60)]
    assert len(assembler._heard) <= 255
    put_together(assembler, ((next(rubbish), 0, 1.0) for _ in range(2000)))
    assert len(assembler._heard) + len(assembler._markers) <= 510


def test_a_frame_is_there_with_its_last_marker() -> None:
    assembler = Assembler(Counter())
    for label, number, t in prompt(whole(LABELS, range(20))):
        frames = assembler.add(label, (number, 0.0, 0.0), t)
        if number > WARM:
            assert bool(frames) == (label == LABELS[-1])
            assert all(frame.t == t for frame in frames)


@pytest.mark.parametrize("seed", range(5))
def test_a_sender_without_an_order_is_understood_by_its_pauses(seed) -> None:
    rng = random.Random(seed)
    assembler = Assembler(Counter())
    shuffled = []
    for number in range(300):
        labels = rng.sample(LABELS, len(LABELS))
        shuffled.append((number, labels[: rng.choice([8, 9, 9])]))
    frames = put_together(assembler, prompt(shuffled))
    assert all(len(numbers_in(frame)) == 1 for frame in frames)
    assert [numbers_in(frame) for frame in frames[1:]] == [{number} for number in range(3, 300)]


def test_a_sender_that_takes_another_order_is_understood_again() -> None:
    assembler = Assembler(Counter())
    put_together(assembler, prompt(whole(LABELS, range(30))))
    other = (*LABELS[4:], *LABELS[3::-1])
    frames = put_together(assembler, prompt(whole(other, range(30, 60))))
    assert all(len(numbers_in(frame)) == 1 for frame in frames)
    assert [numbers_in(frame) for frame in frames[-20:]] == [{n} for n in range(40, 60)]
    assert not any(np.isnan(frame.xyz).any() for frame in frames[-20:])


def test_markers_spread_over_the_whole_interval_make_frames() -> None:
    """As a tracker that measures one after the other sends them."""
    assembler = Assembler(Counter())
    markers = [
        (label, number, (number + place / 4) / 30)
        for number in range(90)
        for place, label in enumerate("ABCD")
    ]
    frames = put_together(assembler, markers)
    assert [numbers_in(frame) for frame in frames[1:]] == [{number} for number in range(3, 90)]
    assert frames[-1].layout.rate == 30


def test_reads_of_16_ms_settle_into_whole_frames() -> None:
    """As a USB adapter delivers them that gathers bytes: the reads end anywhere in a frame."""
    assembler = Assembler(Counter())
    markers = [
        (label, number, math.ceil((number / 120 + place * 4e-4) / 0.016) * 0.016)
        for number in range(240)
        for place, label in enumerate(LABELS)
    ]
    frames = put_together(assembler, markers)
    settled = frames[-180:]
    assert all(not np.isnan(frame.xyz).any() for frame in settled)
    assert all(len(numbers_in(frame)) <= 2 for frame in settled)


def test_a_marker_that_comes_back_last_is_late_once() -> None:
    assembler = Assembler(Counter())
    frames = put_together(
        assembler,
        prompt((n, LABELS[:3] if not 20 <= n < 300 else LABELS[:2]) for n in range(400)),
    )
    assert all(len(numbers_in(frame)) == 1 for frame in frames)
    assert assembler.counters["late_markers"] == 1
    assert not np.isnan(frames[-1].xyz).any()


def test_the_wire_may_say_that_a_frame_is_whole_and_number_it() -> None:
    assembler = Assembler(Counter())
    frames = []
    for number in range(10):
        for label in ("A", "B") if number % 2 else ("B",):
            frames += assembler.add(label, (number, 0.0, 0.0), 0.0, number / 50, 100 + number)
    frames += assembler.end()
    assert [frame.index for frame in frames] == list(range(102, 110))
    assert [frame.t_device for frame in frames] == [n / 50 for n in range(2, 10)]
    assert all(len(numbers_in(frame)) == 1 for frame in frames)


def test_a_frame_that_comes_whole_stays_whole() -> None:
    assembler = Assembler(Counter())
    for number in range(3):
        frames = assembler.put({"A": (0, 0, 0), "B": (1, 1, 1)}, 0.0, number / 50, number)
    (frame,) = frames
    assert (frame.index, frame.layout.labels) == (2, ("A", "B"))
    (frame,) = assembler.put({}, 0.0, 0.06, 3)
    assert np.isnan(frame.xyz).all()


@pytest.mark.parametrize("rate", [25.0, 59.94, 120.0, 240.0, 1000.0])
def test_the_rate_is_measured(rate) -> None:
    assembler = Assembler(Counter())
    frames = put_together(assembler, prompt(whole("AB", range(int(3 * rate))), rate))
    assert frames[-1].layout.rate == pytest.approx(rate, rel=0.02)
    assert len({id(frame.layout) for frame in frames}) <= 2


def test_the_rate_is_measured_though_the_stamps_stand_still() -> None:
    assembler = Assembler(Counter())
    for number in range(100):
        frames = assembler.put({"A": (0, 0, 0)}, number / 30, 1.8e9)
    assert frames[-1].layout.rate == 30.0


def test_lost_frames_make_no_other_rate_but_another_rate_does() -> None:
    assembler = Assembler(Counter())
    lossy = [n for n in range(600) if not (200 <= n < 320 and n % 3)]
    frames = put_together(assembler, prompt(whole("AB", lossy)))
    assert {frame.layout.rate for frame in frames} == {120.0}
    slow = [(label, n, 5 + t) for label, n, t in prompt(whole("AB", range(180)), 60.0)]
    assert put_together(assembler, slow)[-1].layout.rate == 60.0


def test_a_rate_that_is_known_stays() -> None:
    assembler = Assembler(Counter(), 100.0)
    frames = put_together(assembler, prompt(whole("AB", range(600))))
    assert {frame.layout.rate for frame in frames} == {100.0}


def test_there_are_at_most_255_labels_and_places_are_given_away_after_a_minute() -> None:
    assembler = Assembler(Counter())
    many = [f"m{n}" for n in range(300)]
    for number in range(5):
        assembler.put(dict.fromkeys(many[:255], (0.0, 0.0, 0.0)), number / 10)
    assembler.put({"late": (0.0, 0.0, 0.0)}, 0.6)
    assembler.put({"late": (0.0, 0.0, 0.0)}, 0.7)
    assembler.put({"late": (0.0, 0.0, 0.0)}, 0.8)
    assert assembler.layout is not None
    assert assembler.layout.labels == tuple(many[:255])
    assert assembler.counters["too_many_labels"] == 1
    for t in (70.0, 70.1, 70.2):
        (frame, *_) = assembler.put({"new": (1.0, 2.0, 3.0)}, t) or (None,)
    assert frame is not None
    assert frame.layout.labels == ("new",)


def test_numbers_too_large_for_the_frame_are_infinite_not_an_error() -> None:
    assembler = Assembler(Counter())
    for _ in range(3):
        frames = assembler.put({"A": (1e300, 0.0, 0.0)}, 0.0)
    assert np.isinf(frames[0].xyz[0, 0])
