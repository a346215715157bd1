"""What the benchmarks make of what they measure: which packet is answered, what is met or lost.

The figures themselves are not tested; `python -m tests.benchmarks` tells them.
"""

from __future__ import annotations

import json
import math
import socket
from dataclasses import replace

import numpy as np
import pytest

from bridge.estimator import PoseEstimator
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import DEFAULT, Model
from bridge.sinks.pose_message import PoseMessages
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext
from drivers.frame import Layout, MarkerFrame
from drivers.wire.osc_native import NativeOscDecoder
from simulators.corruption import Faults, Gaps
from simulators.performer import load_performer
from simulators.several import APART
from tests.benchmarks.crowd import SHIFTED, stream_of
from tests.benchmarks.datagrams import HEAD, answered, has_pose, number_of
from tests.benchmarks.highest_rate import what_is_wrong
from tests.benchmarks.rig import NOTHING, Passage, measure, pace, walking
from tests.benchmarks.table import Goal, Row, as_json

RATE = 120.0
NAN = math.nan


@pytest.mark.parametrize("scheme", ["vmc", "osc"])
def test_a_datagram_tells_its_frame(scheme: str) -> None:
    model, walker = Model(DEFAULT), load_performer("walk")
    estimator, solver = PoseEstimator(model), HumanoidSolver(model.info)
    layout = Layout(walker.layout.labels, RATE)
    numbers, shown = [], []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as engine:
        engine.bind(("127.0.0.1", 0))
        context = SinkContext(model.info, lambda index: None)
        sink = open_sink(f"{scheme}://127.0.0.1:{engine.getsockname()[1]}", context)
        for index in (0, 1, 2, 5, 7):
            t = 1000 + index / RATE
            pose = estimator.step(MarkerFrame(index, t, t, layout, walker.pose(index), t))
            sink(replace(pose, posture=solver.solve(pose)))
        sink(replace(pose.lost(pose.t), posture=None))
        sink.close()
        engine.setblocking(False)
        for _ in range(6 + (scheme == "osc")):  # with a layout
            head = engine.recv(65_536)[:HEAD]
            numbers.append(number_of(head, RATE))
            shown.append(has_pose(head))
    if scheme == "osc":
        assert numbers == [None, 0, 1, 2, 5, 7, 7]
    else:
        np.testing.assert_allclose(np.array(numbers, float), [0, 1, 2, 5, 7, 7], atol=0.01)
        assert shown == [True] * 5 + [False]


def test_other_datagrams_tell_none() -> None:
    assert number_of(b"/something/else\0,\0\0\0", RATE) is None
    assert not has_pose(b"")


def test_a_datagram_of_one_of_several_tells_its_frame_too() -> None:
    model, walker = Model(DEFAULT), load_performer("walk")
    frame = MarkerFrame(5, 0.0, 0.0, walker.layout, walker.pose(0), 0.0)
    pose = PoseEstimator(model).step(frame)
    messages = PoseMessages(Layout(model.info.labels, RATE), 1.0, "ann")
    assert number_of(messages.pose(pose, 0.0, pose.xyz)[:HEAD], RATE) == 5
    assert number_of(messages.layout(RATE)[:HEAD], RATE) is None


def rows(numbers: list[float], came: list[float], written: list[float]) -> list[int]:
    return list(answered(numbers, np.array(came), np.array(written)))


def test_datagrams_answer_their_packets() -> None:
    written = [0.0, 1.0, 2.0, 3.0, 4.0]
    assert rows([0, 1, 2, 3, 4], [0.1, 1.1, 2.1, 3.1, 4.1], written) == [0, 1, 2, 3, 4]
    late = [2.5, 2.5, 3.5, 3.6, 6.0]
    assert rows([0, 1, 2, 3, 4], late, written) == [0, 1, 2, 3, 4]
    assert rows([0, 1, 4], [0.1, 1.1, 4.1], written) == [0, 1, 4]  # two were lost
    assert rows([2, 3, 4], [2.1, 3.1, 4.1], written) == [2, 3, 4]  # the first ones were
    assert rows([], [], written) == []


def test_a_packet_that_never_went_out_has_no_answer() -> None:
    written = [0.0, NAN, 2.0, 3.0]
    assert rows([0, 2, 3], [0.1, 2.1, 3.1], written) == [0, 2, 3]
    assert rows([0, 3], [0.1, 3.1], written) == [0, 3]


def test_seconds_that_are_out_by_a_little_are_put_right() -> None:
    """A host's clock is mapped from the device's, and better as time goes by."""
    written = list(np.arange(6.0))
    assert rows([0, 0.3, 1.2, 2.2, 4.3], [0.1, 1.1, 2.1, 3.1, 5.1], written) == [0, 1, 2, 3, 5]
    assert rows([0, 1, 2.9, 4], [0.1, 1.1, 2.1, 3.1], written) == [0, 1, 2, 3]  # none before it was


