"""How nodes of an ONNX graph become layers.

Each rule receives the layers so far and a node. It adds the layers that the node becomes. If no
layers compute what the node computes, the rule raises a NotImplementedError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.enlarging import (
    EDGE,
    Enlarging,
    bilinear,
    nearest,
    transposed_convolution,
)
from async_tnt.networks.layers.uneven_windows import last_windows, padding_of_ceil_mode
from async_tnt.networks.onnx.layers import Node, OnnxLayers, without_leading_ones

ReadRule = Callable[[OnnxLayers, Node], None]

SIXTH_TOLERANCE = 1e-6
"""How far a HardSigmoid's `alpha`, a float32, may be from 1/6."""


def plain_layer(op: str) -> ReadRule:
    """A rule that adds a layer with one input and no parameters."""

    def read(onnx_layers: OnnxLayers, node: Node) -> None:
        onnx_layers.add(node, op, node.inputs[:1])

    return read


# -- with weights ----------------------------------------------------------------------------------


def conv(onnx_layers: OnnxLayers, node: Node) -> None:
    weights = onnx_layers.weights(node, weight=1, bias=2)
    window = _window(node, onnx_layers.constants[node.inputs[1]].shape[2:])
    dilation = list(node.get("dilations", [1, 1]))
    groups = node.get("group", 1)
    onnx_layers.add(
        node, "conv", node.inputs[:1], weights=weights, **window, dilation=dilation, groups=groups
    )


def conv_transpose(onnx_layers: OnnxLayers, node: Node) -> None:
    weight = onnx_layers.constant(node, 1)
    expect_form(weight is not None and weight.ndim == 4, "this ConvTranspose")
    assert weight is not None
    auto_pad = node.get("auto_pad", "NOTSET")
    expect_form(auto_pad in ("NOTSET", "VALID"), f"auto_pad {auto_pad}")
    expect_form(node.get("output_shape") is None, "output_shape")
    weight = onnx_layers.floating(node.inputs[1])
    bias = onnx_layers.constant(node, 2)
    if bias is not None:
        bias = onnx_layers.floating(node.inputs[2])
    enlarging = transposed_convolution(
        weight,
        bias,
        onnx_layers.shape(node.inputs[0])[1:],
        stride=node.get("strides", [1, 1]),
        padding=node.get("pads", [0] * 4),
        output_padding=node.get("output_padding", [0, 0]),
        dilation=node.get("dilations", [1, 1]),
        groups=node.get("group", 1),
    )
    _enlarge(onnx_layers, node, enlarging, weight.dtype)


