"""Several performers at a time: in one stream, in several, and where their poses go."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest

from bridge.cast import Cast
from bridge.estimator import PoseEstimator
from bridge.model import Model
from bridge.opening import open_stage
from bridge.pose import Pose, Provenance
from bridge.session import Session
from bridge.session_file import plan_session
from bridge.sinks.sink import Sink, SinkContext
from bridge.stage import Stage
from bridge.troubles import troubles
from drivers.c3d_file import C3dSource, Clip
from drivers.clock import SYSTEM_CLOCK, VirtualClock
from drivers.convention import Convention
from drivers.errors import UsageError
from drivers.frame import Floats, Layout, MarkerFrame, Source, SourceError
from drivers.performers import labels_of
from drivers.transport import memory_line
from drivers.wire.cobs import CobsDecoder, CobsEncoder
from drivers.wire.osc import messages
from drivers.wire_source import WireSource
from simulators.performer import Walker
from tests.end_to_end.peers import Receiver, free_port, listening, running, wait_for

MODEL = Model("default")
TRACKED = MODEL.info.tracked
RATE = 120.0
NAMES = ("ann", "bob", "cyd")


class Keep(Sink):
    waiting = None

    def __init__(self, name: str = "keep") -> None:
        self.name = name
        self.poses: list[Pose] = []

    def __call__(self, pose: Pose) -> None:
        self.poses.append(pose)

    def close(self) -> None: ...


@pytest.fixture(scope="module")
def walks() -> Floats:
    """(3, 90, T, 3): three who walk, each elsewhere and at another step, with gaps of their own."""
    walker = Walker(RATE)
    rows = [walker.layout.labels.index(label) for label in TRACKED]
    found = np.array(
        [[walker.pose(index + 40 * who)[rows] for index in range(90)] for who in range(3)]
    )
    found += np.arange(3)[:, None, None, None] * np.float32(0.7)
    found[0, 20:40, 2] = np.nan
    found[1, 30:60, [0, 4]] = np.nan
    found[2, 50:54] = np.nan
    return found.astype(np.float32)


def session(source: Source, name: str, *, clock=SYSTEM_CLOCK, shared: bool = False) -> Session:
    context = SinkContext(MODEL.info, lambda _index: None, performer=name)
    return Session(source, PoseEstimator(MODEL), [Keep()], context, clock=clock, shared=shared)


def kept(session: Session) -> list[Pose]:
    return session.outlets[0].sink.poses


@pytest.mark.parametrize("kind", ["default", "mixture_model"])
def test_one_stream_of_three_gives_the_poses_of_three_streams(walks, kind, request) -> None:
    """They are estimated together, and none of them knows of the others."""
    model = MODEL if kind == "default" else request.getfixturevalue(kind)
    if kind != "default":  # which tracks other markers
        walker = Walker(RATE)
        rows = [walker.layout.labels.index(label) for label in model.info.tracked]
        walks = np.array([[walker.pose(i + 40 * who)[rows] for i in range(40)] for who in range(3)])
    clock = VirtualClock()
    ours, device = memory_line(clock)
    source = WireSource("serial:all", lambda: ours, CobsDecoder(), clock)
    encoder = CobsEncoder()
    device.send(encoder.encode_layout(Layout(labels_of(model.info.tracked, NAMES), RATE)))
    sessions = {}
    for name in NAMES:
        context = SinkContext(model.info, lambda _index: None, performer=name)
        sessions[name] = Session(
            source, PoseEstimator(model), [Keep()], context, clock=clock, shared=True
        )
    stage = Stage([Cast(source, sessions, alone=False)], clock=clock)
    for index, places in enumerate(walks.transpose(1, 0, 2, 3)):
        device.send(encoder.encode_frame(index, index / RATE, places.reshape(-1, 3)))
        frame = source.read(0.1)
        assert frame is not None
        stage._put(stage.casts[0], frame)
        stage._take_oldest(stage.casts[0])
    alone = Layout(model.info.tracked, RATE)
    for who, name in enumerate(NAMES):
        estimator, poses = PoseEstimator(model), kept(sessions[name])
        assert len(poses) == walks.shape[1]
        for index, pose in enumerate(poses):
            frame = MarkerFrame(index, index / RATE, index / RATE, alone, walks[who, index])
            expected = estimator.step(frame)
            np.testing.assert_allclose(pose.xyz, expected.xyz, atol=1e-5)
            np.testing.assert_allclose(pose.sigma, expected.sigma, rtol=1e-3)
            np.testing.assert_array_equal(pose.provenance, expected.provenance)
            assert (pose.performer, pose.index) == (name, index)
    status = stage.status()
    assert status.frames == walks.shape[1]
    assert list(status.performers) == list(NAMES)
    assert set(status.markers) == set(labels_of(model.info.tracked, NAMES))
    assert status.imputed_samples == sum(one.imputed_samples for one in status.performers.values())
    assert status.source["frames"] == walks.shape[1]


def test_whoever_the_stream_lacks_is_told_and_so_are_others(walks, caplog) -> None:
    clip = Clip(
        Path(), Layout(labels_of(TRACKED, ("ann", "eve")), RATE), np.tile(walks[0], (1, 2, 1))
    )
    source = C3dSource("c3d:x", clip, SYSTEM_CLOCK, float("inf"))
    sessions = {name: session(source, name, shared=True) for name in ("ann", "bob")}
    stage = Stage([Cast(source, sessions, alone=False)])
    stage.run(threading.Event())
    stage.close()
    assert len(kept(sessions["ann"])) == 90
    assert kept(sessions["bob"]) == []
    assert "c3d:x: the stream has no markers of bob" in caplog.messages
    assert any("the stream has others' labels, too: eve" in text for text in caplog.messages)


def test_one_with_unknown_labels_does_not_end_it_for_the_others(walks, caplog) -> None:
    strange = tuple(f"bob:{number}" for number in range(len(TRACKED)))
    layout = Layout((*labels_of(TRACKED, ("ann",)), *strange), RATE)
    clip = Clip(Path(), layout, np.tile(walks[0], (1, 2, 1)))
    source = C3dSource("c3d:x", clip, SYSTEM_CLOCK, float("inf"))
    sessions = {name: session(source, name, shared=True) for name in ("ann", "bob")}
    stage = Stage([Cast(source, sessions, alone=False)])
    stage.run(threading.Event())
    stage.close()
    assert len(kept(sessions["ann"])) == 90
    assert (kept(sessions["bob"])[-1].provenance == Provenance.LOST).all()
    assert any("c3d:x: bob: none of the markers" in text for text in caplog.messages)


def test_names_of_another_program_are_mapped_for_each() -> None:
    convention = Convention(labels={"LeftHand": "LWRB"})
    layout = Layout(("ann:LeftHand", "bob:LeftHand", "bob:C7"), RATE)
    assert convention.layout_in(layout).labels == ("ann:LWRB", "bob:LWRB", "bob:C7")
    assert convention.lacking(layout) == []


def test_who_is_in_trouble_is_named(walks) -> None:
    """Ann's line is silent for seconds, and all is well with bob."""
    clock = VirtualClock()
    sources, casts = {}, []
    for who, name in enumerate(("ann", "bob")):
        ours, device = memory_line(clock)
        source = WireSource(f"serial:{name}", lambda end=ours: end, CobsDecoder(), clock)
        encoder = CobsEncoder()
        device.send(encoder.encode_layout(Layout(TRACKED, RATE)))
        sources[name] = source, device, encoder, walks[who]
        casts.append(Cast(source, {name: session(source, name, clock=clock)}, alone=True))
    stage = Stage(casts, clock=clock)
    for index in range(600):
        clock.sleep_until(index / RATE)
        for cast in casts:
            (name,) = cast.sessions
            source, device, encoder, walk = sources[name]
            if name == "bob" or index < 60:
                device.send(encoder.encode_frame(index, index / RATE, walk[index % 20]))
                stage._put(cast, source.read(0.0))
                stage._take_oldest(cast)
    (trouble,) = troubles(stage.status(), None)
    assert trouble.words.startswith("ann: no frame for 4 s")
    assert [name for name, _ in stage.by_source()] == ["serial:ann", "serial:bob"]
    assert [len(status.markers) for _, status in stage.by_source()] == [9, 9]