def test_what_is_met() -> None:
    low, high = Goal(1.0, 2.0), Goal(5.0, 2.0, higher=True)
    assert [Row("", x, "s", goal=low).met for x in (1.0, 1.5, 2.1, NAN)] == [
        *("target", "floor", "missed", "missed")
    ]
    assert [Row("", x, "/s", goal=high).met for x in (5.0, 2.0, 1.9)] == [
        "target",
        "floor",
        "missed",
    ]
    ratio = replace(high, of_ratio=True)
    assert Row("", 1.0, "s", 3.0, goal=ratio).met == "floor"
    assert Row("", 1.0, "s", goal=ratio).met == "missed"
    assert Row("", 1.0, "s").met == ""


def test_a_row_is_read_by_people_and_machines() -> None:
    ratio = Goal(80.0, 40.0, of_ratio=True, higher=True)
    row = Row("a step", 51.234, "µs", 46.71, "faster", ratio, "warm")
    assert str(row) == "| a step (warm) | 51.2 µs | 46.7 × faster | 80 × | 40 × | floor |"
    assert str(Row("b", 12_345.6, "/s")) == "| b | 12,346 /s |  |  |  |  |"
    told = json.loads(json.dumps(as_json({"part": [row, Row("b", NAN, "s")]}), allow_nan=False))
    assert told["part"][0] == {
        "what": "a step",
        "measured": 51.234,
        "unit": "µs",
        "ratio": 46.71,
        "against": "faster",
        "goal": {"target": 80.0, "floor": 40.0, "of_ratio": True, "higher": True},
        "note": "warm",
        "met": "floor",
    }
    assert told["part"][1]["measured"] is None


def test_a_loss_anywhere_is_told() -> None:
    sink = {"dropped": 0, "rate_limited": 0, "errors": 0}
    report = {"source": {"missing": 0, "fifo_overflow": 0}, "sinks": {"vmc": sink}}
    well = Passage(RATE, 500, 0, 0, np.full(400, 0.001), 0.1, 1.0, 1.0, 100, report)
    assert what_is_wrong(well, RATE) == ""
    assert what_is_wrong(replace(well, lost=3), RATE) == "3 never answered"
    assert what_is_wrong(replace(well, refused=1), RATE) == "1 that the line had no room for"
    source = {"missing": 2, "fifo_overflow": 7}
    lossy = {"source": source, "sinks": {"vmc": sink | {"dropped": 4}}}
    assert (
        what_is_wrong(replace(well, report=lossy), RATE)
        == "2 missing, 7 fifo_overflow, 4 poses dropped"
    )
    behind = np.linspace(0.001, 0.5, 400)
    assert "ms late in the end" in what_is_wrong(replace(well, ages=behind), RATE)


def test_a_tracker_that_is_slow_itself_proves_nothing() -> None:
    report = {"source": {}, "sinks": {}}
    slow = Passage(900.0, 500, 0, 0, np.full(400, 0.001), 0.1, 1.0, 1.0, 100, report)
    assert what_is_wrong(slow, 1000.0) == "900/s was all that the tracker sent"
    assert pace(np.array([0.0, NAN, 1.0, 1.5])) == 2.0


def test_a_tracker_of_several_sends_each_under_their_name() -> None:
    labels, names = ("C7", "LSHO", "RSHO"), ("ann", "bob")
    decoder = NativeOscDecoder()
    made = stream_of(names, labels, RATE, 2.0, Faults(gaps=Gaps(0.1, 10, 100)))
    decoder.feed(made.layout, 0.0)
    xyz = np.array([decoder.feed(packet, 0.0)[0].xyz for packet in made.packets])
    assert decoder.layout is not None
    assert decoder.layout.labels == ("ann:C7", "ann:LSHO", "ann:RSHO", *decoder.layout.labels[3:])
    assert decoder.layout.labels[3:] == ("bob:C7", "bob:LSHO", "bob:RSHO")
    ann, bob = np.isnan(xyz[:, :, 0]).reshape(-1, 2, 3).transpose(1, 0, 2)
    assert 0.0 < ann.mean() < 0.4
    assert (ann != bob).any()  # gaps of their own
    both = ~(ann[SHIFTED:, 0] | bob[:-SHIFTED, 0])
    apart = xyz[:-SHIFTED, 3] - xyz[SHIFTED:, 0]  # where ann comes to, but beside
    np.testing.assert_allclose(apart[both], np.tile([0.0, APART, 0.0], (both.sum(), 1)), atol=1e-5)


def test_the_rig_counts_every_frame_of_the_bridge_that_does_nothing() -> None:
    made = walking(("C7", "LSHO", "RSHO"), 1000.0, 0.2)
    passage = measure([*NOTHING, "500", str(made.frame)], made)
    assert (passage.sent, passage.lost, passage.datagram) == (200, 0, 500)
