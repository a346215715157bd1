"""Networks compiled from a model file's constants, against its graph."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import numpy_helper

from bridge import onnx_file
from bridge.model import BoundNetworks, Model
from bridge.networks import CompiledNetworks

DEFAULT = Path(onnx_file.__file__).parent / "models" / "default.onnx"

# A session's whole way, not compiled: then numpy checks every index.
PLAIN = """
import numpy as np
from bridge.estimator import PoseEstimator
from bridge.humanoid.solver import HumanoidSolver
from bridge.model import Model
from bridge.sinks.registry import open_sink
from bridge.sinks.sink import SinkContext
from dataclasses import replace
from drivers.frame import Layout, MarkerFrame
from simulators.performer import Walker

model, walker = Model("default"), Walker(120.0)
layout = Layout(model.info.tracked, 120.0)
rows = [walker.layout.labels.index(label) for label in layout.labels]
estimator, solver = PoseEstimator(model), HumanoidSolver(model.info)
context = SinkContext(model.info, lambda _index: None)
uncertain = ("show", "fade", "hold", "hide")
sinks = [open_sink(f"vmc://127.0.0.1:9?uncertain={policy}", context) for policy in uncertain]
sinks.append(open_sink("vrchat://127.0.0.1:9", context))
for index in range(6):
    xyz = walker.pose(index)[rows]
    xyz[index % 5 :: 5] = np.nan if index > 1 else xyz[index % 5 :: 5]
    pose = estimator.step(MarkerFrame(index, index / 120, index / 120, layout, xyz))
    pose = replace(pose, posture=solver.solve(pose))
    for sink in sinks:
        sink(pose)
