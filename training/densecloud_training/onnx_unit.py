"""A unit as an ONNX graph, built node by node from its weights.

Building it by hand rather than tracing keeps the file the same whatever PyTorch wrote the weights, lets every shape
stay dynamic, and leaves out what a tracer adds. The graph is the fast form of `network.Unit`: all linear maps act on
flat [rows, channels] matrices, so that ONNX Runtime runs each as one Gemm with its bias (and ReLU) fused.

Contract of a file (f32 unless said):

- input `points` [B,N,3], each patch in its own frame; from unit 2 on also `previous_features` [M,264],
  `skip_indices` [B,N,5] int64 (rows of that table) and `skip_distances` [B,N,5] (squared, any unit of length a patch);
- output `dense` [B,2N,3]: the N points with code -0.2, then the N with +0.2; `features` [B,N,264] after the skip.
"""

from typing import Dict, List, Optional

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from . import network

OPSET = 17
IR_VERSION = 8


def build_unit(state: Dict[str, np.ndarray], unit: int, k: int = network.K) -> onnx.ModelProto:
    """The graph of unit `unit` (1-based) from the arrays of its state dict; checked before it is returned."""
    graph = _Graph(state)
    inputs = [_value("points", ["B", "N", 3])]
    if unit > 1:
        inputs.append(_value("previous_features", ["M", network.CHANNELS]))
        inputs.append(_value("skip_indices", ["B", "N", network.SKIP_NEIGHBOURS], TensorProto.INT64))
        inputs.append(_value("skip_distances", ["B", "N", network.SKIP_NEIGHBOURS]))
    _shapes(graph, k)
    features = _extract(graph, k)
    if unit > 1:
        features = _skip(graph, features)
    graph.node("Reshape", [features, graph.ints("to_features", [0, -1, network.CHANNELS], head="batch")], "features")
    _upsample(graph, features)
    outputs = [_value("dense", ["B", "2N", 3]), _value("features", ["B", "N", network.CHANNELS])]
    model = helper.make_model(
        helper.make_graph(graph.nodes, f"densecloud_unit{unit}", inputs, outputs, graph.initializers),
        producer_name="densecloud",
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
    )
    parameters = sum(int(np.prod(array.shape)) for array in state.values())
    metadata = {"unit": unit, "k": k, "channels": network.CHANNELS, "parameters": parameters}
    helper.set_model_props(model, {f"densecloud.{name}": str(value) for name, value in metadata.items()})
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and constants, with names handed out; every method returns the name of its result."""

    def __init__(self, state: Dict[str, np.ndarray]):
        self.state = {name: np.asarray(array, dtype=np.float32) for name, array in state.items()}
        self.nodes: List[onnx.NodeProto] = []
        self.initializers: List[onnx.TensorProto] = []
        self.constants: Dict[str, str] = {}

    def node(self, kind: str, inputs: List[str], output: Optional[str] = None, **attributes) -> str:
        output = output or f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def constant(self, name: str, value) -> str:
        if name not in self.constants:
            self.initializers.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
            self.constants[name] = name
        return name

    def floats(self, name: str, value) -> str:
        return self.constant(name, np.asarray(value, dtype=np.float32))

    def ints(self, name: str, values: List[int], head: Optional[str] = None) -> str:
        """An int64 vector; with `head`, a computed [1] tensor in place of its first entry."""
        if head is None:
            return self.constant(name, np.asarray(values, dtype=np.int64))
        tail = self.constant(f"{name}_tail", np.asarray(values[1:], dtype=np.int64))
        return self.node("Concat", [head, tail], f"{name}_{len(self.nodes)}", axis=0)

    def gemm(self, rows: str, name: str, weight: np.ndarray, bias: Optional[np.ndarray] = None, add: str = "") -> str:
        """rows [R,I] times weight [I,O], plus a bias [O] or the matrix `add` [R,O]."""
        inputs = [rows, self.floats(f"{name}.weight", weight)]
        if bias is not None:
            inputs.append(self.floats(f"{name}.bias", bias))
        elif add:
            inputs.append(add)
        return self.node("Gemm", inputs)

    def linear(self, rows: str, name: str) -> str:
        return self.gemm(rows, name, self.state[f"{name}.weight"].T, self.state[f"{name}.bias"])


def _value(name: str, shape: list, kind: int = TensorProto.FLOAT) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, shape)


def _shapes(graph: _Graph, k: int) -> None:
    """What depends on B and N alone: `batch` [1], `self_mask` [N,N], `row_offsets` [B,1,1], shared by all blocks."""
    one = graph.ints("one", [1])
    shape = graph.node("Shape", ["points"])
    batch = graph.node("Slice", [shape, graph.ints("i0", [0]), one], "batch")
    count = graph.node("Slice", [shape, one, graph.ints("i2", [2])], "count")
    axis = graph.constant("axis0", np.asarray(0, dtype=np.int64))
    step = graph.constant("step1", np.asarray(1, dtype=np.int64))
    scalar_count = graph.node("Squeeze", [count])
    row = graph.node("Range", [axis, scalar_count, step])
    same = graph.node("Equal", [graph.node("Unsqueeze", [row, one]), row])
    # A point is not its own neighbour: its own distance is lifted above all others.
    graph.node("Where", [same, graph.floats("far", 1e30), graph.floats("zero", 0.0)], "self_mask")
    items = graph.node("Range", [axis, graph.node("Squeeze", [batch]), step])
    offsets = graph.node("Mul", [items, scalar_count])
    graph.node("Reshape", [offsets, graph.ints("column3", [-1, 1, 1])], "row_offsets")
    graph.ints("k", [k])


def _extract(graph: _Graph, k: int) -> str:
    rows = graph.node("Reshape", ["points", graph.ints("rows3", [-1, 3])], "point_rows")
    features = graph.linear(rows, "lift")
    features = graph.node("Concat", [_edge_block(graph, features, 0, k), features], axis=1)
    for block in range(1, network.BLOCKS):
        squeezed = graph.node("Relu", [graph.linear(features, f"squeezes.{block - 1}")])
        features = graph.node("Concat", [_edge_block(graph, squeezed, block, k), features], axis=1)
    return features


def _edge_block(graph: _Graph, features: str, block: int, k: int) -> str:
    """[R,24] -> [R,60]; the split form of `edge.EdgeBlock.forward`."""
    name, g, c = f"blocks.{block}", network.GROWTH, network.BLOCK_CHANNELS
    first, second, third = (graph.state[f"{name}.{layer}.weight"] for layer in ("first", "second", "third"))
    biases = [graph.state[f"{name}.{layer}.bias"] for layer in ("first", "second", "third")]

    own_a = graph.gemm(features, f"{name}.own_a", (first[:, :c] - first[:, c:]).T, biases[0])
    own_b = graph.gemm(features, f"{name}.own_b", second[:, g:].T, biases[1])
    own_c = graph.gemm(features, f"{name}.own_c", third[:, 2 * g :].T, biases[2])
    other = graph.gemm(features, f"{name}.other", first[:, c:].T)

    edges = graph.ints("edges", [-1, k, g])
    edge_rows = graph.ints("edge_rows", [-1, g])
    per_point = graph.ints("per_point", [1])
    gathered = graph.node("Gather", [other, _neighbours(graph, features)], axis=0)
    gathered = graph.node("Reshape", [gathered, edges])
    a = graph.node("Relu", [graph.node("Add", [gathered, graph.node("Unsqueeze", [own_a, per_point])])])
    a_rows = graph.node("Reshape", [a, edge_rows])
    b = graph.node("Reshape", [graph.gemm(a_rows, f"{name}.b_from_a", second[:, :g].T), edges])
    b = graph.node("Relu", [graph.node("Add", [b, graph.node("Unsqueeze", [own_b, per_point])])])
    b_rows = graph.node("Reshape", [b, edge_rows])
    c_from_a = graph.gemm(a_rows, f"{name}.c_from_a", third[:, g : 2 * g].T)
    c_edges = graph.node("Reshape", [graph.gemm(b_rows, f"{name}.c_from_b", third[:, :g].T, add=c_from_a), edges])
    maxima = [graph.node("ReduceMax", [edge], axes=[1], keepdims=0) for edge in (c_edges, b, a)]
    return graph.node("Concat", [graph.node("Add", [maxima[0], own_c]), maxima[1], maxima[2], features], axis=1)


def _neighbours(graph: _Graph, features: str) -> str:
    """Row numbers [B,N,K] of each point's nearest others in feature space."""
    clouds = graph.node("Reshape", [features, graph.ints("to_clouds", [0, -1, network.BLOCK_CHANNELS], head="batch")])
    squares = graph.node("ReduceSumSquare", [clouds], axes=[2], keepdims=1)
    turned = graph.node("Transpose", [clouds], perm=[0, 2, 1])
    doubled = graph.node("Mul", [turned, graph.floats("minus_two", -2.0)])
    products = graph.node("MatMul", [clouds, doubled])
    masked = graph.node("Add", [graph.node("Transpose", [squares], perm=[0, 2, 1]), "self_mask"])
    distances = graph.node("Add", [products, masked])
    indices = f"neighbours_{len(graph.nodes)}"
    graph.nodes.append(
        helper.make_node("TopK", [distances, "k"], [f"{indices}_distances", indices], axis=2, largest=0, sorted=0)
    )
    return graph.node("Add", [indices, "row_offsets"])


