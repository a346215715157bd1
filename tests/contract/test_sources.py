"""What every source keeps, whatever it reads from."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SYSTEM_CLOCK
from tests.contract.rigs import FILES, LAYOUT, RIGS, Rig, stream

COUNT = 400


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    rig = RIGS[request.param](tmp_path)
    yield rig
    rig.close()


@pytest.fixture(params=[name for name in RIGS if name not in FILES])
def wire_rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    rig = RIGS[request.param](tmp_path)
    yield rig
    rig.close()


def test_every_frame_arrives_in_order_under_its_labels(rig: Rig) -> None:
    truth = stream(COUNT)
    if not rig.holes:
        truth = np.nan_to_num(truth)
    first = None
    for i in range(0, COUNT, 20):  # as much as any line holds
        rig.send(truth[i : i + 20])
        for index in range(i, i + 20):
            frame = rig.source.read(2.0)
            assert frame is not None
            first = frame if first is None else first
            assert frame.index == index + first.index
            assert frame.layout.labels == LAYOUT.labels
            if rig.tells:
                assert frame.layout == LAYOUT
                since = frame.t_device - first.t_device
                assert since == pytest.approx(index / 120, abs=1e-5)
            assert frame.xyz.dtype == np.float32
            np.testing.assert_allclose(frame.xyz, truth[index], atol=3e-4)
    assert rig.source.labels == LAYOUT.labels
    assert rig.source.counters["frames"] == COUNT


def test_times_of_receipt_are_on_the_clock_and_never_run_back(rig: Rig) -> None:
    rig.send(stream(20))
    frames = [rig.source.read(2.0) for _ in range(20)]
    times = [frame.t for frame in frames if frame]
    assert len(times) == 20
    assert times == sorted(times)
    if rig.source.clock is SYSTEM_CLOCK and rig.source.live:
        assert times[-1] <= SYSTEM_CLOCK.now()


def test_silence_is_a_none_after_the_timeout(rig: Rig) -> None:
    if not rig.source.live:
        for _ in rig.source:  # a file is silent when it has ended
            pass
    began = rig.source.clock.now()
    assert rig.source.read(0.05) is None
    assert rig.source.clock.now() - began < 2.0
    assert rig.source.read(0.0) is None


def test_rubbish_is_counted_and_the_next_good_frame_read(wire_rig: Rig) -> None:
    whole = stream(6)[4:6]  # no marker is missing
    wire_rig.send(whole[:1])
    first = wire_rig.source.read(2.0)
    assert first is not None
    bad = wire_rig.send_rubbish()
    wire_rig.send(whole[1:])
    frame = wire_rig.source.read(2.0)
    while frame is not None and np.isnan(frame.xyz).any():  # a part of the spoilt one
        frame = wire_rig.source.read(2.0)
    assert frame is not None
    np.testing.assert_allclose(frame.xyz, whole[1], atol=3e-4)
    counters = wire_rig.source.counters
    assert sum(count for name, count in counters.items() if name.startswith("bad_")) >= bad


def test_frames_cannot_be_changed_by_who_shares_them(rig: Rig) -> None:
    rig.send(stream(5)[4:])
    frame = rig.source.read(2.0)
    assert frame is not None
    with pytest.raises(dataclasses.FrozenInstanceError):
        frame.index = 3  # type: ignore[misc]


def test_closing_ends_iteration_and_twice_does_no_harm(rig: Rig) -> None:
    rig.send(stream(3))
    with rig.source as source:
        assert source.read(2.0) is not None
    source.close()
    assert source.exhausted
    remaining = [frame.index for frame in source]  # what had been received already, no more
    assert remaining == sorted(remaining)
    assert source.read(0.0) is None
