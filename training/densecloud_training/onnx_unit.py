"""A unit as an ONNX graph, built node by node from its weights.

Building it by hand rather than tracing keeps the file the same whatever PyTorch wrote the weights, lets every shape
stay dynamic, and leaves out what a tracer adds. The graph is the fast form of `network.Unit`: all linear maps act on
flat [rows, channels] matrices, so that ONNX Runtime runs each as one Gemm with its bias (and ReLU) fused.

What costs most, the neighbour search, the edge block and the skip, are operators of the domain `densecloud`, whose
bodies the file carries as functions of standard operators. Any ONNX runtime can run it so; the program registers faster
kernels of the same names and takes those.

Contract of a file (f32 unless said):

- input `points` [B,N,3], each patch in its own frame; from unit 2 on also `previous_features` [M,264] (float16, as a
  cloud's table is large), `skip_indices` [B,N,5] int64 (its rows) and `skip_distances` [B,N,5] (squared, any unit of
  length a patch);
- output `dense` [B,2N,3]: the N points with code -0.2, then the N with +0.2; `features` [B,N,264] after the skip.
"""

from typing import Dict, List, Optional, Sequence

import numpy as np
import onnx
import onnx.parser
from onnx import TensorProto, helper, numpy_helper

from . import network

OPSET = 17
IR_VERSION = 8
DOMAIN, DOMAIN_VERSION = "densecloud", 1