print(repr(pose.xyz.astype(float).round(5).tolist()))
print(repr(pose.posture.joints.astype(float).round(5).tolist()))
"""


@pytest.fixture(scope="module", params=["default", "network_model", "six_model"])
def model(request) -> Model:
    name = request.param
    return Model(name) if name == "default" else request.getfixturevalue(name)


def both(model: Model) -> tuple[CompiledNetworks, BoundNetworks]:
    compiled = model.networks(1)
    assert isinstance(compiled, CompiledNetworks)
    return compiled, BoundNetworks(model._session, model.info, 1)


@pytest.mark.parametrize("spread", [0.0, 0.1, 1.0, 10.0])
def test_they_say_what_the_graph_says(model, spread) -> None:
    compiled, graph = both(model)
    random = np.random.default_rng(4)
    for _ in range(20):
        shape = 2, 1, len(model.info.tracked), 3
        asked = (spread * random.standard_normal(shape)).astype(np.float32)
        for found, expected in zip(
            compiled.estimate(*asked)[0], graph.estimate(*asked)[0], strict=True
        ):
            np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-5 * max(1.0, spread))


@pytest.mark.parametrize("age", [1 / 120, 0.3, 2.9, 30.0, 1e6])
@pytest.mark.parametrize("spread", [0.1, 1.0])
def test_they_recall_what_the_graph_recalls(model, age, spread) -> None:
    compiled, _ = both(model)
    random, tracked = np.random.default_rng(4), len(model.info.tracked)
    for count in (1, 2, tracked):
        present = np.ones(tracked, bool)
        present[random.permutation(tracked)[:count]] = False
        xyz = (spread * random.standard_normal((tracked, 3))).astype(np.float32)
        xyz[~present] = np.nan  # as they come
        shape = 3, count, tracked, 3
        then, left, pace = (spread * random.standard_normal(shape)).astype(np.float32)
        ages = age * np.arange(1, count + 1)
        memory = [part.reshape(count, -1) for part in (then, left, pace, ages[:, None])]
        expected = model.recall(
            np.tile(np.nan_to_num(xyz).reshape(1, -1), (count, 1)),
            np.tile(present.astype(np.float32), (count, 1)),
            np.concatenate(memory, axis=1).astype(np.float32),
        )
        found = compiled.recall(xyz, present, then, left, pace, ages)
        for said, wanted in zip(found, expected, strict=True):
            np.testing.assert_allclose(said, wanted, rtol=2e-4, atol=2e-5)


def test_two_that_run_at_a_time_share_their_weights_and_nothing_else(model) -> None:
    one, other = model.networks(1), model.networks(1)
    still = np.zeros((1, len(model.info.tracked), 3), np.float32)
    first = one.estimate(still, still)[0]
    kept = [part.copy() for part in first]
    other.estimate(still + np.float32(0.3), still)
    for part, before in zip(first, kept, strict=True):
        np.testing.assert_array_equal(part, before)
    assert one.weights is other.weights


def renamed(graph: onnx.GraphProto) -> None:
    for node in graph.node:
        for attribute in node.attribute:
            renamed(attribute.g)
        for row, name in enumerate(node.input):
            node.input[row] = name.replace("pose_1_weights", "mine")
    for tensor in graph.initializer:
        tensor.name = tensor.name.replace("pose_1_weights", "mine")


def with_other_units(graph: onnx.GraphProto) -> None:
    for node in graph.node:
        if node.op_type == "Sigmoid":
            node.op_type = "Tanh"
        for attribute in node.attribute:
            with_other_units(attribute.g)


def with_another_shape(graph: onnx.GraphProto) -> None:
    for tensor in graph.initializer:
        if tensor.name == "unit":
            tensor.dims[:] = [1, 1]


@pytest.mark.parametrize("change", [renamed, with_other_units, with_another_shape])
def test_a_graph_of_another_form_is_run_as_it_is(change: Callable, tmp_path: Path) -> None:
    """What the file says counts, not what we take it for."""
    proto = onnx.load(DEFAULT)
    change(proto.graph)
    path = tmp_path / "other.onnx"
    onnx.save(proto, path)
    model = Model(path)
    networks = model.networks(1)
    assert isinstance(networks, BoundNetworks)
    asked = np.random.default_rng(1).standard_normal((2, 1, 9, 3)).astype(np.float32)
    with np.errstate(over="ignore"):
        expected = BoundNetworks(model._session, model.info, 1).estimate(*asked)[0]
        said = networks.estimate(*asked)[0]
    for found, wanted in zip(said, expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


def test_constants_are_those_that_the_onnx_library_reads(mixture_model) -> None:
    for path in (DEFAULT, mixture_model.path):
        found = onnx_file.constants(path)
        for tensor in onnx.load(path).graph.initializer:
            expected = numpy_helper.to_array(tensor)
            np.testing.assert_array_equal(found.pop(tensor.name), expected, strict=True)
        assert not found


@given(st.data())
def test_a_spoilt_file_gives_an_error_or_what_can_be_read(tmp_path_factory, data) -> None:
    content = bytearray(DEFAULT.read_bytes()[: data.draw(st.integers(0, 3000))])
    for _ in range(data.draw(st.integers(0, 4))):
        if content:
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "spoilt.onnx"
    path.write_bytes(content)
    with contextlib.suppress(ValueError):
        onnx_file.constants(path)


def test_a_number_without_an_end_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "endless.onnx"
    path.write_bytes(b"\xff" * 1_000_000)
    with pytest.raises(ValueError, match="longer than any"):
        onnx_file.constants(path)


def test_no_index_is_outside_of_its_array() -> None:
    """Compiled code does not look; the same in plain Python does, and says the same."""
    said = []
    for plain in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-P", "-W", "ignore", "-c", PLAIN],
            env=os.environ | {"NUMBA_DISABLE_JIT": plain},
            capture_output=True,
            text=True,
            timeout=100,
        )
        assert done.returncode == 0, done.stderr
        said.append([np.array(eval(line)) for line in done.stdout.splitlines()])
    for compiled, plain in zip(*said, strict=True):
        np.testing.assert_allclose(plain, compiled, atol=1e-4)
