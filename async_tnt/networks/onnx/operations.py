"""ONNX's operations that have a compiled form, and how a node becomes layers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.onnx.layers import Node, OnnxLayers


def _window(node: Node, kernel: Sequence[int]) -> dict[str, list[int]]:
    expect_form(len(kernel) == 2, f"a kernel of {len(kernel)} sides")
    expect_form(
        list(node.get("kernel_shape", kernel)) == list(kernel),
        "a kernel_shape other than that of the weights",
    )
    auto, dilation = node.get("auto_pad", "NOTSET"), node.get("dilations", [1, 1])
    stride, padding = list(node.get("strides", [1, 1])), list(node.get("pads", [0] * 4))
    expect_form(auto == "NOTSET" or not any(padding), f"auto_pad {auto} beside pads")
    if auto in ("SAME_UPPER", "SAME_LOWER"):
        expect_form(stride == [1, 1], f"auto_pad {auto} with a stride of {stride}")
        total = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        less, more = [n // 2 for n in total], [n - n // 2 for n in total]
        padding = less + more if auto == "SAME_UPPER" else more + less
    return {"kernel": list(kernel), "stride": stride, "padding": padding}


def _conv(made: OnnxLayers, node: Node) -> None:
    weights = made.weights(node, weight=1, bias=2)
    window = _window(node, made.constants[node.inputs[1]].shape[2:])
    more = {"dilation": list(node.get("dilations", [1, 1])), "groups": node.get("group", 1)}
    made.add(node, "conv", node.inputs[:1], weights=weights, **window, **more)


def _gemm(made: OnnxLayers, node: Node) -> None:
    expect_form(
        node.get("transA", 0) == 0 and node.get("alpha", 1.0) == node.get("beta", 1.0) == 1.0,
        "this Gemm",
    )
    weight, bias = _matrix(made, node), made.constant(node, 2)
    weight = weight if node.get("transB", 0) else weight.T
    weights = {"weight": made.tensor(node.inputs[1], weight)}
    if bias is not None:
        sides = _without_leading_ones(bias.shape)
        expect_form(
            bias.ndim <= 2 and sides in ((), weight.shape[:1]), f"a bias of shape {bias.shape}"
        )
        weights["bias"] = made.tensor(
            node.inputs[2], np.broadcast_to(bias.reshape(-1), len(weight))
        )
    made.add(node, "dense", node.inputs[:1], weights=weights)


def _matmul(made: OnnxLayers, node: Node) -> None:
    weight = _matrix(made, node)
    made.add(
        node, "dense", node.inputs[:1], weights={"weight": made.tensor(node.inputs[1], weight.T)}
    )


def _matrix(made: OnnxLayers, node: Node) -> np.ndarray:
    weight = made.constant(node, 1)
    if weight is None or weight.ndim != 2:
        raise NotImplementedError(
            "a product with other than a constant matrix has no compiled form"
        )
    return weight


def _batch_norm(made: OnnxLayers, node: Node) -> None:
    # before opset 14: outputs tell
    training = node.get("training_mode", 0) or len(node.outputs) > 1
    expect_form(
        not training and node.get("spatial", 1) == 1,
        "a batch norm in training mode, or of each place,",
    )
    weights = made.weights(node, weight=1, bias=2, mean=3, variance=4)
    made.add(
        node,
        "batch_norm",
        node.inputs[:1],
        weights=weights,
        epsilon=float(node.get("epsilon", 1e-5)),
    )


def _without_leading_ones(shape: tuple[int, ...]) -> tuple[int, ...]:
    """What is left of a shape as ONNX broadcasts it."""
    while shape[:1] == (1,):
        shape = shape[1:]
    return shape


def _affine(made: OnnxLayers, node: Node, *, is_sum: bool) -> None:
    """A sum or product with a constant, of one number or of one for each channel, as a batch
    norm."""
    (constant,) = (made.constants[name] for name in node.inputs if name in made.constants)
    (source,) = (name for name in node.inputs if name not in made.constants)
    shape = made.shape(source)
    sides = _without_leading_ones(constant.shape)
    expect_form(
        sides in ((), (shape[0], *[1] * (len(shape) - 1))),
        f"a constant of shape {constant.shape} here",
    )
    n = shape[0]
    values = np.broadcast_to(constant.reshape(-1), n)
    zeros = np.zeros(n, values.dtype)
    of_role = {"mean": zeros, "variance": zeros + 1, "bias" if is_sum else "weight": values}
    weights = {
        role: made.tensor(f"{node.outputs[0]}.{role}", numbers) for role, numbers in of_role.items()
    }
    made.add(node, "batch_norm", [source], weights=weights, epsilon=0.0)


def _add(made: OnnxLayers, node: Node) -> None:
    if any(name in made.constants for name in node.inputs):
        constants = sum(name in made.constants for name in node.inputs)
        expect_form(
            (len(node.inputs), constants) == (2, 1),
            "a sum other than of one map and a constant, or of maps,",
        )
        _affine(made, node, is_sum=True)
    else:
        made.add(node, "add", node.inputs)


def _mul(made: OnnxLayers, node: Node) -> None:
    if not any(name in made.constants for name in node.inputs):
        _silu(made, node)
    else:
        expect_form(
            sum(name in made.constants for name in node.inputs) == 1, "a product of constants"
        )
        _affine(made, node, is_sum=False)


def _silu(made: OnnxLayers, node: Node) -> None:
    """x sigmoid(x), as torch exports it."""
    for x, factor in (node.inputs, node.inputs[::-1]):
        of_factor = made.layer_of(factor)
        if of_factor["op"] == "sigmoid" and of_factor["inputs"] == [made.layer(x)]:
            return made.add(node, "silu", [x])
    raise NotImplementedError("a product of two maps has no compiled form")


def _log(made: OnnxLayers, node: Node) -> None:
    """log(x + 1), as torch exports log1p."""
    sum_of = made.layer_of(node.inputs[0])
    weights = sum_of.get("weights", {})
    is_plus_one = sum_of["op"] == "batch_norm" and set(weights) == {"mean", "variance", "bias"}
    expect_form(
        is_plus_one and bool((made.tensors[weights["bias"]] == 1).all()),
        "a logarithm of other than x + 1",
    )
    made.names[node.inputs[0]] = sum_of["inputs"][0]
    made.add(node, "log1p", node.inputs[:1])
    made.names[node.inputs[0]] = sum_of["name"]


def _function(op: str) -> Callable[[OnnxLayers, Node], None]:
    """Of one input, without parameters."""
    return lambda made, node: made.add(node, op, node.inputs[:1])


def _hardsigmoid(made: OnnxLayers, node: Node) -> None:
    alpha, beta = node.get("alpha", 0.2), node.get("beta", 0.5)
    expect_form(
        abs(alpha - 1 / 6) < 1e-6 and beta == 0.5,
        f"alpha {alpha} and beta {beta}, not 1/6 and 1/2,",
    )
    made.add(node, "hardsigmoid", node.inputs[:1])


def _gelu(made: OnnxLayers, node: Node) -> None:
    made.add(
        node, "gelu_tanh" if node.get("approximate", "none") == "tanh" else "gelu", node.inputs[:1]
    )


def _leaky_relu(made: OnnxLayers, node: Node) -> None:
    made.add(node, "leaky_relu", node.inputs[:1], slope=float(node.get("alpha", 0.01)))


def _prelu(made: OnnxLayers, node: Node) -> None:
    slope = made.constant(node, 1)
    if slope is None:
        raise NotImplementedError("a PRelu without slope has no compiled form")
    # (C, 1, 1): ONNX would apply (n,) along the last axis
    sides = _without_leading_ones(slope.shape)
    channels, *others = made.shape(node.inputs[0])
    expect_form(
        slope.size == 1 or sides == (channels, *[1] * len(others)),
        f"a slope of shape {slope.shape}",
    )
    made.add(
        node,
        "prelu",
        node.inputs[:1],
        weights={"slope": made.tensor(node.inputs[1], slope.reshape(-1))},
    )


def _clip(made: OnnxLayers, node: Node) -> None:
    limits = {}
    for place, (name, attribute) in enumerate({"low": "min", "high": "max"}.items(), start=1):
        value = made.constant(node, place)
        expect_form(value is None or value.shape == (), f"a {attribute} other than one number")
        limits[name] = node.get(attribute) if value is None else float(value)
    made.add(node, "clip", node.inputs[:1], **limits)


def _max_pool(made: OnnxLayers, node: Node) -> None:
    expect_form(len(node.outputs) == 1 and not node.get("ceil_mode", 0), "ceil_mode or indices")
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    made.add(node, "max_pool", node.inputs[:1], **_window(node, node.get("kernel_shape", [])))


def _average_pool(made: OnnxLayers, node: Node) -> None:
    window = _window(node, node.get("kernel_shape", []))
    expect_form(not node.get("ceil_mode", 0), "ceil_mode")
    expect_form(list(node.get("dilations", [1, 1])) == [1, 1], "dilation")
    counted = node.get("count_include_pad", 0) == 1 or not any(window["padding"])
    made.add(node, "average_pool" if counted else "inside_average_pool", node.inputs[:1], **window)


def _reduce_mean(made: OnnxLayers, node: Node) -> None:
    axes = node.get("axes")
    if axes is None and (given := made.constant(node, 1)) is not None:
        axes = given.tolist()
    expect_form(
        sorted(axis % 4 for axis in axes or []) == [2, 3], f"a mean over axes {axes}, not (2, 3),"
    )
    made.add(node, "global_average_pool", node.inputs[:1])
    if not node.get("keepdims", 1):
        made.add(node, "flatten", node.outputs)


def _depth_to_space(made: OnnxLayers, node: Node) -> None:
    expect_form(node.get("mode", "DCR") == "CRD", "mode DCR")
    made.add(node, "depth_to_space", node.inputs[:1], block=node.get("blocksize"))


def _concat(made: OnnxLayers, node: Node) -> None:
    expect_form(node.get("axis") in (1, -3), f"axis {node.get('axis')}, not channels (1),")
    made.add(node, "concat", node.inputs)


def _flatten(made: OnnxLayers, node: Node) -> None:
    expect_form(node.get("axis", 1) == 1, f"axis {node.get('axis')}, not 1,")
    made.add(node, "flatten", node.inputs[:1])


def _reshape(made: OnnxLayers, node: Node) -> None:
    """To (n, -1) or (n, m), one row a volume; 0 stands for the batch, unless `allowzero` says that
    it is none."""
    given = made.constant(node, 1)
    rows, n = (None, None) if given is None or given.shape != (2,) else given.tolist()
    fits = (rows in (0, 1) and n == -1) or (
        rows in (-1, 0, 1) and n == math.prod(made.shape(node.inputs[0]))
    )
    fits = fits and not (rows == 0 and node.get("allowzero", 0))
    expect_form(
        fits,
        f"a reshape to {None if given is None else given.tolist()}, not (n, -1), one row a volume,",
    )
    made.add(node, "flatten", node.inputs[:1])


def _constant(made: OnnxLayers, node: Node) -> None:
    from onnx import numpy_helper

    expect_form(node.get("value") is not None, "a constant without `value`")
    made.constants[node.outputs[0]] = numpy_helper.to_array(node.get("value"))


def _softmax(made: OnnxLayers, node: Node) -> None:
    """The last one, over the classes: before opset 13 over all axes from `axis` on."""
    axis = node.get("axis", 1 if made.opset < 13 else -1)
    n_axes = len(made.shape(node.inputs[0])) + 1
    expect_form(axis % n_axes == 1, f"a softmax over axis {axis}, not over the classes (1),")
    made.alias(node, node.inputs[0])


def _dropout(made: OnnxLayers, node: Node) -> None:
    training = made.constant(node, 2)
    expect_form(training is None or not training.any(), "a dropout in training mode")
    _identity(made, node)


def _identity(made: OnnxLayers, node: Node) -> None:
    if node.inputs[0] in made.constants:
        made.constants[node.outputs[0]] = made.constants[node.inputs[0]]
    else:
        made.alias(node, node.inputs[0])


RULES: dict[str, Callable[[OnnxLayers, Node], None]] = {
    "Conv": _conv,
    "Gemm": _gemm,
    "MatMul": _matmul,
    "BatchNormalization": _batch_norm,
    "Add": _add,
    "Sum": _add,
    "Mul": _mul,
    "Relu": _function("relu"),
    "Log": _log,
    "Sigmoid": _function("sigmoid"),
    "Tanh": _function("tanh"),
    "HardSwish": _function("hardswish"),
    "HardSigmoid": _hardsigmoid,
    "Gelu": _gelu,
    "LeakyRelu": _leaky_relu,
    "PRelu": _prelu,
    "Clip": _clip,
    "MaxPool": _max_pool,
    "AveragePool": _average_pool,
    "GlobalAveragePool": _function("global_average_pool"),
    "ReduceMean": _reduce_mean,
    "DepthToSpace": _depth_to_space,
    "Concat": _concat,
    "Flatten": _flatten,
    "Reshape": _reshape,
    "Constant": _constant,
    "Softmax": _softmax,
    "Dropout": _dropout,
    "Identity": _identity,
}
"""Type of a node -> its rule."""