def _skip(graph: _Graph, features: str) -> str:
    """The bilateral mean of the previous level's features; widths as in `network.relative`."""
    neighbours, channels = network.SKIP_NEIGHBOURS, network.CHANNELS
    per_patch = graph.ints("skip_shape", [0, -1, neighbours], head="batch")
    others = graph.node("Gather", ["previous_features", "skip_indices"], axis=0)
    others = graph.node("Reshape", [others, graph.ints("skip_rows", [-1, neighbours, channels])])
    difference = graph.node("Sub", [others, graph.node("Unsqueeze", [features, graph.ints("per_point", [1])])])
    featural = graph.node("ReduceSumSquare", [difference], axes=[2], keepdims=0)
    featural = _relative(graph, graph.node("Reshape", [featural, per_patch]))
    total = graph.node("Add", [_relative(graph, "skip_distances"), featural])
    weights = graph.node("Softmax", [graph.node("Mul", [total, graph.floats("minus_two", -2.0)])], axis=2)
    # The factor 0.2 goes into the few weights, not into the many features.
    weights = graph.node("Mul", [weights, graph.floats("skip_factor", network.SKIP_FACTOR)])
    weights = graph.node("Reshape", [weights, graph.ints("weight_rows", [-1, 1, neighbours])])
    mean = graph.node("MatMul", [weights, others])
    mean = graph.node("Reshape", [mean, graph.ints("feature_rows", [-1, channels])])
    return graph.node("Add", [features, mean])


