"""How nodes of an ONNX graph become layers.

Each rule receives the layers so far and a node. It adds the layers that the node becomes. If the
node's form of the operator has no layers, the rule raises a NotImplementedError.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.onnx.layers import Node, OnnxLayers

ReadRule = Callable[[OnnxLayers, Node], None]

SIXTH_TOLERANCE = 1e-6
"""How far a HardSigmoid's `alpha`, a float32, may be from 1/6."""


def plain_layer(op: str) -> ReadRule:
    """A rule that adds a layer with one input and no parameters."""

    def read(made: OnnxLayers, node: Node) -> None:
        made.add(node, op, node.inputs[:1])

    return read


def _without_leading_ones(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape without the sides of 1 at its front, which change nothing when ONNX broadcasts."""
    while shape[:1] == (1,):
        shape = shape[1:]
    return shape


# -- with weights ----------------------------------------------------------------------------------


def conv(made: OnnxLayers, node: Node) -> None:
    weights = made.weights(node, weight=1, bias=2)
    window = _window(node, made.constants[node.inputs[1]].shape[2:])
    dilation = list(node.get("dilations", [1, 1]))
    groups = node.get("group", 1)
    made.add(
        node, "conv", node.inputs[:1], weights=weights, **window, dilation=dilation, groups=groups
    )


def gemm(made: OnnxLayers, node: Node) -> None:
    has_factors = node.get("alpha", 1.0) != 1.0 or node.get("beta", 1.0) != 1.0
    expect_form(node.get("transA", 0) == 0 and not has_factors, "this Gemm")
    weight = _matrix(made, node)
    bias = made.constant(node, 2)
    if not node.get("transB", 0):
        weight = weight.T
    weights = {"weight": made.tensor(node.inputs[1], weight)}
    if bias is not None:
        sides = _without_leading_ones(bias.shape)
        fits = bias.ndim <= 2 and sides in ((), weight.shape[:1])
        expect_form(fits, f"a bias of shape {bias.shape}")
        of_units = np.broadcast_to(bias.reshape(-1), len(weight))
        weights["bias"] = made.tensor(node.inputs[2], of_units)
    made.add(node, "dense", node.inputs[:1], weights=weights)


def matmul(made: OnnxLayers, node: Node) -> None:
    weight = made.tensor(node.inputs[1], _matrix(made, node).T)
    made.add(node, "dense", node.inputs[:1], weights={"weight": weight})


def _matrix(made: OnnxLayers, node: Node) -> np.ndarray:
    """The second input, a constant matrix."""
    weight = made.constant(node, 1)
    if weight is None or weight.ndim != 2:
        raise NotImplementedError(
            "a product with other than a constant matrix has no compiled form"
        )
    return weight


def batch_norm(made: OnnxLayers, node: Node) -> None:
    # before opset 14, more than one output means training
    trains = node.get("training_mode", 0) or len(node.outputs) > 1
    expect_form(
        not trains and node.get("spatial", 1) == 1,
        "a batch norm in training mode, or of each place,",
    )
    weights = made.weights(node, weight=1, bias=2, mean=3, variance=4)
    epsilon = float(node.get("epsilon", 1e-5))
    made.add(node, "batch_norm", node.inputs[:1], weights=weights, epsilon=epsilon)


# -- sums, products, concatenations ----------------------------------------------------------------


def add(made: OnnxLayers, node: Node) -> None:
    n_constants = sum(name in made.constants for name in node.inputs)
    if n_constants == 0:
        made.add(node, "add", node.inputs)
        return
    expect_form(
        (len(node.inputs), n_constants) == (2, 1),
        "a sum other than of one map and a constant, or of maps,",
    )
    _affine(made, node, role="bias")


def multiply(made: OnnxLayers, node: Node) -> None:
    n_constants = sum(name in made.constants for name in node.inputs)
    if n_constants == 0:
        _silu(made, node)
        return
    expect_form(n_constants == 1, "a product of constants")
    _affine(made, node, role="weight")


def _affine(made: OnnxLayers, node: Node, *, role: str) -> None:
    """Add a batch norm for a node that adds a constant, or multiplies by a constant.

    The constant has one number, or one for each channel.

    Parameters
    ----------
    role : the constant's role in the batch norm: "bias" is added, "weight" multiplies.
    """
    (constant,) = [made.constants[name] for name in node.inputs if name in made.constants]
    (source,) = [name for name in node.inputs if name not in made.constants]
    n_channels, *others = made.shape(source)
    sides = _without_leading_ones(constant.shape)
    of_channels = (n_channels, *[1] * len(others))
    expect_form(sides in ((), of_channels), f"a constant of shape {constant.shape} here")

    values = np.broadcast_to(constant.reshape(-1), n_channels)
    zeros = np.zeros(n_channels, values.dtype)
    tensors = {"mean": zeros, "variance": zeros + 1, role: values}
    weights = {
        own_role: made.tensor(f"{node.outputs[0]}.{own_role}", numbers)
        for own_role, numbers in tensors.items()
    }
    made.add(node, "batch_norm", [source], weights=weights, epsilon=0.0)


def _silu(made: OnnxLayers, node: Node) -> None:
    """Add a silu for a product x sigmoid(x), which is the form that torch exports."""
    for x, factor in (node.inputs, node.inputs[::-1]):
        layer = made.layer_of(factor)
        if layer["op"] == "sigmoid" and layer["inputs"] == [made.layer(x)]:
            made.add(node, "silu", [x])
            return
    raise NotImplementedError("a product of two maps has no compiled form")


def concat(made: OnnxLayers, node: Node) -> None:
    axis = node.get("axis")
    expect_form(axis in (1, -3), f"axis {axis}, not channels (1),")
    made.add(node, "concat", node.inputs)


# -- activations -----------------------------------------------------------------------------------


def leaky_relu(made: OnnxLayers, node: Node) -> None:
    made.add(node, "leaky_relu", node.inputs[:1], slope=float(node.get("alpha", 0.01)))


def prelu(made: OnnxLayers, node: Node) -> None:
    slope = made.constant(node, 1)
    if slope is None:
        raise NotImplementedError("a PRelu without slope has no compiled form")
    # the slopes of a map have the shape (C, 1, 1): ONNX applies (C,) along the last axis
    sides = _without_leading_ones(slope.shape)
    channels, *others = made.shape(node.inputs[0])
    of_channels = (channels, *[1] * len(others))
    expect_form(slope.size == 1 or sides == of_channels, f"a slope of shape {slope.shape}")
    weights = {"slope": made.tensor(node.inputs[1], slope.reshape(-1))}
    made.add(node, "prelu", node.inputs[:1], weights=weights)


def clip(made: OnnxLayers, node: Node) -> None:
    low = _limit(made, node, 1, "min")
    high = _limit(made, node, 2, "max")
    made.add(node, "clip", node.inputs[:1], low=low, high=high)


def _limit(made: OnnxLayers, node: Node, place: int, attribute: str) -> float | None:
    """A limit of a clip, None if the node has no such limit.

    The limit is the input at `place` or, before opset 11, an attribute.
    """
    value = made.constant(node, place)
    if value is None:
        limit: float | None = node.get(attribute)
        return limit
    expect_form(value.shape == (), f"a {attribute} other than one number")
    return float(value)


def shrink(made: OnnxLayers, node: Node) -> None:
    limit = node.get("lambd", 0.5)
    bias = node.get("bias", 0.0)
    expect_form(
        limit == bias and bias >= 0, f"lambd {limit} and bias {bias}, not one number from 0 on,"
    )
    made.add(node, "softshrink", node.inputs[:1], lambd=float(limit))


def log(made: OnnxLayers, node: Node) -> None:
    """Add a log1p for a logarithm of x + 1, which is the form that torch exports."""
    name = node.inputs[0]
    sum_layer = made.layer_of(name)
    weights = sum_layer.get("weights", {})
    is_shift = sum_layer["op"] == "batch_norm" and set(weights) == {"mean", "variance", "bias"}
    expect_form(
        is_shift and bool((made.tensors[weights["bias"]] == 1).all()),
        "a logarithm of other than x + 1",
    )
    # The layer of log1p reads x, not x + 1. So while it is added, the name of the sum stands for x.
    # Other nodes still read the sum.
    made.names[name] = sum_layer["inputs"][0]
    made.add(node, "log1p", [name])
    made.names[name] = sum_layer["name"]


def hardsigmoid(made: OnnxLayers, node: Node) -> None:
    alpha = node.get("alpha", 0.2)
    beta = node.get("beta", 0.5)
    expect_form(
        abs(alpha - 1 / 6) < SIXTH_TOLERANCE and beta == 0.5,
        f"alpha {alpha} and beta {beta}, not 1/6 and 1/2,",
    )
    made.add(node, "hardsigmoid", node.inputs[:1])


def gelu(made: OnnxLayers, node: Node) -> None:
    uses_tanh = node.get("approximate", "none") == "tanh"
    made.add(node, "gelu_tanh" if uses_tanh else "gelu", node.inputs[:1])


# -- pooling ---------------------------------------------------------------------------------------


def _window(node: Node, kernel: Sequence[int]) -> dict[str, list[int]]:
    """Kernel, stride and padding of a node."""
    expect_form(len(kernel) == 2, f"a kernel of {len(kernel)} sides")
    expect_form(
        list(node.get("kernel_shape", kernel)) == list(kernel),
        "a kernel_shape other than that of the weights",
    )
    auto = node.get("auto_pad", "NOTSET")
    stride = list(node.get("strides", [1, 1]))
    padding = list(node.get("pads", [0] * 4))
    expect_form(auto == "NOTSET" or not any(padding), f"auto_pad {auto} beside pads")
    if auto in ("SAME_UPPER", "SAME_LOWER"):
        expect_form(stride == [1, 1], f"auto_pad {auto} with a stride of {stride}")
        dilation = node.get("dilations", [1, 1])
        # an odd padding has one place more at the end (SAME_UPPER) or at the front (SAME_LOWER)
        total = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        less = [n // 2 for n in total]
        more = [n - n // 2 for n in total]
        padding = less + more if auto == "SAME_UPPER" else more + less
    return {"kernel": list(kernel), "stride": stride, "padding": padding}


def max_pool(made: OnnxLayers, node: Node) -> None:
    expect_form(len(node.outputs) == 1 and not node.get("ceil_mode", 0), "ceil_mode or indices")
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    made.add(node, "max_pool", node.inputs[:1], **_window(node, node.get("kernel_shape", [])))


def average_pool(made: OnnxLayers, node: Node) -> None:
    window = _window(node, node.get("kernel_shape", []))
    expect_form(not node.get("ceil_mode", 0), "ceil_mode")
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    is_counted = node.get("count_include_pad", 0) == 1 or not any(window["padding"])
    op = "average_pool" if is_counted else "inside_average_pool"
    made.add(node, op, node.inputs[:1], **window)


def reduce_mean(made: OnnxLayers, node: Node) -> None:
    axes = node.get("axes")
    if axes is None:  # from opset 18 on the axes are an input
        given = made.constant(node, 1)
        axes = None if given is None else given.tolist()
    is_all_places = sorted(axis % 4 for axis in axes or []) == [2, 3]
    expect_form(is_all_places, f"a mean over axes {axes}, not (2, 3),")
    made.add(node, "global_average_pool", node.inputs[:1])
    if not node.get("keepdims", 1):
        made.add(node, "flatten", node.outputs)


# -- the order of numbers --------------------------------------------------------------------------


def depth_to_space(made: OnnxLayers, node: Node) -> None:
    expect_form(node.get("mode", "DCR") == "CRD", "mode DCR")
    made.add(node, "depth_to_space", node.inputs[:1], block=node.get("blocksize"))


def flatten(made: OnnxLayers, node: Node) -> None:
    axis = node.get("axis", 1)
    expect_form(axis == 1, f"axis {axis}, not 1,")
    made.add(node, "flatten", node.inputs[:1])


def reshape(made: OnnxLayers, node: Node) -> None:
    """Add a flatten for a reshape to (n, -1) or (n, m) that gives one row for each volume."""
    given = made.constant(node, 1)
    shape = None if given is None else given.tolist()
    fits = False
    if given is not None and given.shape == (2,):
        rows, n = given.tolist()
        fits = _is_one_row(made, node, rows, n)
    expect_form(fits, f"a reshape to {shape}, not (n, -1), one row a volume,")
    made.add(node, "flatten", node.inputs[:1])


def _is_one_row(made: OnnxLayers, node: Node, rows: int, n: int) -> bool:
    """Whether a reshape to (rows, n) gives one row for each volume."""
    if rows == 0 and node.get("allowzero", 0):
        return False  # then 0 does not stand for the size of the batch
    if n == -1:
        return rows in (0, 1)
    return rows in (-1, 0, 1) and n == math.prod(made.shape(node.inputs[0]))


# -- no layers -------------------------------------------------------------------------------------


def constant(made: OnnxLayers, node: Node) -> None:
    from onnx import numpy_helper

    value = node.get("value")
    expect_form(value is not None, "a constant without `value`")
    made.constants[node.outputs[0]] = numpy_helper.to_array(value)


def softmax(made: OnnxLayers, node: Node) -> None:
    """Leave out the softmax at the end of a network, which must be over the classes.

    Before opset 13 a softmax is over all axes from `axis` on.
    """
    axis = node.get("axis", 1 if made.opset < 13 else -1)
    n_axes = len(made.shape(node.inputs[0])) + 1
    expect_form(axis % n_axes == 1, f"a softmax over axis {axis}, not over the classes (1),")
    made.alias(node, node.inputs[0])


def dropout(made: OnnxLayers, node: Node) -> None:
    training = made.constant(node, 2)
    expect_form(training is None or not training.any(), "a dropout in training mode")
    identity(made, node)


def identity(made: OnnxLayers, node: Node) -> None:
    name = node.inputs[0]
    if name in made.constants:
        made.constants[node.outputs[0]] = made.constants[name]
    else:
        made.alias(node, name)
