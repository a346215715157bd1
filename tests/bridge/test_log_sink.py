"""The black box as a sink: a session in, the same session out again."""

from __future__ import annotations

import hashlib
import resource
from pathlib import Path

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.pose import Pose
from bridge.session import Session
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext, SinkError
from bridge.truth import Truth
from drivers.c3d_file import C3dSource, Clip
from drivers.clock import VirtualClock
from drivers.frame import Floats, Layout, Source
from drivers.marker_set import MARKERS
from drivers.registry import open_source
from drivers.session_log import LineBytes, SessionLog
from drivers.transport import memory_line
from drivers.url import UrlError
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.osc_native import NativeOscDecoder, NativeOscEncoder
from drivers.wire_source import WireSource
from simulators.performer import load_performer
from tests.kept import Keep

MODEL = Model("default")
TRACKED = Layout(MODEL.info.tracked, 120.0)
ADDRESS = "serial:/dev/ttyUSB0"


def walk(count: int) -> Floats:
    """The embedded performer's first poses, (count, 41, 3), with some of them missing."""
    walker = load_performer("walk")
    poses = np.stack([walker.pose(index) for index in range(count)])
    poses[np.random.default_rng(0).random(poses.shape[:2]) < 0.1] = np.nan
    return poses


def handled(source: Source, log: Path, clock: VirtualClock, truth: Truth | None = None) -> Keep:
    """A session on virtual time, recorded."""
    keep = Keep()
    context = SinkContext(MODEL.info, truth.at if truth else lambda index: None)
    sinks = [open_sink(f"log:{log}", context), keep]
    session = Session(source, PoseEstimator(MODEL), sinks, context, truth=truth, clock=clock)
    while (frame := source.read(1.0)) is not None:
        session.handle(frame)
    session.close()
    return keep


def recorded(log: Path, count: int = 120) -> tuple[Keep, list[bytes], list[bytes]]:
    """A walk over a serial line with its truth over OSC: poses, and the bytes of both lines."""
    clock = VirtualClock(1000.0)
    (host, device), (truth_host, truth_device) = memory_line(clock), memory_line(clock)
    encoder, truth_encoder = CobsEncoder(), NativeOscEncoder()
    poses = walk(count)
    rows = [MARKERS.index(label) for label in TRACKED.labels]
    sent = [encoder.encode_layout(TRACKED)]
    truth_sent = [truth_encoder.encode_layout(Layout(MARKERS, 120.0))]
    source = WireSource(ADDRESS, lambda: host, CobsDecoder(), clock)
    truth = WireSource("osc://127.0.0.1:9", lambda: truth_host, NativeOscDecoder(), clock)
    for index, pose in enumerate(poses):
        sent.append(encoder.encode_frame(index, index / 120, pose[rows]))
        truth_sent.append(truth_encoder.encode_frame(index, index / 120, pose))
    for index, (data, clean) in enumerate(zip(sent, truth_sent, strict=True)):
        clock.call_at(1000.5 + index / 120, lambda data=clean: truth_device.send(data))
        clock.call_at(1000.5 + index / 120, lambda data=data: device.send(data))
    return handled(source, log, clock, Truth(truth, MODEL.info.labels)), sent, truth_sent


