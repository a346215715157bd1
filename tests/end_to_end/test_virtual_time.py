"""The same chain in one process on virtual time: nothing waits, a seed is a run."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose, Provenance
from bridge.session import Session
from bridge.sinks.sink import SinkContext
from bridge.truth import Truth
from drivers.c3d_file import read_c3d
from drivers.clock import VirtualClock
from drivers.frame import Layout
from drivers.transport import MemoryTransport, memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from drivers.wire_source import WireSource
from simulators.corruption import Corruption, Faults, Gaps
from simulators.device import Device, Wire, truth_wire
from tests.kept import Keep

WIRES = {"serial": (CobsEncoder, CobsDecoder), "osc": (NativeOscEncoder, NativeOscDecoder)}


class Tap:
    """A line's end that remembers a digest of all that was sent through it."""

    def __init__(self, end: MemoryTransport) -> None:
        self._end = end
        self.receive, self.close = end.receive, end.close
        self.digest = hashlib.sha256()

    def send(self, data: bytes) -> None:
        self.digest.update(data)
        self._end.send(data)


def play(
    clip_path: Path, wire: str, faults: Faults, seed: int = 0
) -> tuple[list[Pose], Session, str]:
    """A capture through the real codecs and drivers; poses, session, digest of the bytes."""
    model = Model("default")
    clip = read_c3d(clip_path)
    clock = VirtualClock(100.0)
    (host, device_end), (truth_host, truth_end) = memory_line(clock), memory_line(clock)
    encoder, decoder = WIRES[wire]
    tap = Tap(device_end)
    labels = model.info.tracked
    rows = [clip.layout.labels.index(label) for label in labels]
    source = WireSource("memory:", lambda: host, decoder(), clock)
    truth_source = WireSource("truth:", lambda: truth_host, NativeOscDecoder(), clock)
    device = Device(
        iter(clip.xyz),
        rows,
        Corruption(faults, len(labels), seed),
        Wire(tap, encoder(), Layout(labels, clip.layout.rate)),
        clock,
        truth=truth_wire(truth_end, clip.layout),
    )
    device.schedule(clock)
    truth = Truth(truth_source, model.info.labels)
    keep = Keep()
    context = SinkContext(model.info, truth.at)
    session = Session(source, PoseEstimator(model), [keep], context, truth=truth, clock=clock)
    while (frame := source.read(1.0)) is not None:
        session.handle(frame)
    assert device.done
    assert device.sent == len(clip.xyz)
    return keep.poses, session, tap.digest.hexdigest()


@pytest.mark.parametrize("wire", WIRES)
def test_every_frame_comes_out_and_the_meter_sees_the_truth(data_dir: Path, wire: str) -> None:
    path = data_dir / "real/16_57.c3d"
    poses, session, _ = play(path, wire, Faults())
    truth = read_c3d(path).xyz
    assert [pose.index for pose in poses] == list(range(len(truth)))
    np.testing.assert_allclose(np.diff([pose.t for pose in poses]), 1 / 120, atol=1e-9)
    status = session.status()
    assert status.rms_mm is not None
    by_hand = [
        1000 * np.sqrt(np.nanmean(((pose.xyz - true) ** 2).sum(axis=1)))
        for pose, true in zip(poses, truth, strict=True)
    ]
    assert status.rms_mm == pytest.approx(np.mean(by_hand), rel=1e-4)
    assert status.ages["estimate"].max == 0.0


def test_the_same_seed_is_the_same_run_and_another_is_not(data_dir: Path) -> None:
    path = data_dir / "real/16_57.c3d"
    faults = Faults(noise=0.001, drop=0.05, gaps=Gaps(0.2, 10, 100))
    first, _, bytes_first = play(path, "serial", faults, seed=3)
    again, _, bytes_again = play(path, "serial", faults, seed=3)
    _, _, bytes_other = play(path, "serial", faults, seed=4)
    assert bytes_first == bytes_again != bytes_other
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.xyz, two.xyz)


def test_a_minute_with_faults_takes_less_than_its_time_and_stays_whole(data_dir: Path) -> None:
    faults = Faults(noise=0.001, drop=0.05, gaps=Gaps(0.2, 10, 100))
    began = time.monotonic()
    poses, session, _ = play(data_dir / "real/135_02.c3d", "serial", faults)
    assert len(poses) == 5202  # 43 s
    assert time.monotonic() - began < 43
    imputed = sum(int((pose.provenance == Provenance.IMPUTED).sum()) for pose in poses)
    assert 0.15 < imputed / (9 * len(poses)) < 0.35
    assert session.status().imputed_samples == imputed
    for pose in poses:
        assert np.isfinite(pose.xyz).all()
        assert np.isfinite(pose.sigma).all()


def test_truth_never_reaches_the_estimator(data_dir: Path) -> None:
    """The poses are the same with the truth on its line as they are without it."""
    path = data_dir / "real/02_03.c3d"
    with_truth, _, _ = play(path, "serial", Faults())
    model = Model("default")
    clip = read_c3d(path, model.info.tracked)
    estimator = PoseEstimator(model)
    from drivers.c3d_file import C3dSource

    for frame, pose in zip(C3dSource("c", clip, VirtualClock()), with_truth, strict=True):
        np.testing.assert_allclose(estimator.step(frame).xyz, pose.xyz, atol=1e-5)