def _relative(graph: _Graph, distances: str) -> str:
    smallest = graph.node("ReduceMin", [distances], axes=[2], keepdims=1)
    width = graph.node("ReduceMean", [smallest], axes=[1], keepdims=1)
    return graph.node("Div", [distances, graph.node("Max", [width, graph.floats("smallest_width", 1e-10)])])


def _upsample(graph: _Graph, features: str) -> None:
    first = graph.state["expand.0.weight"]
    copies = []
    for copy, code in enumerate(network.CODES):
        # Shared product, own bias: the code is a constant input, so its column is part of the bias.
        bias = graph.state["expand.0.bias"] + np.float32(code) * first[:, -1]
        copies.append(graph.floats(f"expand.0.bias_{copy}", bias))
    shared = graph.gemm(features, "expand.0", first[:, :-1].T)
    residuals = []
    for bias in copies:
        hidden = graph.node("Relu", [graph.node("Add", [shared, bias])])
        for layer in range(1, len(network.HIDDEN)):
            hidden = graph.node("Relu", [graph.linear(hidden, f"expand.{layer}")])
        residual = graph.linear(hidden, f"expand.{len(network.HIDDEN)}")
        moved = graph.node("Add", [residual, "point_rows"])
        residuals.append(graph.node("Reshape", [moved, graph.ints("to_points", [0, -1, 3], head="batch")]))
    graph.node("Concat", residuals, "dense", axis=1)
