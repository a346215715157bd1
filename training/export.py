"""Writes a trained model as one ONNX file: forest, mixture and linear maps (docs: bridge/model.py).

p = the class weights of the forest, or one-hot of its vote; w = the sum of the history's rows and
p, normalised (paper 3.4.2); z = sum over leaves of w_k (B_k x + c_k).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from bridge.model import METADATA_KEY, ModelInfo
from drivers.frame import Floats
from training.forest import Forest

_OPSETS = (("", 17), ("ai.onnx.ml", 3))
_IR_VERSION = 8  # the one of opset 17: readable by every onnxruntime that we allow


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """What runs per frame. maps: (K, U, D), offsets: (K, U) metres; hard: the vote alone counts."""

    forest: Forest
    hard: bool
    maps: Floats
    offsets: Floats


def to_onnx(graph: Graph, info: ModelInfo) -> bytes:
    """The model file. The same graph and info give the same bytes."""
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
    constants = {
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
    body = helper.make_graph(
        nodes,
        "markerbridge",
        [_value("x", [1, width]), _value("history", ["h", leaves])],
        [_value("z", [1, outputs]), _value("p", [1, leaves])],
        [numpy_helper.from_array(np.ascontiguousarray(v), k) for k, v in constants.items()],
    )
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


def _value(name: str, shape: list[int | str]) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
