"""The rules by which calls of torch's operations become layers."""

from __future__ import annotations

import operator
from typing import Any

import torch
from torch import fx

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.enlarging import (
    EDGE,
    Enlarging,
    bilinear,
    nearest,
    transposed_convolution,
)
from async_tnt.networks.layers.picking import picked
from async_tnt.networks.layers.uneven_windows import padding_of_ceil_mode
from async_tnt.networks.torch.form import Rule, same_layer
from async_tnt.networks.torch.layers import Call, LayerList, float_array


def _pair(value: Any) -> list[int]:
    """A parameter of torch as sides [y, x]. Torch also accepts one number for both sides."""
    if isinstance(value, (tuple, list)):
        return [int(v) for v in value]
    return [int(value), int(value)]


# -- with weights ----------------------------------------------------------------------------------


def conv(layer_list: LayerList, call: Call) -> str:
    module = call.module
    expect_form(module.padding_mode == "zeros", f"padding_mode {module.padding_mode!r}")
    kernel = _pair(module.kernel_size)
    dilation = _pair(module.dilation)
    if module.padding == "same":
        # if the padding is odd, torch puts the extra place at the end
        total_padding = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        before = [n // 2 for n in total_padding]
        after = [n - n // 2 for n in total_padding]
        padding = before + after
    elif module.padding == "valid":
        padding = [0, 0, 0, 0]
    else:
        padding = 2 * _pair(module.padding)
    return layer_list.add(
        "conv",
        call,
        weights=layer_list.tensors(call, weight="weight", bias="bias"),
        kernel=kernel,
        stride=_pair(module.stride),
        padding=padding,
        dilation=dilation,
        groups=module.groups,
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
    expect_form(not call["align_corners"], "align_corners")
    expect_form(not call["antialias"], "antialias")
    channels, *sides = layer_list.shape(call["input"])
    expect_form(len(sides) == 2, "an upsampling of a vector")
    size = call["size"]
    if size is not None:
        factors = [wanted / side for wanted, side in zip(_pair(size), sides, strict=True)]
    else:
        scale = call["scale_factor"]
        factors = [float(f) for f in (scale if isinstance(scale, (tuple, list)) else (scale,) * 2)]
    is_whole = factors[0] == factors[1] and factors[0].is_integer()
    expect_form(is_whole, f"an upsampling by {factors}, not by one whole number,")
    factor = int(factors[0])
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
    return layer_list.add(
        "dense", call, weights=layer_list.tensors(call, weight="weight", bias="bias")
    )


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
    roles = {"mean": "running_mean", "variance": "running_var", "weight": "weight", "bias": "bias"}
    weights = {}
    for role, argument in roles.items():
        tensor = call[argument]
        if tensor is None:
            continue
        expect_form(isinstance(tensor, torch.Tensor), f"a {argument} that is computed")
        weights[role] = f"{layer_list.prefix}{call.node.name}().{role}"
        layer_list.weights[weights[role]] = float_array(tensor)
    return layer_list.add("batch_norm", call, weights=weights, epsilon=float(call["eps"]))


# -- activations -----------------------------------------------------------------------------------


def leaky_relu(layer_list: LayerList, call: Call) -> str:
    return layer_list.add("leaky_relu", call, slope=float(call["negative_slope"]))


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


# -- sums, products, concatenations ----------------------------------------------------------------


def add(layer_list: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None:
        return layer_list.add("add", call, [call["input"], call["other"]])
    return _affine(layer_list, call, x, bias=constant)


def subtract(layer_list: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"]:
        raise NotImplementedError(
            "a difference other than a map less a constant has no compiled form"
        )
    return _affine(layer_list, call, x, bias=-constant)


def multiply(layer_list: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None:
        raise NotImplementedError("a product of two maps has no compiled form")
    return _affine(layer_list, call, x, weight=constant)


def divide(layer_list: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"] or call.arguments.get("rounding_mode"):
        raise NotImplementedError("a quotient other than a map by a constant has no compiled form")
    return _affine(layer_list, call, x, weight=1 / constant)


def _with_constant(call: Call) -> tuple[Any, torch.Tensor | None]:
    """The operand that is computed from the volume, and the other one if it is a constant.

    The second value is None if the other operand is computed from the volume, too.
    """
    x = call["input"]
    other = call["other"]
    if isinstance(other, fx.Node):
        x, other = other, x
    if isinstance(other, (int, float)):
        return x, torch.tensor(float(other), dtype=torch.float64)
    if isinstance(other, torch.Tensor):
        return x, other.detach()
    return x, None


def _affine(layer_list: LayerList, call: Call, x: Any, **constants: torch.Tensor) -> str:
    """Add a batch norm that adds a constant `bias` to x, or multiplies x by a constant `weight`.

    The constant has one number, or one for each channel. Returns the name of the layer.
    """
    constants |= {"mean": torch.zeros(1), "variance": torch.ones(1)}
    channels, *sides = layer_list.shape(x)
    channel_shape = [channels, *[1] * len(sides)]
    weights = {}
    for role, values in constants.items():
        shape = list(values.shape)
        while shape[:1] == [1]:
            del shape[0]
        expect_form(shape in ([], channel_shape), f"a constant of shape {list(values.shape)} here")
        name = (
            f"{layer_list.prefix}{call.node.name}().{role}"  # no module's tensor has () in its name
        )
        weights[role] = name
        layer_list.weights[name] = float_array(values.reshape(-1).expand(channels))
    return layer_list.add("batch_norm", call, [x], weights=weights, epsilon=0.0)


def concatenate(layer_list: LayerList, call: Call) -> str:
    axis = call["dim"]
    expect_form(axis in (1, -3), f"a concatenation along axis {axis}, not of channels (1),")
    expect_form(isinstance(call["tensors"], (tuple, list)), "a concatenation of other than a list")
    if len(call["tensors"]) == 1:
        return layer_list.source(call["tensors"][0])
    return layer_list.add("concat", call, call["tensors"])


# -- the order of numbers --------------------------------------------------------------------------


def pixel_shuffle(layer_list: LayerList, call: Call) -> str:
    return layer_list.add("depth_to_space", call, block=call["upscale_factor"])


def index(layer_list: LayerList, call: Call) -> str:
    """Add a convolution for x[..., a::m, b::n]."""
    channels, *sides = layer_list.shape(call["input"])
    given = call["index"] if isinstance(call["index"], tuple) else (call["index"],)
    n_axes = 2 + len(sides)
    if Ellipsis in given:
        place = given.index(Ellipsis)
        left_out = [slice(None)] * (n_axes - len(given) + 1)
        given = (*given[:place], *left_out, *given[place + 1 :])
    slices = [*given, *[slice(None)] * (n_axes - len(given))]
    is_known = len(slices) == 4 and all(_is_slice_to_the_end(part) for part in slices)
    expect_form(is_known, f"the index {given}")
    start = [part.start or 0 for part in slices]
    step = [part.step or 1 for part in slices]
    is_inside = all(first < side for first, side in zip(start[2:], sides, strict=True))
    is_of_places = start[:2] == [0, 0] and step[:2] == [1, 1]
    expect_form(is_of_places and is_inside, f"the index {given}")
    weight, parameters = picked(channels, start[2:], step[2:])
    # no module's tensor has () in its name
    name = f"{layer_list.prefix}{call.node.name}().weight"
    layer_list.weights[name] = weight
    return layer_list.add("conv", call, weights={"weight": name}, **parameters)


def _is_slice_to_the_end(part: Any) -> bool:
    """Whether an index is a slice like 1::2, without an end and of whole numbers."""
    if not isinstance(part, slice) or part.stop is not None:
        return False
    start_fits = part.start is None or (isinstance(part.start, int) and part.start >= 0)
    return start_fits and (part.step is None or (isinstance(part.step, int) and part.step >= 1))


def flatten(layer_list: LayerList, call: Call) -> str:
    first = call["start_dim"]
    last = call["end_dim"]
    is_whole = (first, last) == (1, -1)
    expect_form(is_whole, f"a flatten from axis {first} to {last}, not from 1 to -1,")
    return layer_list.add("flatten", call)


def view(layer_list: LayerList, call: Call) -> str:
    """Add a flatten for x.view(n, m), where n is the batch size, 1 or -1, and m a whole number.

    `check_torch_layers` finds out whether m fits.
    """
    shape = call["shape"]
    n, m = shape if len(shape) == 2 else (None, None)
    is_one_row = n in (1, -1) or _is_batch_size(n)
    expect_form(isinstance(m, int) and is_one_row, "a view other than (n, -1), one row a volume,")
    return layer_list.add("flatten", call)


def view_arguments(node: fx.Node) -> dict[str, Any]:
    """The shape of a view, which may be given as numbers, as a list, or by name."""
    shape = node.args[1:] or tuple(node.kwargs.values())
    if isinstance(shape[0], (tuple, list)):
        shape = tuple(shape[0])
    return {"input": node.args[0], "shape": shape}


def _is_batch_size(node: Any) -> bool:
    """Whether a node is x.size(0), x.size()[0] or x.shape[0]."""
    if not isinstance(node, fx.Node):
        return False
    if node.target is operator.getitem:
        sizes, index = node.args
        if not isinstance(sizes, fx.Node) or index != 0:
            return False
        return sizes.target is getattr or len(sizes.args) == 1
    return node.target == "size" and list(node.args[1:]) == [0]


def dropout(layer_list: LayerList, call: Call) -> str:
    expect_form(not call["training"], "a dropout in training mode, also in evaluation,")
    return same_layer(layer_list, call)