def test_several_sources_run_side_by_side_until_all_end(walks) -> None:
    casts = []
    for who, name in enumerate(NAMES):
        clip = Clip(Path(), Layout(TRACKED, RATE), walks[who, : 30 * (who + 1)])
        source = C3dSource(f"c3d:{name}", clip, SYSTEM_CLOCK, float("inf"))
        casts.append(Cast(source, {name: session(source, name)}, alone=True))
    stage = Stage(casts)
    stage.run(threading.Event())
    stage.close()
    for who, name in enumerate(NAMES):
        assert [pose.index for pose in kept(stage.sessions[name])] == list(range(30 * (who + 1)))
    assert stage.name == "c3d:ann c3d:bob c3d:cyd"
    assert stage.status().source["frames"] == 180


def test_when_one_source_fails_all_end_with_its_error(walks) -> None:
    class Failing(C3dSource):
        def _receive(self, timeout):
            if self.counters["frames"] == 5:
                raise SourceError("the port of bob is gone")
            return super()._receive(timeout)

    long = Clip(Path(), Layout(TRACKED, RATE), np.tile(walks[0], (50, 1, 1)))
    ann = C3dSource("c3d:ann", long, SYSTEM_CLOCK)
    bob = Failing("c3d:bob", long, SYSTEM_CLOCK, float("inf"))
    casts = [
        Cast(source, {name: session(source, name)}, alone=True)
        for source, name in ((ann, "ann"), (bob, "bob"))
    ]
    stage = Stage(casts)
    with pytest.raises(SourceError, match="the port of bob is gone"):
        stage.run(threading.Event())
    stage.close()
    assert len(kept(stage.sessions["bob"])) == 5