def assert_same(got: list[Pose], expected: list[Pose]) -> None:
    for one, two in zip(got, expected, strict=True):
        assert one.index == two.index
        for name in ("xyz", "provenance", "sigma"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_session_is_recorded_whole(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    keep, sent, truth_sent = recorded(path)
    log = SessionLog(path)
    assert log.sources == {"source": ADDRESS, "truth": "osc://127.0.0.1:9"}
    for name, expected in (("source", sent), ("truth", truth_sent)):
        lines = [line for line in log.lines(name) if isinstance(line, LineBytes)]
        assert [line.received.data for line in lines] == expected
        times = [line.received.t for line in lines]
        np.testing.assert_allclose(times, 1000.5 + np.arange(len(sent)) / 120, atol=1e-9)
    assert [frame.index for frame in log.frames()] == list(range(120))
    for got, pose in zip(log.poses(), keep.poses, strict=True):
        assert (got.index, got.layout) == (pose.index, Layout(MARKERS, 120.0))
        for part in ("xyz", "provenance", "sigma"):
            np.testing.assert_array_equal(getattr(got, part), getattr(pose, part))
    assert log.facts["model"] == MODEL.path.name
    assert log.facts["model_sha256"] == hashlib.sha256(MODEL.path.read_bytes()).hexdigest()


def test_a_replay_gives_the_same_poses_and_its_recording_the_same_bytes(tmp_path: Path) -> None:
    keep, sent, _ = recorded(tmp_path / "a.mcap")
    clock = VirtualClock(50.0)
    again = handled(open_source(f"log:{tmp_path / 'a.mcap'}", clock), tmp_path / "b.mcap", clock)
    assert_same(again.poses, keep.poses)
    np.testing.assert_allclose(
        np.diff([pose.t for pose in again.poses]), np.diff([p.t for p in keep.poses]), atol=1e-9
    )
    second = SessionLog(tmp_path / "b.mcap")
    assert second.sources == {"source": ADDRESS}
    lines = [line for line in second.lines("source") if isinstance(line, LineBytes)]
    assert [line.received.data for line in lines] == sent
    third = handled(
        open_source(f"log:{tmp_path / 'b.mcap'}?speed=max", clock), tmp_path / "c.mcap", clock
    )
    assert_same(third.poses, keep.poses)


def test_a_session_from_a_file_is_replayed_from_its_frames(tmp_path: Path) -> None:
    rows = [MARKERS.index(label) for label in TRACKED.labels]
    clock = VirtualClock(3.0)
    source = C3dSource("c3d:a.c3d", Clip(tmp_path, TRACKED, walk(60)[:, rows]), clock)
    keep = handled(source, tmp_path / "a.mcap", clock)
    assert len(keep.poses) == 60
    log = open_source(f"log:{tmp_path / 'a.mcap'}?speed=max", clock)
    assert_same(handled(log, tmp_path / "b.mcap", clock).poses, keep.poses)


def test_a_log_is_never_overwritten(tmp_path: Path, caplog) -> None:
    recorded(tmp_path / "a.mcap", 5)
    first = (tmp_path / "a.mcap").read_bytes()
    recorded(tmp_path / "a.mcap", 6)
    recorded(tmp_path / "a.mcap", 7)
    assert (tmp_path / "a.mcap").read_bytes() == first
    counts = [SessionLog(tmp_path / f"a{n}.mcap").holds["poses"] for n in ("", "-2", "-3")]
    assert counts == [5, 6, 7]
    assert caplog.messages[0] == (
        f"{tmp_path / 'a.mcap'} is there already: recording to {tmp_path / 'a-2.mcap'}"
    )


def test_a_session_that_never_began_leaves_no_log(tmp_path: Path) -> None:
    context = SinkContext(MODEL.info, lambda index: None)
    open_sink(f"log:{tmp_path / 'a.mcap'}", context).close()
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    context = SinkContext(MODEL.info, lambda index: None)
    with pytest.raises(SinkError, match=r"cannot write .*No such file or directory"):
        open_sink(f"log:{tmp_path / 'no' / 'a.mcap'}", context)
    for path in (tmp_path, "/", ".", "/dev/null"):
        with pytest.raises(SinkError, match="it is a folder, or no ordinary file"):
            open_sink(f"log:{path}", context)
    with pytest.raises(UrlError, match="unknown option rate"):
        open_sink(f"log:{tmp_path / 'a.mcap'}?rate=5", context)


def test_a_full_disk_is_said_once_and_the_session_goes_on(tmp_path: Path, caplog) -> None:
    path = tmp_path / "a.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(SinkError, match="File too large; what is in it can be read"):
            recorded(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.stat().st_size <= 20_000
    assert len([text for text in caplog.messages if "File too large" in text]) == 1
    count = SessionLog(path).holds["poses"]
    assert 5 < count < 120
    assert [pose.index for pose in SessionLog(path).poses()][:5] == list(range(5))