def build_unit(
    state: Dict[str, np.ndarray], unit: int, k: int = network.K, neighbours: str = network.NEIGHBOURS
) -> onnx.ModelProto:
    """The graph of unit `unit` (1-based) from the arrays of its state dict; checked before it is returned.

    `neighbours`: whose distances the k neighbours are nearest by, as in `network.Unit`.
    """
    graph = _Graph(state)
    inputs = [_value("points", ["B", "N", 3])]
    if unit > 1:
        inputs.append(_value("previous_features", ["M", network.CHANNELS], TensorProto.FLOAT16))
        inputs.append(_value("skip_indices", ["B", "N", network.SKIP_NEIGHBOURS], TensorProto.INT64))
        inputs.append(_value("skip_distances", ["B", "N", network.SKIP_NEIGHBOURS]))
    _batch(graph)
    features = _extract(graph, k, neighbours)
    if unit > 1:
        features = _skip(graph, features)
    clouds = graph.ints("to_features", [0, -1, network.CHANNELS], head="batch")
    graph.node("Reshape", [features, clouds], "features")
    rows = graph.node("Reshape", [features, graph.ints("feature_rows", [-1, network.CHANNELS])])
    _upsample(graph, rows)
    outputs = [_value("dense", ["B", "2N", 3]), _value("features", ["B", "N", network.CHANNELS])]
    model = helper.make_model(
        helper.make_graph(graph.nodes, f"densecloud_unit{unit}", inputs, outputs, graph.initializers),
        producer_name="densecloud",
        opset_imports=[helper.make_opsetid("", OPSET), helper.make_opsetid(DOMAIN, DOMAIN_VERSION)],
        functions=[_neighbours_function(), _edge_block_function(), *([_skip_function()] if unit > 1 else [])],
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


def _batch(graph: _Graph) -> None:
    """`batch` [1]: B."""
    shape = graph.node("Shape", ["points"])
    graph.node("Slice", [shape, graph.ints("i0", [0]), graph.ints("one", [1])], "batch")


def _extract(graph: _Graph, k: int, neighbours: str) -> str:
    """[B,N,3] -> [B*N,264]."""
    rows = graph.node("Reshape", ["points", graph.ints("rows3", [-1, 3])], "point_rows")
    features = graph.linear(rows, "lift")
    indices = None if neighbours == "features" else _neighbours(graph, "points", k)
    features = graph.node("Concat", [_edge_block(graph, features, 0, k, indices), features], axis=1)
    for block in range(1, network.BLOCKS):
        squeezed = graph.node("Relu", [graph.linear(features, f"squeezes.{block - 1}")])
        own = indices if neighbours == "space-shared" else None
        features = graph.node("Concat", [_edge_block(graph, squeezed, block, k, own), features], axis=1)
    return features


def _neighbours(graph: _Graph, clouds: str, k: int) -> str:
    return graph.node("Neighbours", [clouds], domain=DOMAIN, k=k)


def _edge_block(graph: _Graph, features: str, block: int, k: int, indices: Optional[str]) -> str:
    """[R,24] -> [R,60]; the split form of `edge.EdgeBlock.forward`: all that acts on a point alone in one matrix."""
    name, g, c = f"blocks.{block}", network.GROWTH, network.BLOCK_CHANNELS
    first, second, third = (graph.state[f"{name}.{layer}.weight"] for layer in ("first", "second", "third"))
    biases = [graph.state[f"{name}.{layer}.bias"] for layer in ("first", "second", "third")]
    own = np.concatenate([first[:, :c] - first[:, c:], second[:, g:], third[:, 2 * g :], first[:, c:]]).T
    weights = [
        graph.floats(f"{name}.own", own),
        graph.floats(f"{name}.own_bias", np.concatenate([*biases, np.zeros(g)])),
        graph.floats(f"{name}.on_a", np.concatenate([second[:, :g], third[:, g : 2 * g]]).T),
        graph.floats(f"{name}.on_b", third[:, :g].T),
    ]
    clouds = graph.node("Reshape", [features, graph.ints("to_clouds", [0, -1, c], head="batch")])
    indices = indices or _neighbours(graph, clouds, k)
    edges = graph.node("EdgeBlock", [clouds, indices, *weights], domain=DOMAIN)
    return graph.node("Reshape", [edges, graph.ints("block_rows", [-1, network.BLOCK_OUT])])


def _function(
    name: str, inputs: List[str], output: str, text: str, attributes: Sequence[str] = ()
) -> onnx.FunctionProto:
    """A function whose body is given in ONNX's text form."""
    nodes = onnx.parser.parse_graph(f"body () => () {{ {text} }}").node
    opset = [helper.make_opsetid("", OPSET)]
    return helper.make_function(DOMAIN, name, inputs, [output], nodes, opset, attributes)


def _neighbours_function() -> onnx.FunctionProto:
    """`Neighbours`: [B,N,C] -> [B,N,k] int64, for each row the k nearest others of its item, in any order.

    |x_i|^2 is left out, since it shifts a whole row of distances; a point's own distance is lifted above all others.
    """
    text = """
        one = Constant <value_ints = [1]> ()
        two = Constant <value_ints = [2]> ()
        shape = Shape (rows)
        count = Slice (shape, one, two)
        start = Constant <value_int = 0> ()
        step = Constant <value_int = 1> ()
        end = Squeeze (count)
        place = Range (start, end, step)
        column = Unsqueeze (place, one)
        same = Equal (column, place)
        far = Constant <value_float = 1e30> ()
        zero = Constant <value_float = 0.0> ()
        lifted = Where (same, far, zero)
        squares = ReduceSumSquare <axes = [2], keepdims = 1> (rows)
        across = Transpose <perm = [0, 2, 1]> (squares)
        turned = Transpose <perm = [0, 2, 1]> (rows)
        minus_two = Constant <value_float = -2.0> ()
        doubled = Mul (turned, minus_two)
        products = MatMul (rows, doubled)
        masked = Add (across, lifted)
        distances = Add (products, masked)
        wanted = Constant <value_int: int = @k> ()
        k1 = Reshape (wanted, one)
        nearest, indices = TopK <axis = 2, largest = 0, sorted = 0> (distances, k1)
    """
    return _function("Neighbours", ["rows"], "indices", text, ["k"])


def _edge_block_function() -> onnx.FunctionProto:
    """`EdgeBlock`: features [B,N,24], indices [B,N,K] int64, own [24,48], own_bias [48], on_a [12,24], on_b [12,12]
    -> [B,N,60]: the largest c, b and a over the K edges, and the features.

    Columns of `own`, 12 each: the point's share of a, b and c, and what it is to the points whose neighbour it is.
    Columns of `on_a`: a's share of b and of c; `on_b`: b's share of c.
    """
    g, c = network.GROWTH, network.BLOCK_CHANNELS
    text = f"""
        i0 = Constant <value_ints = [0]> ()
        i1 = Constant <value_ints = [1]> ()
        i2 = Constant <value_ints = [2]> ()
        i3 = Constant <value_ints = [3]> ()
        growth = Constant <value_ints = [{g}]> ()
        rest = Constant <value_ints = [-1]> ()
        shape = Shape (features)
        batch = Slice (shape, i0, i1)
        count = Slice (shape, i1, i2)
        index_shape = Shape (indices)
        k = Slice (index_shape, i2, i3)
        start = Constant <value_int = 0> ()
        step = Constant <value_int = 1> ()
        items = Squeeze (batch)
        item = Range (start, items, step)
        first_row = Mul (item, count)
        column = Constant <value_ints = [-1, 1, 1]> ()
        offsets = Reshape (first_row, column)
        rows = Add (indices, offsets)
        flat_shape = Constant <value_ints = [-1, {c}]> ()
        flat = Reshape (features, flat_shape)
        points = Gemm (flat, own, own_bias)
        parts = Constant <value_ints = [{g}, {g}, {g}, {g}]> ()
        own_a, own_b, own_c, other = Split <axis = 1> (points, parts)
        edges = Concat <axis = 0> (rest, k, growth)
        edge_rows = Constant <value_ints = [-1, {g}]> ()
        neighbours = Gather <axis = 0> (other, rows)
        neighbour_edges = Reshape (neighbours, edges)
        per_point_a = Unsqueeze (own_a, i1)
        sum_a = Add (neighbour_edges, per_point_a)
        a = Relu (sum_a)
        a_rows = Reshape (a, edge_rows)
        from_a = Gemm (a_rows, on_a)
        halves = Constant <value_ints = [{g}, {g}]> ()
        b_from_a, c_from_a = Split <axis = 1> (from_a, halves)
        b_edges = Reshape (b_from_a, edges)
        per_point_b = Unsqueeze (own_b, i1)
        sum_b = Add (b_edges, per_point_b)
        b = Relu (sum_b)
        b_rows = Reshape (b, edge_rows)
        c_rows = Gemm (b_rows, on_b, c_from_a)
        c_edges = Reshape (c_rows, edges)
        largest_c = ReduceMax <axes = [1], keepdims = 0> (c_edges)
        largest_b = ReduceMax <axes = [1], keepdims = 0> (b)
        largest_a = ReduceMax <axes = [1], keepdims = 0> (a)
        whole_c = Add (largest_c, own_c)
        joined = Concat <axis = 1> (whole_c, largest_b, largest_a, flat)
        width = Constant <value_ints = [{3 * g + c}]> ()
        out_shape = Concat <axis = 0> (batch, count, width)
        block = Reshape (joined, out_shape)
    """
    inputs = ["features", "indices", "own", "own_bias", "on_a", "on_b"]
    return _function("EdgeBlock", inputs, "block", text)


def _skip(graph: _Graph, features: str) -> str:
    """[B*N,264] -> [B,N,264]."""
    clouds = graph.node("Reshape", [features, graph.ints("skip_clouds", [0, -1, network.CHANNELS], head="batch")])
    inputs = [clouds, "previous_features", "skip_indices", "skip_distances"]
    return graph.node("BilateralSkip", inputs, domain=DOMAIN)


def _skip_function() -> onnx.FunctionProto:
    """`BilateralSkip`: features [B,N,264], previous [M,264] float16, indices [B,N,5] int64, distances [B,N,5]
    -> [B,N,264]: the features and 0.2 times the bilateral mean of the previous ones (distances squared; widths as in
    `network.relative`).
    """
    text = f"""
        halves = Gather <axis = 0> (previous, indices)
        others = Cast <to = {TensorProto.FLOAT}> (halves)
        i2 = Constant <value_ints = [2]> ()
        own = Unsqueeze (features, i2)
        difference = Sub (others, own)
        featural = ReduceSumSquare <axes = [3], keepdims = 0> (difference)
        smallest_width = Constant <value_float = 1e-10> ()
        least_f = ReduceMin <axes = [2], keepdims = 1> (featural)
        mean_f = ReduceMean <axes = [1], keepdims = 1> (least_f)
        width_f = Max (mean_f, smallest_width)
        relative_f = Div (featural, width_f)
        least_s = ReduceMin <axes = [2], keepdims = 1> (distances)
        mean_s = ReduceMean <axes = [1], keepdims = 1> (least_s)
        width_s = Max (mean_s, smallest_width)
        relative_s = Div (distances, width_s)
        total = Add (relative_s, relative_f)
        minus_two = Constant <value_float = -2.0> ()
        exponents = Mul (total, minus_two)
        weights = Softmax <axis = 2> (exponents)
        factor = Constant <value_float = {network.SKIP_FACTOR}> ()
        shares = Mul (weights, factor)
        i3 = Constant <value_ints = [3]> ()
        columns = Unsqueeze (shares, i3)
        weighted = Mul (others, columns)
        mean = ReduceSum <keepdims = 0> (weighted, i2)
        result = Add (features, mean)
    """
    return _function("BilateralSkip", ["features", "previous", "indices", "distances"], "result", text)


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