@pytest.mark.parametrize(
    ("source", "sinks", "message"),
    [
        (
            ["c3d:a", "c3d:b"],
            [],
            "'c3d:a': of several sources each says whose it is",
        ),
        (["c3d:a?performer=ann", "c3d:b?performer=ann"], [], "two sources are of performer ann"),
        ("osc:?performers=a,a", [], "option performers=a,a is wrong: a performer is named twice"),
        ("osc:?performer=a b", [], "option performer=a b is wrong: a name is letters"),
        ("osc:?performer=a&performers=b,c", [], "performer and performers: one of the two"),
        (
            "osc:?performers=a,b",
            ["vmc://127.0.0.1:9"],
            "is for one performer: write performer=NAME",
        ),
        ("osc:?performers=a,b", ["osc://127.0.0.1:9?performer=c"], "known are a, b"),
        ("osc:", ["osc://127.0.0.1:9?performer=c"], "known are none"),
        ([], [], "source: it is empty"),
        ("osc:?performers=a,b-2", [], "a name does not end with - and a number"),
        (
            "osc:?performers=a,b",
            ["vmc://127.0.0.1:9?performer=a", "vmc://127.0.0.1:9?performer=b"],
            "a goes there already: give each a port",
        ),
        (
            "osc:?performers=a,b",
            ["osc://127.0.0.1:9", "osc://127.0.0.1:9?performer=b"],
            "b goes there already: each address is taken once",
        ),
    ],
)
def test_performers_that_cannot_be_meant_are_refused(source, sinks, message) -> None:
    with pytest.raises(UsageError, match=message.replace("?", r"\?")):
        opened(source, sinks)


def opened(source: object, sinks: list[str]) -> None:
    plan = plan_session({"source": source, "sinks": sinks})
    with open_stage(plan, MODEL, threading.Event()):
        pass


def test_truth_is_for_one_alone() -> None:
    plan = plan_session({"source": "osc:?performers=a,b", "truth": "osc://127.0.0.1:0"})
    with pytest.raises(UsageError, match="truth is for a performer alone"):
        _ = plan.roles


def test_a_real_stream_of_two_goes_to_engines_and_files(tmp_path: Path) -> None:
    """One UDP stream, two who walk: one OSC port for both, a VMC port for bob, a file each."""
    port = free_port()
    with Receiver() as both, Receiver() as engine:
        sinks = [f"osc://127.0.0.1:{both.port}", f"vmc://127.0.0.1:{engine.port}?performer=bob"]
        to = [word for sink in [*sinks, "c3d:take.c3d"] for word in ("--to", sink)]
        here = f"osc://127.0.0.1:{port}"
        with running("run", f"{here}?performers=ann,bob", *to, "--json", cwd=tmp_path) as bridge:
            wait_for(lambda: listening(here), "the bridge")
            play = ("simulate", "performer:walk", "--performers", "ann,bob", "--to", here)
            with running(*play, "--seconds", "1") as tracker:
                assert tracker.end()[0] == 0
            wait_for(lambda: len(engine.datagrams) >= 110, "the poses")
            bridge.interrupt()
            status, out, _ = bridge.end()
    found = json.loads(out)
    assert status == 0
    assert found["frames"] >= 110
    assert {name: one["frames"] for name, one in found["performers"].items()} == {
        "ann": found["frames"],
        "bob": found["frames"],
    }
    assert f"bob to {sinks[1].partition('?')[0]}" in found["sinks"]
    addresses = {messages(datagram)[0].address for datagram in both.datagrams}
    assert addresses == {
        f"/markerbridge/{name}/{kind}" for name in ("ann", "bob") for kind in ("layout", "pose")
    }
    assert {path.name for path in tmp_path.iterdir()} == {"take-ann.c3d", "take-bob.c3d"}
