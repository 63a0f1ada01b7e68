"""The rules by which calls of torch's operations become layers.

The rules of calls that join maps, or arrange their numbers, are in `arranging`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.enlarging import (
    EDGE,
    Enlarging,
    bilinear,
    nearest,
    transposed_convolution,
)
from async_tnt.networks.layers.uneven_windows import padding_of_ceil_mode
from async_tnt.networks.torch.form import Rule, same_layer
from async_tnt.networks.torch.layers import Call, LayerList, float_array
from async_tnt.networks.torch.norms import linear_of_last


def _pair(value: Any) -> list[int]:
    """A parameter of torch as sides [y, x]. Torch also accepts one number for both sides."""
    if isinstance(value, (tuple, list)):
        return [int(v) for v in value]
    return [int(value), int(value)]


# -- with weights ----------------------------------------------------------------------------------


def conv(layer_list: LayerList, call: Call) -> str:
    module = call.module
    expect_form(module.padding_mode == "zeros", f"padding_mode {module.padding_mode!r}")
    weights = layer_list.tensors(call, weight="weight", bias="bias")
    kernel = _pair(module.kernel_size)
    return _conv(layer_list, call, weights, kernel, vars(module))


def conv_function(layer_list: LayerList, call: Call) -> str:
    """Add a convolution for F.conv2d, whose weights are tensors of the module."""
    weights = layer_list.constants(call, weight="weight", bias="bias")
    return _conv(layer_list, call, weights, list(call["weight"].shape[2:]), call.arguments)


def _conv(
    layer_list: LayerList,
    call: Call,
    weights: dict[str, str],
    kernel: list[int],
    parameters: Mapping[str, Any],
) -> str:
    dilation = _pair(parameters["dilation"])
    if parameters["padding"] == "same":
        # if the padding is odd, torch puts the extra place at the end
        total_padding = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        before = [n // 2 for n in total_padding]
        after = [n - n // 2 for n in total_padding]
        padding = before + after
    elif parameters["padding"] == "valid":
        padding = [0, 0, 0, 0]
    else:
        padding = 2 * _pair(parameters["padding"])
    return layer_list.add(
        "conv",
        call,
        weights=weights,
        kernel=kernel,
        stride=_pair(parameters["stride"]),
        padding=padding,
        dilation=dilation,
        groups=parameters["groups"],
    )


def conv_transpose(layer_list: LayerList, call: Call) -> str:
    module = call.module
    expect_form(module.padding_mode == "zeros", f"padding_mode {module.padding_mode!r}")
    enlarging = transposed_convolution(
        float_array(module.weight),
        None if module.bias is None else float_array(module.bias),
        layer_list.shape(call["input"])[1:],
        stride=_pair(module.stride),
        padding=2 * _pair(module.padding),
        output_padding=_pair(module.output_padding),
        dilation=_pair(module.dilation),
        groups=module.groups,
    )
    return _enlarge(layer_list, call, enlarging)


def upsample(layer_list: LayerList, call: Call) -> str:
    mode = call["mode"]
    expect_form(mode in ("nearest", "nearest-exact", "bilinear"), f"mode {mode!r}")
    expect_form(not call["antialias"], "antialias")
    channels, *sides = layer_list.shape(call["input"])
    expect_form(len(sides) == 2, "an upsampling of a vector")
    size = call["size"]
    if size is not None and sides == [1, 1]:  # the number of the only place, everywhere
        return layer_list.add("expand", call, size=_pair(size))
    if size is not None:
        factors = [wanted / side for wanted, side in zip(_pair(size), sides, strict=True)]
    else:
        scale = call["scale_factor"]
        factors = [float(f) for f in (scale if isinstance(scale, (tuple, list)) else (scale,) * 2)]
    is_whole = factors[0] == factors[1] and factors[0].is_integer()
    expect_form(is_whole, f"an upsampling by {factors}, not by one whole number,")
    factor = int(factors[0])
    if factor == 1:
        return layer_list.source(call["input"])
    if call["align_corners"]:
        return layer_list.add("bilinear_corners", call, block=factor)
    if mode != "bilinear":
        return _enlarge(layer_list, call, nearest(channels, factor))
    padded = layer_list.add("edge_pad", call, padding=EDGE)
    return _enlarge(layer_list, call, bilinear(channels, factor), padded)


def pad(layer_list: LayerList, call: Call) -> str:
    """Add a padding for F.pad, which has left, right, top and bottom in this order."""
    pads = list(call["pad"])
    fits = len(pads) == 4 and all(isinstance(n, int) and n >= 0 for n in pads)
    expect_form(fits, f"a padding of {pads}")
    left, right, top, bottom = pads
    padding = [top, left, bottom, right]
    if call["mode"] == "replicate":
        return layer_list.add("edge_pad", call, padding=padding)
    is_zero = call["mode"] == "constant" and not call["value"]
    expect_form(is_zero, f"mode {call['mode']!r} with the value {call['value']}")
    return layer_list.add("zero_pad", call, padding=padding)


def pad_module(op: str) -> Rule:
    """The rule of a module that pads, whose `padding` is left, right, top and bottom."""

    def rule(layer_list: LayerList, call: Call) -> str:
        left, right, top, bottom = call["padding"]
        fits = min(call["padding"]) >= 0 and not call.arguments.get("value")
        expect_form(fits, f"a padding of {call['padding']} with a value")
        return layer_list.add(op, call, padding=[top, left, bottom, right])

    return rule


def _enlarge(
    layer_list: LayerList, call: Call, enlarging: Enlarging, source: str | None = None
) -> str:
    """Add the convolution and the blocks of a layer by which a map grows.

    source : the layer of the map; by default the call's input.
    """
    # no module's tensor has () in its name
    prefix = f"{layer_list.prefix}{call.node.name}()"
    weights = {}
    for role, values in (("weight", enlarging.weight), ("bias", enlarging.bias)):
        if values is not None:
            weights[role] = f"{prefix}.{role}"
            layer_list.weights[weights[role]] = values
    sources = [call["input"] if source is None else source]
    spread = layer_list.add("conv", call, sources, weights=weights, **enlarging.conv)
    if enlarging.block == 1:
        return spread
    return layer_list.add("depth_to_space", call, [spread], block=enlarging.block)


def linear(layer_list: LayerList, call: Call) -> str:
    if call["input"] in layer_list.channels_last:
        return linear_of_last(layer_list, call, call.module.weight, call.module.bias)
    weights = layer_list.tensors(call, weight="weight", bias="bias")
    return layer_list.add("dense", call, weights=weights)


def linear_function(layer_list: LayerList, call: Call) -> str:
    """Add a dense layer for F.linear, whose weights are tensors of the module."""
    if call["input"] in layer_list.channels_last:
        return linear_of_last(layer_list, call, call["weight"], call["bias"])
    weights = layer_list.constants(call, weight="weight", bias="bias")
    return layer_list.add("dense", call, weights=weights)


def batch_norm(layer_list: LayerList, call: Call) -> str:
    module = call.module
    if module is None:
        return _batch_norm_function(layer_list, call)
    uses_statistics = module.running_mean is not None and not module.training
    expect_form(uses_statistics, "a batch norm that does not use running statistics")
    weights = layer_list.tensors(
        call, mean="running_mean", variance="running_var", weight="weight", bias="bias"
    )
    return layer_list.add("batch_norm", call, weights=weights, epsilon=module.eps)


def _batch_norm_function(layer_list: LayerList, call: Call) -> str:
    """Add a batch norm for F.batch_norm, whose tensors are attributes of the module."""
    uses_statistics = call["running_mean"] is not None and not call["training"]
    expect_form(uses_statistics, "a batch norm that does not use running statistics")
    weights = layer_list.constants(
        call, mean="running_mean", variance="running_var", weight="weight", bias="bias"
    )
    return layer_list.add("batch_norm", call, weights=weights, epsilon=float(call["eps"]))


# -- activations -----------------------------------------------------------------------------------


def leaky_relu(layer_list: LayerList, call: Call) -> str:
    return layer_list.add("leaky_relu", call, slope=float(call["negative_slope"]))


def absolute(layer_list: LayerList, call: Call) -> str:
    """Add a leaky ReLU of slope -1 for |x|."""
    return layer_list.add("leaky_relu", call, slope=-1.0)


def prelu(layer_list: LayerList, call: Call) -> str:
    return layer_list.add("prelu", call, weights=layer_list.tensors(call, slope="weight"))


def clamp(layer_list: LayerList, call: Call) -> str:
    return _clip(layer_list, call, call["min"], call["max"])


def hardtanh(layer_list: LayerList, call: Call) -> str:
    return _clip(layer_list, call, call["min_val"], call["max_val"])


def _clip(layer_list: LayerList, call: Call, low: Any, high: Any) -> str:
    for value in (low, high):
        expect_form(value is None or isinstance(value, (int, float)), "a limit that is no number")
    return layer_list.add("clip", call, low=low, high=high)


def softshrink(layer_list: LayerList, call: Call) -> str:
    return layer_list.add("softshrink", call, [call["input"]], lambd=float(call["lambd"]))


def gelu(layer_list: LayerList, call: Call) -> str:
    approximate = call["approximate"]
    expect_form(approximate in ("none", "tanh"), f"approximate {approximate!r}")
    return layer_list.add("gelu" if approximate == "none" else "gelu_tanh", call)


# -- pooling ---------------------------------------------------------------------------------------


def max_pool(layer_list: LayerList, call: Call) -> str:
    expect_form(_pair(call["dilation"]) == [1, 1], "dilation")
    expect_form(not call.arguments.get("return_indices"), "return_indices")
    return _pool(layer_list, call, "max_pool")


def average_pool(layer_list: LayerList, call: Call) -> str:
    if call["divisor_override"] is not None:
        expect_form(call["divisor_override"] == 1, "divisor_override")
        return _pool(layer_list, call, "sum_pool")
    is_padded = any(_pair(call["padding"]))
    is_counted = bool(call["count_include_pad"])
    can_count = not (call["ceil_mode"] and is_padded and is_counted)
    expect_form(can_count, "ceil_mode with padding that counts")
    if call["ceil_mode"] or (is_padded and not is_counted):
        return _pool(layer_list, call, "inside_average_pool")
    return _pool(layer_list, call, "average_pool")


def _pool(layer_list: LayerList, call: Call, op: str) -> str:
    kernel = _pair(call["kernel_size"])
    stride = _pair(call["stride"] or call["kernel_size"])
    padding = 2 * _pair(call["padding"])
    if call["ceil_mode"]:
        sides = layer_list.shape(call["input"])[1:]
        expect_form(len(sides) == 2, "a pooling of a vector")
        for axis, side in enumerate(sides):
            needed = padding_of_ceil_mode(side, kernel[axis], stride[axis], padding[axis])
            padding[2 + axis] = max(padding[2 + axis], needed)
    return layer_list.add(op, call, kernel=kernel, stride=stride, padding=padding)


def adaptive_pool(layer_list: LayerList, call: Call) -> str:
    size = call["output_size"]
    if size in (1, (1, 1), [1, 1]):
        return layer_list.add("global_average_pool", call)
    wanted_sides = size if isinstance(size, (tuple, list)) else (size, size)
    sides = layer_list.shape(call["input"])[1:]
    expect_form(len(sides) == len(wanted_sides) == 2, f"an output size of {size} here")
    if wanted_sides[0] is None and wanted_sides[1] is None:
        return same_layer(layer_list, call)
    sizes = [n or side for n, side in zip(wanted_sides, sides, strict=True)]  # None keeps the side
    return layer_list.add("adaptive_average_pool", call, size=sizes)


def mean(layer_list: LayerList, call: Call) -> str:
    axes = call["dim"]
    if isinstance(axes, (tuple, list)):
        axes = sorted(axis % 4 for axis in axes)
    expect_form(axes == [2, 3], f"a mean over {axes}, not over all places (2, 3),")
    pooled = layer_list.add("global_average_pool", call)
    if call["keepdim"]:
        return pooled
    return layer_list.add("flatten", call, [pooled])


# -- passed on -------------------------------------------------------------------------------------


def dropout(layer_list: LayerList, call: Call) -> str:
    expect_form(not call["training"], "a dropout in training mode, also in evaluation,")
    return same_layer(layer_list, call)
