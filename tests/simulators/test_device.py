from __future__ import annotations

import math
from threading import Event

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.frame import Layout
from drivers.transport import memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from drivers.wire_source import WireSource
from simulators.corruption import Corruption, Faults
from simulators.device import Device, Wire, truth_wire

LABELS = ("C7", "LSHO", "RSHO")
POSES = np.random.default_rng(0).normal(size=(600, 3, 3)).astype(np.float32)


def device_on(clock: VirtualClock, end, speed: float = 1.0, **more) -> Device:
    return Device(
        iter(POSES),
        [2, 0],
        Corruption(Faults(), 2),
        Wire(end, CobsEncoder(), Layout(("RSHO", "C7"), 120.0)),
        clock,
        speed=speed,
        **more,
    )


@pytest.mark.parametrize("speed", [1.0, 8.0])
def test_frames_come_at_their_times_with_the_chosen_markers(speed: float) -> None:
    clock = VirtualClock()
    host, end = memory_line(clock)
    source = WireSource("memory:", lambda: host, CobsDecoder(), clock)
    device = device_on(clock, end, speed)
    device.schedule(clock)
    frames = [source.read(1.0) for _ in range(len(POSES))]
    times = np.array([frame.t for frame in frames])
    np.testing.assert_allclose(times, np.arange(len(POSES)) / (120 * speed), atol=1e-9)
    np.testing.assert_allclose([f.t_device for f in frames], np.arange(600) / 120, atol=1e-6)
    np.testing.assert_array_equal([f.xyz for f in frames], POSES[:, [2, 0]])
    assert source.labels == ("RSHO", "C7")
    assert source.counters["layouts"] == math.ceil(5 / speed)  # the first answers the hello
    assert source.read(0.5) is None
    assert device.done


def test_a_serial_device_waits_for_its_host() -> None:
    clock = VirtualClock()
    host, end = memory_line(clock)
    device = device_on(clock, end)
    clock.call_at(7.25, lambda: host.send(CobsDecoder.hello))
    device.wait_for_host(Event())
    assert clock.now() == 7.25
    assert device.due == 7.25
    assert host.receive(0.0)  # the layout, at once


def test_the_truth_is_there_before_its_frame() -> None:
    clock = VirtualClock()
    (host, end), (truth_host, truth_end) = memory_line(clock), memory_line(clock)
    source = WireSource("memory:", lambda: host, CobsDecoder(), clock)
    truth = WireSource("truth:", lambda: truth_host, NativeOscDecoder(), clock)
    wire = truth_wire(truth_end, Layout(LABELS, 120.0))
    device_on(clock, end, truth=wire).schedule(clock)
    for index in range(200):
        frame, true = source.read(1.0), truth.read(0.0)
        assert frame.index == true.index == index
        np.testing.assert_array_equal(true.xyz, POSES[index])
    assert isinstance(wire.encoder, NativeOscEncoder)