def resize(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add the layers of an upsampling by one whole number, nearest or linear.

    A map of one place may be repeated by two different numbers.
    """
    mode = node.get("mode", "nearest")
    expect_form(mode in ("nearest", "linear"), f"mode {mode}")
    coordinates = node.get("coordinate_transformation_mode", "half_pixel")
    rounding = node.get("nearest_mode", "round_prefer_floor")
    if onnx_layers.opset < 11:  # without these attributes
        coordinates, rounding = "asymmetric", "floor"
    if mode == "nearest":
        # all of these repeat each place, if the factor is a whole number
        repeats = coordinates == "asymmetric" and rounding == "floor"
        repeats |= coordinates == "half_pixel" and rounding.startswith("round_")
        expect_form(repeats, f"{coordinates} with {rounding}")
    else:
        known = ("half_pixel", "pytorch_half_pixel", "align_corners")
        expect_form(coordinates in known and not node.get("antialias", 0), f"linear {coordinates}")
    channels, *sides = onnx_layers.shape(node.inputs[0])
    expect_form(len(sides) == 2, "a Resize of a vector")
    factors = _factors(onnx_layers, node, sides)
    if sides == [1, 1] and all(factor.is_integer() for factor in factors):
        # the number of the only place, everywhere
        size = [int(factor) for factor in factors]
        onnx_layers.add(node, "expand", node.inputs[:1], size=size)
        return
    is_whole = factors[0] == factors[1] and factors[0].is_integer()
    expect_form(is_whole, f"a Resize by {factors}, not by one whole number,")
    factor = int(factors[0])
    if coordinates == "align_corners":
        onnx_layers.add(node, "bilinear_corners", node.inputs[:1], block=factor)
        return
    if mode == "nearest":
        _enlarge(onnx_layers, node, nearest(channels, factor), onnx_layers.dtype)
        return
    onnx_layers.add(node, "edge_pad", node.inputs[:1], padding=EDGE)
    sources = node.outputs
    _enlarge(onnx_layers, node, bilinear(channels, factor), onnx_layers.dtype, sources)


def _factors(onnx_layers: OnnxLayers, node: Node, sides: Sequence[int]) -> list[float]:
    """By which factors a Resize or Upsample enlarges rows and columns, from its sizes or scales."""
    sizes = onnx_layers.constant(node, 3)
    if sizes is not None and sizes.size:
        return [float(size) / side for size, side in zip(sizes[2:], sides, strict=True)]

    is_old = node.op == "Upsample" or onnx_layers.opset < 11
    scales = onnx_layers.constant(node, 1 if is_old else 2)
    if node.get("scales") is not None:  # an attribute before opset 9
        scales = np.array(node.get("scales"))
    expect_form(scales is not None and scales.size == 4, "a Resize without scales")
    assert scales is not None
    expect_form(scales[:2].tolist() == [1, 1], "a Resize of other than places")
    return [float(scale) for scale in scales[2:]]


def pad(onnx_layers: OnnxLayers, node: Node) -> None:
    mode = node.get("mode", "constant")
    expect_form(mode in ("constant", "edge"), f"mode {mode}")
    pads = node.get("pads")
    value = node.get("value", 0.0)
    if onnx_layers.opset >= 11:
        given = onnx_layers.constant(node, 1)
        pads = None if given is None else given.tolist()
        constant = onnx_layers.constant(node, 2)
        value = 0.0 if constant is None else constant.reshape(-1)[0]
        expect_form(onnx_layers.constant(node, 3) is None, "a padding of some axes")
    n_axes = 1 + len(onnx_layers.shape(node.inputs[0]))
    fits = pads is not None and n_axes == 4 and len(pads) == 8 and min(pads) >= 0
    expect_form(fits and not any(pads[:2] + pads[4:6]), f"a padding of {pads}")
    expect_form(mode == "edge" or value == 0, f"a padding of the value {value}")
    padding = [int(n) for n in (*pads[2:4], *pads[6:])]
    op = "edge_pad" if mode == "edge" else "zero_pad"
    onnx_layers.add(node, op, node.inputs[:1], padding=padding)


def _enlarge(
    onnx_layers: OnnxLayers,
    node: Node,
    enlarging: Enlarging,
    dtype: np.dtype,
    sources: Sequence[str] = (),
) -> None:
    """Add the convolution and the blocks of a node by which a map grows.

    sources : the value of the map; by default the node's first input.
    """
    weights = {}
    for role, values in (("weight", enlarging.weight), ("bias", enlarging.bias)):
        if values is not None:
            name = f"{node.outputs[0]}.{role}"
            weights[role] = onnx_layers.tensor(name, values.astype(dtype))
    inputs = sources or node.inputs[:1]
    onnx_layers.add(node, "conv", inputs, weights=weights, **enlarging.conv)
    if enlarging.block > 1:
        onnx_layers.add(node, "depth_to_space", node.outputs, block=enlarging.block)


def gemm(onnx_layers: OnnxLayers, node: Node) -> None:
    has_factors = node.get("alpha", 1.0) != 1.0 or node.get("beta", 1.0) != 1.0
    expect_form(node.get("transA", 0) == 0 and not has_factors, "this Gemm")
    weight = _matrix(onnx_layers, node)
    bias = onnx_layers.constant(node, 2)
    if not node.get("transB", 0):
        weight = weight.T
    weights = {"weight": onnx_layers.tensor(node.inputs[1], weight)}
    if bias is not None:
        bias_shape = without_leading_ones(bias.shape)
        fits = bias.ndim <= 2 and bias_shape in ((), weight.shape[:1])
        expect_form(fits, f"a bias of shape {bias.shape}")
        unit_biases = np.broadcast_to(bias.reshape(-1), len(weight))
        weights["bias"] = onnx_layers.tensor(node.inputs[2], unit_biases)
    onnx_layers.add(node, "dense", node.inputs[:1], weights=weights)


def matmul(onnx_layers: OnnxLayers, node: Node) -> None:
    if node.inputs[0] in onnx_layers.channels_last:
        _dense_of_last(onnx_layers, node)
        return
    weight = onnx_layers.tensor(node.inputs[1], _matrix(onnx_layers, node).T)
    onnx_layers.add(node, "dense", node.inputs[:1], weights={"weight": weight})


def _dense_of_last(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a convolution of one place for a product over the channels as last axis."""
    weight = _matrix(onnx_layers, node).T[:, :, np.newaxis, np.newaxis]
    name = onnx_layers.tensor(f"{node.inputs[1]}.filters", weight)
    onnx_layers.add(
        node,
        "conv",
        node.inputs[:1],
        weights={"weight": name},
        kernel=[1, 1],
        stride=[1, 1],
        padding=[0, 0, 0, 0],
        dilation=[1, 1],
        groups=1,
    )


def _matrix(onnx_layers: OnnxLayers, node: Node) -> np.ndarray:
    """The second input, a constant matrix."""
    weight = onnx_layers.constant(node, 1)
    if weight is None or weight.ndim != 2:
        raise NotImplementedError(
            "a product with other than a constant matrix has no compiled form"
        )
    return weight


def batch_norm(onnx_layers: OnnxLayers, node: Node) -> None:
    # before opset 14, more than one output means training
    trains = node.get("training_mode", 0) or len(node.outputs) > 1
    expect_form(
        not trains and node.get("spatial", 1) == 1,
        "a batch norm in training mode, or of each place,",
    )
    weights = onnx_layers.weights(node, weight=1, bias=2, mean=3, variance=4)
    epsilon = float(node.get("epsilon", 1e-5))
    onnx_layers.add(node, "batch_norm", node.inputs[:1], weights=weights, epsilon=epsilon)


# -- activations -----------------------------------------------------------------------------------


def leaky_relu(onnx_layers: OnnxLayers, node: Node) -> None:
    onnx_layers.add(node, "leaky_relu", node.inputs[:1], slope=float(node.get("alpha", 0.01)))


def absolute(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a leaky ReLU of slope -1 for |x|."""
    onnx_layers.add(node, "leaky_relu", node.inputs[:1], slope=-1.0)


def prelu(onnx_layers: OnnxLayers, node: Node) -> None:
    slope = onnx_layers.constant(node, 1)
    if slope is None:
        raise NotImplementedError("a PRelu without slope has no compiled form")
    # The slopes of a map have the shape (C, 1, 1), because ONNX applies (C,) along the last axis.
    slope_shape = without_leading_ones(slope.shape)
    channels, *sides_of_map = onnx_layers.shape(node.inputs[0])
    channel_shape = (channels, *[1] * len(sides_of_map))
    expect_form(slope.size == 1 or slope_shape == channel_shape, f"a slope of shape {slope.shape}")
    weights = {"slope": onnx_layers.tensor(node.inputs[1], slope.reshape(-1))}
    onnx_layers.add(node, "prelu", node.inputs[:1], weights=weights)


def clip(onnx_layers: OnnxLayers, node: Node) -> None:
    low = _limit(onnx_layers, node, 1, "min")
    high = _limit(onnx_layers, node, 2, "max")
    onnx_layers.add(node, "clip", node.inputs[:1], low=low, high=high)


def _limit(onnx_layers: OnnxLayers, node: Node, place: int, attribute: str) -> float | None:
    """A limit of a clip, None if the node has no such limit.

    The limit is the input at `place` or, before opset 11, an attribute.
    """
    value = onnx_layers.constant(node, place)
    if value is None:
        limit: float | None = node.get(attribute)
        return limit
    expect_form(value.shape == (), f"a {attribute} other than one number")
    return float(value)


def shrink(onnx_layers: OnnxLayers, node: Node) -> None:
    limit = node.get("lambd", 0.5)
    bias = node.get("bias", 0.0)
    expect_form(
        limit == bias and bias >= 0, f"lambd {limit} and bias {bias}, not one number from 0 on,"
    )
    onnx_layers.add(node, "softshrink", node.inputs[:1], lambd=float(limit))


def log(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a log1p for a logarithm of x + 1, which is the form that torch exports."""
    name = node.inputs[0]
    sum_layer = onnx_layers.layer_of(name)
    weights = sum_layer.get("weights", {})
    adds_constant = sum_layer["op"] == "batch_norm" and set(weights) == {"mean", "variance", "bias"}
    expect_form(
        adds_constant and bool((onnx_layers.tensors[weights["bias"]] == 1).all()),
        "a logarithm of other than x + 1",
    )
    # The layer of log1p reads x, not x + 1. So the name of the sum stands for x while this layer is
    # added. Afterwards it stands for the sum again, which other nodes may read.
    onnx_layers.names[name] = sum_layer["inputs"][0]
    onnx_layers.add(node, "log1p", [name])
    onnx_layers.names[name] = sum_layer["name"]


def hardsigmoid(onnx_layers: OnnxLayers, node: Node) -> None:
    alpha = node.get("alpha", 0.2)
    beta = node.get("beta", 0.5)
    expect_form(
        abs(alpha - 1 / 6) < SIXTH_TOLERANCE and beta == 0.5,
        f"alpha {alpha} and beta {beta}, not 1/6 and 1/2,",
    )
    onnx_layers.add(node, "hardsigmoid", node.inputs[:1])


def gelu(onnx_layers: OnnxLayers, node: Node) -> None:
    uses_tanh = node.get("approximate", "none") == "tanh"
    onnx_layers.add(node, "gelu_tanh" if uses_tanh else "gelu", node.inputs[:1])


# -- pooling ---------------------------------------------------------------------------------------


def _window(node: Node, kernel: Sequence[int]) -> dict[str, list[int]]:
    """Kernel, stride and padding of a node."""
    expect_form(len(kernel) == 2, f"a kernel of {len(kernel)} sides")
    expect_form(
        list(node.get("kernel_shape", kernel)) == list(kernel),
        "a kernel_shape other than that of the weights",
    )
    auto_pad = node.get("auto_pad", "NOTSET")
    stride = list(node.get("strides", [1, 1]))
    padding = list(node.get("pads", [0] * 4))
    expect_form(auto_pad == "NOTSET" or not any(padding), f"auto_pad {auto_pad} beside pads")
    if auto_pad in ("SAME_UPPER", "SAME_LOWER"):
        expect_form(stride == [1, 1], f"auto_pad {auto_pad} with a stride of {stride}")
        dilation = node.get("dilations", [1, 1])
        # an odd padding has one place more at the end (SAME_UPPER) or at the front (SAME_LOWER)
        total_padding = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        smaller_half = [n // 2 for n in total_padding]
        larger_half = [n - n // 2 for n in total_padding]
        if auto_pad == "SAME_UPPER":
            padding = smaller_half + larger_half
        else:
            padding = larger_half + smaller_half
    return {"kernel": list(kernel), "stride": stride, "padding": padding}


def max_pool(onnx_layers: OnnxLayers, node: Node) -> None:
    expect_form(len(node.outputs) == 1, "indices")
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    window = _window(node, node.get("kernel_shape", []))
    if node.get("ceil_mode", 0):
        _round_up(onnx_layers, node, window)
    onnx_layers.add(node, "max_pool", node.inputs[:1], **window)


def _round_up(onnx_layers: OnnxLayers, node: Node, window: dict[str, list[int]]) -> None:
    """Add the padding that a window with `ceil_mode` reaches beyond the input.

    Versions of ONNX differ in windows that begin behind the input, so these are refused.
    """
    for axis, side in enumerate(onnx_layers.shape(node.inputs[0])[1:]):
        kernel, stride = window["kernel"][axis], window["stride"][axis]
        before, after = window["padding"][axis], window["padding"][2 + axis]
        last_rounded_up, last_inside = last_windows(side, kernel, stride, before)
        is_clear = before == after and last_rounded_up <= last_inside
        expect_form(is_clear, "ceil_mode with a window that begins behind the input")
        needed = padding_of_ceil_mode(side, kernel, stride, before)
        window["padding"][2 + axis] = max(after, needed)


def average_pool(onnx_layers: OnnxLayers, node: Node) -> None:
    window = _window(node, node.get("kernel_shape", []))
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    is_counted = node.get("count_include_pad", 0) == 1 or not any(window["padding"])
    if node.get("ceil_mode", 0):
        is_padded = any(window["padding"])
        expect_form(not (is_counted and is_padded), "ceil_mode with padding that counts")
        _round_up(onnx_layers, node, window)
        is_counted = False
    op = "average_pool" if is_counted else "inside_average_pool"
    onnx_layers.add(node, op, node.inputs[:1], **window)


def reduce_mean(onnx_layers: OnnxLayers, node: Node) -> None:
    axes = node.get("axes")
    if axes is None:  # from opset 18 on the axes are an input
        axes_input = onnx_layers.constant(node, 1)
        axes = None if axes_input is None else axes_input.tolist()
    is_all_places = sorted(axis % 4 for axis in axes or []) == [2, 3]
    expect_form(is_all_places, f"a mean over axes {axes}, not (2, 3),")
    onnx_layers.add(node, "global_average_pool", node.inputs[:1])
    if not node.get("keepdims", 1):
        onnx_layers.add(node, "flatten", node.outputs)


# -- no layers -------------------------------------------------------------------------------------


def constant(onnx_layers: OnnxLayers, node: Node) -> None:
    from onnx import numpy_helper

    value = node.get("value")
    expect_form(value is not None, "a constant without `value`")
    onnx_layers.constants[node.outputs[0]] = numpy_helper.to_array(value)


def softmax(onnx_layers: OnnxLayers, node: Node) -> None:
    """Leave out the softmax at the end of a network. It must be over the classes.

    Before opset 13 a softmax is over all axes from `axis` on.
    """
    axis = node.get("axis", 1 if onnx_layers.opset < 13 else -1)
    n_axes = len(onnx_layers.shape(node.inputs[0])) + 1
    expect_form(axis % n_axes == 1, f"a softmax over axis {axis}, not over the classes (1),")
    onnx_layers.alias(node, node.inputs[0])


def dropout(onnx_layers: OnnxLayers, node: Node) -> None:
    training = onnx_layers.constant(node, 2)
    expect_form(training is None or not training.any(), "a dropout in training mode")
    identity(onnx_layers, node)


def identity(onnx_layers: OnnxLayers, node: Node) -> None:
    name = node.inputs[0]
    if name in onnx_layers.constants:
        onnx_layers.constants[node.outputs[0]] = onnx_layers.constants[name]
    else:
        onnx_layers.alias(node, name)
