"""Writes a trained model as one ONNX file (docs: bridge/model.py).

A mixture: p = the class weights of the forest, or one-hot of its vote; w = the sum of the history's
rows and p, normalised (paper 3.4.2); z = sum over leaves of w_k (B_k x + c_k).

Networks, one for frames with all tracked markers and one for others: hidden layers of
sigmoid-weighted units; one linear layer on those of all members and on the inputs, which is the
linear prior; sigma is the exponential of its last outputs.
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
from training.forest import Forest
from training.regressor import POSE, UNIT, Networks, Regressor

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
    """`If` all tracked markers are there, one network runs, else the other."""
    width, markers = len(graph.whole.mean), graph.whole.markers
    constants: Constants = {
        "mean": graph.whole.mean,
        "unit": np.array([1.0 / UNIT], np.float32),
        "rows": graph.whole.rows.astype(np.int64),
        "half": np.array(0.5, np.float32),
        "parts": np.array([POSE, POSE // 3], np.int64),
    }
    branches = {}
    for name, network in (("whole", graph.whole), ("part", graph.part)):
        nodes, own = _network(network, name)
        constants |= own
        outputs = [_value(f"{name}_outputs", ["n", POSE + POSE // 3])]
        branches[name] = helper.make_graph(nodes, name, [], outputs)
    nodes = [
        helper.make_node("Sub", ["x", "mean"], ["centred"]),
        helper.make_node("Mul", ["centred", "unit"], ["scaled"]),
        helper.make_node("Gather", ["present", "rows"], ["there"], axis=1),
        helper.make_node("Mul", ["scaled", "there"], ["shown"]),
        helper.make_node("Concat", ["shown", "present"], ["u"], axis=1),
        helper.make_node("ReduceMin", ["present"], ["least"], keepdims=0),
        helper.make_node("Greater", ["least", "half"], ["all"]),
        helper.make_node(
            "If",
            ["all"],
            ["outputs"],
            then_branch=branches["whole"],
            else_branch=branches["part"],
        ),
        helper.make_node("Split", ["outputs", "parts"], ["z", "log_sigma"], axis=1),
        helper.make_node("Exp", ["log_sigma"], ["sigma"]),
    ]
    return _graph(
        nodes,
        constants,
        {"x": ["n", width], "present": ["n", markers]},
        {"z": ["n", POSE], "sigma": ["n", POSE // 3]},
    )


def _network(graph: Regressor, name: str) -> tuple[list[onnx.NodeProto], Constants]:
    """From u to the outputs of one network; all names begin with its own."""
    nodes: list[onnx.NodeProto] = []
    constants: Constants = {}
    ends = []
    for number, member in enumerate(graph.members):
        before = "u"
        for layer, weights in enumerate(member.layers):
            at = f"{name}_{number}_{layer}"
            constants[f"{at}_weights"], constants[f"{at}_bias"] = weights
            nodes += [
                helper.make_node("MatMul", [before, f"{at}_weights"], [f"{at}_product"]),
                helper.make_node("Add", [f"{at}_product", f"{at}_bias"], [f"{at}_sum"]),
                helper.make_node("Sigmoid", [f"{at}_sum"], [f"{at}_gate"]),
                helper.make_node("Mul", [f"{at}_sum", f"{at}_gate"], [f"{at}_units"]),
            ]
            before = f"{at}_units"
        ends.append(before)
    constants[f"{name}_last_weights"], constants[f"{name}_last_bias"] = graph.last_layer()
    nodes += [
        helper.make_node("Concat", [*ends, "u"], [f"{name}_last"], axis=1),
        helper.make_node("MatMul", [f"{name}_last", f"{name}_last_weights"], [f"{name}_product"]),
        helper.make_node("Add", [f"{name}_product", f"{name}_last_bias"], [f"{name}_outputs"]),
    ]
    return nodes, constants


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
