"""Writes a trained model as one ONNX file (docs: bridge/model.py).

A mixture: p = the class weights of the forest, or one-hot of its vote; w = the sum of the history's
rows and p, normalised (paper 3.4.2); z = sum over leaves of w_k (B_k x + c_k).

Networks (`training.networks`): hidden layers of sigmoid-weighted units, each network beside its
linear prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from bridge.model import METADATA_KEY, ModelInfo
from drivers.frame import Floats
from drivers.marker_set import MARKERS
from training.forest import Forest
from training.network import Network
from training.networks import (
    AGE,
    COAST,
    FADE,
    FADES,
    FAR,
    MEMORIES,
    OLDEST,
    PACE,
    POSE,
    SLOW,
    STEP,
    UNIT,
    Networks,
)

_OPSETS = (("", 17), ("ai.onnx.ml", 3))
_IR_VERSION = 8  # the one of opset 17: readable by every onnxruntime that we allow

Constants = dict[str, npt.NDArray[np.generic]]
Shape = list[int | str]


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """What runs per frame. maps: (K, U, D), offsets: (K, U) metres; hard: the vote alone counts."""

    forest: Forest
    hard: bool
    maps: Floats
    offsets: Floats


def to_onnx(graph: Mixture | Networks, info: ModelInfo) -> bytes:
    """The model file. The same graph and info give the same bytes."""
    body = _mixture(graph) if isinstance(graph, Mixture) else _networks(graph)
    model = helper.make_model(
        body,
        opset_imports=[helper.make_opsetid(domain, version) for domain, version in _OPSETS],
        ir_version=_IR_VERSION,
        producer_name="markerbridge",
    )
    helper.set_model_props(model, {METADATA_KEY: info.to_json()})
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString(deterministic=True)
    return content


def _mixture(graph: Mixture) -> onnx.GraphProto:
    leaves, outputs, width = graph.maps.shape
    nodes = [
        _forest_node(graph.forest, "shares" if graph.hard else "p"),
        # With the current frame's row beneath it the history is never empty, even for h = 0.
        helper.make_node("Concat", ["history", "p"], ["recent"], axis=0),
        helper.make_node("ReduceSum", ["recent", "first_axis"], ["sums"], keepdims=1),
        helper.make_node("ReduceSum", ["sums", "last_axis"], ["total"], keepdims=1),
        helper.make_node("Div", ["sums", "total"], ["w"]),
        # All leaves' estimates first, then their mixture: one large product and one small one.
        helper.make_node("MatMul", ["x", "maps"], ["flat"]),
        helper.make_node("Reshape", ["flat", "by_leaf"], ["linear"]),
        helper.make_node("Add", ["linear", "offsets"], ["estimates"]),
        helper.make_node("MatMul", ["w", "estimates"], ["z"]),
    ]
    constants: Constants = {
        "first_axis": np.array([0], np.int64),
        "last_axis": np.array([1], np.int64),
        "maps": graph.maps.reshape(leaves * outputs, width).T.astype(np.float32),
        "by_leaf": np.array([leaves, outputs], np.int64),
        "offsets": graph.offsets.astype(np.float32),
    }
    if graph.hard:
        nodes[1:1] = [
            helper.make_node("ArgMax", ["shares"], ["vote"], axis=1, keepdims=0),
            helper.make_node("OneHot", ["vote", "leaves", "off_on"], ["p"]),
        ]
        constants["leaves"] = np.array([leaves], np.int64)
        constants["off_on"] = np.array([0, 1], np.float32)
    return _graph(
        nodes,
        constants,
        {"x": [1, width], "history": ["h", leaves]},
        {"z": [1, outputs], "p": [1, leaves]},
    )


def _networks(graph: Networks) -> onnx.GraphProto:
    """`If` all tracked markers are there, the whole pose and its velocities; else the markers that
    are missing.
    """
    width = len(graph.pose.mean)
    markers = width // 3
    branches = {
        name: helper.make_graph(nodes, name, [], [_value(name, ["n", outputs])])
        for name, nodes, outputs in (
            ("whole", _whole(graph), 2 * POSE + len(MARKERS)),
            ("lacking", _lacking(graph), width + markers),
        )
    }
    nodes = [
        helper.make_node("Sub", ["x", "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "unit"], ["u"]),
        helper.make_node("ReduceMin", ["present"], ["least"], keepdims=0),
        helper.make_node("Greater", ["least", "half"], ["all"]),
        helper.make_node(
            "If", ["all"], ["y"], then_branch=branches["whole"], else_branch=branches["lacking"]
        ),
    ]
    return _graph(
        nodes,
        _network_constants(graph),
        {
            "x": ["n", width],
            "v": ["n", width],
            "present": ["n", markers],
            "memory": ["n", 3 * width + 1],
        },
        {"y": ["n", "w"]},
    )


def _whole(graph: Networks) -> list[onnx.NodeProto]:
    """From u and v to the pose, the logarithms of sigma and the velocities, `whole`."""
    return [
        *_hidden(graph.pose.network, "u", "pose"),
        *_last("pose", "u"),
        # The body's speed, and velocities in it.
        helper.make_node("Mul", ["v", "v"], ["squares"]),
        helper.make_node("ReduceMean", ["squares"], ["square"], axes=[1], keepdims=1),
        helper.make_node("Add", ["square", "slow"], ["least_square"]),
        helper.make_node("Sqrt", ["least_square"], ["speed"]),
        helper.make_node("Div", ["v", "speed"], ["v_scaled"]),
        helper.make_node("Concat", ["u", "v_scaled"], ["moving"], axis=1),
        *_hidden(graph.velocity.network, "moving", "velocity"),
        *_last("velocity", "moving"),
        helper.make_node("Mul", ["velocity_outputs", "speed"], ["velocities"]),
        helper.make_node("Concat", ["pose_outputs", "velocities"], ["whole"], axis=1),
    ]


def _lacking(graph: Networks) -> list[onnx.NodeProto]:
    """From x, u and memory to the tracked markers and the logarithms of their sigma, `lacking`."""
    return [
        helper.make_node(
            "Split", ["memory", "memory_parts"], ["then", "left", "pace", "age"], axis=1
        ),
        helper.make_node("Gather", ["present", "rows"], ["there"], axis=1),
        helper.make_node("Sub", ["one", "there"], ["gone"]),
        helper.make_node("Mul", ["u", "there"], ["now_shown"]),
        helper.make_node("Sub", ["x", "then"], ["came"]),
        helper.make_node("Mul", ["came", "unit"], ["came_scaled"]),
        helper.make_node("Mul", ["came_scaled", "there"], ["came_shown"]),
        helper.make_node("Sub", ["then", "mean"], ["then_centred"]),
        helper.make_node("Mul", ["then_centred", "unit"], ["then_scaled"]),
        helper.make_node("Mul", ["then_scaled", "gone"], ["then_shown"]),
        helper.make_node("Sub", ["left", "then"], ["way"]),
        helper.make_node("Mul", ["way", "per_far"], ["way_far"]),
        helper.make_node("Mul", ["way_far", "way_far"], ["way_square"]),
        helper.make_node("Add", ["way_square", "one"], ["way_longer"]),
        helper.make_node("Sqrt", ["way_longer"], ["way_bound"]),
        helper.make_node("Div", ["way", "way_bound"], ["way_bounded"]),
        helper.make_node("Mul", ["way_bounded", "unit"], ["way_scaled"]),
        helper.make_node("Mul", ["way_scaled", "gone"], ["way_shown"]),
        helper.make_node("Mul", ["pace", "per_pace"], ["pace_scaled"]),
        helper.make_node("Mul", ["pace_scaled", "gone"], ["pace_shown"]),
        helper.make_node("Min", ["age", "oldest"], ["age_told"]),
        helper.make_node("Mul", ["age_told", "per_memory"], ["memory_exponents"]),
        helper.make_node("Exp", ["memory_exponents"], ["memories"]),
        helper.make_node("Mul", ["age_told", "per_age"], ["age_scaled"]),
        helper.make_node("Log", ["age_scaled"], ["age_logarithm"]),
        helper.make_node(
            "Concat",
            [
                *("now_shown", "came_shown", "then_shown", "way_shown"),
                *("pace_shown", "present", "memories", "age_logarithm"),
            ],
            ["recalled"],
            axis=1,
        ),
        *_hidden(graph.recall.network, "recalled", "recall"),
        helper.make_node("MatMul", ["recall_units", "recall_last_weights"], ["recall_product"]),
        helper.make_node("Add", ["recall_product", "recall_last_bias"], ["recall_outputs"]),
        helper.make_node(
            "Split", ["recall_outputs", "recall_parts"], ["added", "recall_sigma"], axis=1
        ),
        # What the linear prior adds, part by part as its fades come in.
        helper.make_node("MatMul", ["recalled", "prior_weights"], ["prior_product"]),
        helper.make_node("Add", ["prior_product", "prior_bias"], ["prior_flat"]),
        helper.make_node("Reshape", ["prior_flat", "by_fade"], ["prior_parts"]),
        helper.make_node("Mul", ["age", "per_fade"], ["fade_exponents"]),
        helper.make_node("Exp", ["fade_exponents"], ["fading"]),
        helper.make_node("Sub", ["one", "fading"], ["fading_in"]),
        helper.make_node("Mul", ["fading_in", "fading_in"], ["fading_square"]),
        helper.make_node("Mul", ["fading_square", "fading_in"], ["fades"]),
        helper.make_node("Unsqueeze", ["fades", "last_axis"], ["fade_columns"]),
        helper.make_node("Mul", ["prior_parts", "fade_columns"], ["prior_faded"]),
        helper.make_node("ReduceSum", ["prior_faded", "middle_axis"], ["prior"], keepdims=0),
        helper.make_node("Gather", ["fades", "own_fade"], ["own_share"], axis=1),
        helper.make_node("Mul", ["added", "own_share"], ["added_faded"]),
        helper.make_node("Mul", ["age", "per_coast"], ["coasted"]),
        helper.make_node("Mul", ["coasted", "coasted"], ["coasted_square"]),
        helper.make_node("Mul", ["coasted_square", "coasted_square"], ["coasted_fourth"]),
        helper.make_node("Add", ["coasted_fourth", "one"], ["slowing"]),
        helper.make_node("Mul", ["pace", "age"], ["ran"]),
        helper.make_node("Add", ["way", "ran"], ["went"]),
        helper.make_node("Div", ["went", "slowing"], ["went_on"]),
        helper.make_node("Add", ["then", "went_on"], ["gone_on"]),
        helper.make_node("Add", ["gone_on", "prior"], ["expected"]),
        helper.make_node("Add", ["expected", "added_faded"], ["recalled_markers"]),
        helper.make_node("Concat", ["recalled_markers", "recall_sigma"], ["lacking"], axis=1),
    ]


def _network_constants(graph: Networks) -> Constants:
    width = len(graph.pose.mean)
    markers = width // 3
    last_weights, last_bias = graph.recall.network.weights[-2:]
    scale = np.ones(len(last_bias), np.float32)
    scale[:width] = STEP
    maps = graph.recall.prior.reshape(len(FADES), -1, width)  # by fade, input and output
    constants: Constants = {
        "mean": graph.pose.mean,
        "unit": _numbers(1.0 / UNIT),
        "rows": np.repeat(np.arange(markers), 3),
        "half": np.array(0.5, np.float32),
        "one": _numbers(1.0),
        "slow": _numbers(SLOW**2),
        "memory_parts": np.array([width, width, width, 1]),
        "per_far": _numbers(1.0 / FAR),
        "per_pace": _numbers(1.0 / PACE),
        "oldest": _numbers(OLDEST),
        "per_memory": _numbers(*(-1.0 / memory for memory in MEMORIES)),
        "per_age": _numbers(1.0 / AGE),
        "recall_parts": np.array([width, markers]),
        "recall_last_weights": last_weights * scale,
        "recall_last_bias": last_bias * scale,
        "prior_weights": maps[:, :-1].transpose(1, 0, 2).reshape(-1, len(FADES) * width),
        "prior_bias": maps[:, -1].ravel(),
        "by_fade": np.array([0, len(FADES), width]),
        "per_fade": _numbers(*(-1.0 / fade for fade in FADES)),
        "last_axis": np.array([2]),
        "middle_axis": np.array([1]),
        "own_fade": np.array([FADE]),
        "per_coast": _numbers(1.0 / COAST),
    }
    for name, last in (("pose", graph.pose), ("velocity", graph.velocity)):
        constants[f"{name}_last_weights"], constants[f"{name}_last_bias"] = last.last_layer()
    for name, network in (
        ("pose", graph.pose.network),
        ("velocity", graph.velocity.network),
        ("recall", graph.recall.network),
    ):
        for layer, (weights, bias) in enumerate(network.layers):
            constants[f"{name}_{layer}_weights"] = weights
            constants[f"{name}_{layer}_bias"] = bias
    return constants


def _hidden(network: Network, inputs: str, name: str) -> list[onnx.NodeProto]:
    """From the inputs to the last hidden units of a network, `NAME_units`."""
    nodes: list[onnx.NodeProto] = []
    before, count = inputs, len(network.layers)
    for layer in range(count):
        at = f"{name}_{layer}"
        units = f"{name}_units" if layer == count - 1 else f"{at}_units"
        nodes += [
            helper.make_node("MatMul", [before, f"{at}_weights"], [f"{at}_product"]),
            helper.make_node("Add", [f"{at}_product", f"{at}_bias"], [f"{at}_sum"]),
            helper.make_node("Sigmoid", [f"{at}_sum"], [f"{at}_gate"]),
            helper.make_node("Mul", [f"{at}_sum", f"{at}_gate"], [units]),
        ]
        before = units
    return nodes


def _last(name: str, inputs: str) -> list[onnx.NodeProto]:
    """The linear layer on the last hidden units and the inputs, which holds the prior."""
    return [
        helper.make_node("Concat", [f"{name}_units", inputs], [f"{name}_last"], axis=1),
        helper.make_node("MatMul", [f"{name}_last", f"{name}_last_weights"], [f"{name}_product"]),
        helper.make_node("Add", [f"{name}_product", f"{name}_last_bias"], [f"{name}_outputs"]),
    ]


def _numbers(*values: float) -> Floats:
    return np.array(values, np.float32)


def _graph(
    nodes: Sequence[onnx.NodeProto],
    constants: Constants,
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
) -> onnx.GraphProto:
    return helper.make_graph(
        nodes,
        "markerbridge",
        [_value(name, shape) for name, shape in inputs.items()],
        [_value(name, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(np.ascontiguousarray(v), k) for k, v in constants.items()],
    )


def _forest_node(forest: Forest, output: str) -> onnx.NodeProto:
    is_leaf = forest.feature < 0
    return helper.make_node(
        "TreeEnsembleRegressor",
        ["x"],
        [output],
        domain="ai.onnx.ml",
        aggregate_function="SUM",
        post_transform="NONE",
        n_targets=forest.classes,
        nodes_treeids=forest.tree.tolist(),
        nodes_nodeids=forest.node.tolist(),
        nodes_modes=["LEAF" if leaf else "BRANCH_LEQ" for leaf in is_leaf],
        nodes_featureids=np.maximum(forest.feature, 0).tolist(),
        nodes_values=forest.threshold.tolist(),
        nodes_truenodeids=forest.left.tolist(),
        nodes_falsenodeids=forest.right.tolist(),
        target_treeids=forest.entry_tree.tolist(),
        target_nodeids=forest.entry_node.tolist(),
        target_ids=forest.entry_class.tolist(),
        target_weights=forest.entry_weight.tolist(),
    )


def _value(name: str, shape: Shape) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
