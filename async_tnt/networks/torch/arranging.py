"""The rules of torch calls that join maps, or arrange their numbers in another way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import fx

from async_tnt.base.messages import short
from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.picking import picked, sum_weight
from async_tnt.networks.torch.layers import Call, Grouped, LayerList, float_array

# -- sums, products, concatenations ----------------------------------------------------------------


def add(layer_list: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None:
        return layer_list.add("add", call, [call["input"], call["other"]])
    return _affine(layer_list, call, x, bias=constant)


def subtract(layer_list: LayerList, call: Call) -> str:
    """Add the layers of a difference: the sum with the negative of the second operand."""
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    minus_one = torch.tensor(-1.0, dtype=torch.float64)
    if constant is not None and x is call["input"]:
        return _affine(layer_list, call, x, bias=-constant)
    if constant is not None:
        return _affine(layer_list, call, x, weight=minus_one, bias=constant)
    negative = _affine(layer_list, call, call["other"], weight=minus_one)
    return layer_list.add("add", call, [call["input"], negative])


def negative(layer_list: LayerList, call: Call) -> str:
    minus_one = torch.tensor(-1.0, dtype=torch.float64)
    return _affine(layer_list, call, call["input"], weight=minus_one)


def multiply(layer_list: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None:
        return layer_list.add("multiply", call, [call["input"], call["other"]])
    return _affine(layer_list, call, x, weight=constant)


def divide(layer_list: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"] or call.arguments.get("rounding_mode"):
        raise NotImplementedError("a quotient other than a map by a constant has no compiled form")
    expect_form(bool((constant != 0).all()), "a quotient by zero")
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
    if x in layer_list.channels_last:
        channel_shape = [channels]
    weights = {}
    for role, values in constants.items():
        shape = list(values.shape)
        while shape[:1] == [1]:
            del shape[0]
        # a constant of more axes would give the value more axes
        fits = values.dim() <= 2 + len(sides) and shape in ([], channel_shape)
        expect_form(fits, f"a constant of shape {list(values.shape)} here")
        # no module's tensor has () in its name
        name = f"{layer_list.prefix}{call.node.name}().{role}"
        weights[role] = name
        layer_list.weights[name] = float_array(values.reshape(-1).expand(channels))
    return layer_list.add("batch_norm", call, [x], weights=weights, epsilon=0.0)


def sum_of_channels(layer_list: LayerList, call: Call) -> str:
    """Add a convolution of one place for x.sum(1, keepdim=True), or a sum for stack(...).sum(0)."""
    axes = call["dim"]
    parts = layer_list.parts.get(call["input"])
    if parts is not None and axes in (0, (0,), [0]) and not call["keepdim"]:
        stacked = [part for part in parts if part is not None]
        return stacked[0] if len(stacked) == 1 else layer_list.add("add", call, stacked)
    channels, *sides = layer_list.shape(call["input"])
    is_known = axes in (1, (1,), [1], -3) and call["keepdim"] and len(sides) == 2
    expect_form(is_known, f"a sum over {axes}, not of the channels of a map (1, keepdim),")
    # no module's tensor has () in its name
    name = f"{layer_list.prefix}{call.node.name}().weight"
    weight, parameters = sum_weight(channels)
    layer_list.weights[name] = weight
    return layer_list.add("conv", call, weights={"weight": name}, **parameters)


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
    """Take a part of a tuple, or add the layers of x[:, a:b, c:d:m, e:f:n]."""
    parts = layer_list.parts.get(call["input"])
    if parts is not None:
        place = call["index"]
        is_there = isinstance(place, int) and -len(parts) <= place < len(parts)
        part: str | None = parts[place] if is_there else None
        expect_form(part is not None, f"the index {short(place)}")
        return cast("str", part)

    channels, *sides = layer_list.shape(call["input"])
    given = call["index"] if isinstance(call["index"], tuple) else (call["index"],)
    n_axes = 2 + len(sides)
    if Ellipsis in given:
        place = given.index(Ellipsis)
        left_out = [slice(None)] * (n_axes - len(given) + 1)
        given = (*given[:place], *left_out, *given[place + 1 :])
    slices = [*given, *[slice(None)] * (n_axes - len(given))]
    are_slices = all(isinstance(part, slice) and part.step != 0 for part in slices)
    expect_form(are_slices and len(slices) == n_axes, f"the index {short(given)}")
    taken = [range(n)[part] for n, part in zip((1, channels, *sides), slices, strict=True)]
    are_there = all(len(one) > 0 and one.step > 0 for one in taken)
    expect_form(are_there, f"the index {short(given)}")
    source = layer_list.source(call["input"])
    if len(taken[1]) < channels:
        source = layer_list.add("pick", call, [source], channels=list(taken[1]))
    if [len(one) for one in taken[2:]] == sides:
        return source
    return _pick_places(layer_list, call, source, taken[2:], sides)


def _pick_places(
    layer_list: LayerList, call: Call, source: str, taken: Sequence[range], sides: Sequence[int]
) -> str:
    """Add a convolution that takes some rows and columns.

    Parameters
    ----------
    taken : the rows, and the columns.
    sides : how many rows and columns there are.
    """
    channels = layer_list.shape(source)[0]
    start = [one.start for one in taken]
    step = [one.step for one in taken]
    dropped = [side - 1 - one[-1] for one, side in zip(taken, sides, strict=True)]
    weight, parameters = picked(channels, start, step, dropped)
    # no module's tensor has () in its name
    name = f"{layer_list.prefix}{call.node.name}().weight"
    layer_list.weights[name] = weight
    return layer_list.add("conv", call, [source], weights={"weight": name}, **parameters)


def stack(layer_list: LayerList, call: Call) -> str:
    """Note the parts of torch.stack([...]), which `sum_of_channels` adds: no layer is added."""
    expect_form(call["dim"] == 0, f"a stack along axis {call['dim']}, not 0,")
    is_known = isinstance(call["tensors"], (tuple, list)) and call.written is None
    expect_form(is_known, "this stack")
    parts = [layer_list.source(one) for one in call["tensors"]]
    layer_list.parts[call.node] = [*parts]
    return parts[0]


def chunk(layer_list: LayerList, call: Call) -> str:
    """Add a layer for each part of the channels; returns the first part."""
    channels = layer_list.shape(call["input"])[0]
    is_number = isinstance(call["chunks"], int) and call["chunks"] > 0
    expect_form(is_number, f"a chunk into {short(call['chunks'])}")
    size = math.ceil(channels / call["chunks"])
    return _divide(layer_list, call, [size] * call["chunks"])


def split(layer_list: LayerList, call: Call) -> str:
    """Add a layer for each part of the channels; returns the first part."""
    channels = layer_list.shape(call["input"])[0]
    sizes = call["sizes"]
    expect_form(sizes != 0 and sizes != [], "a split into nothing")
    if isinstance(sizes, int):
        sizes = [sizes] * math.ceil(channels / sizes)
    return _divide(layer_list, call, sizes)


def _divide(layer_list: LayerList, call: Call, sizes: Sequence[int]) -> str:
    """Add a layer for each part of the channels.

    sizes : how many channels each part has; the last part may have fewer.
    """
    axis = call["dim"]
    expect_form(axis in (1, -3), f"a division along axis {axis}, not of channels (1),")
    channels = layer_list.shape(call["input"])[0]
    are_sizes = all(isinstance(size, int) and size >= 0 for size in sizes)
    expect_form(are_sizes and sum(sizes) >= channels, f"a division into {short(list(sizes))}")
    parts: list[str | None] = []
    first = 0
    for size in sizes:
        taken = list(range(first, min(first + size, channels)))
        # a part without channels has no layer
        part = layer_list.add("pick", call, [call["input"]], channels=taken) if taken else None
        parts.append(part)
        first += size
    while parts[-1] is None:  # torch.chunk makes no empty parts at the end
        parts.pop()
    layer_list.parts[call.node] = parts
    return next(part for part in parts if part is not None)


def shuffle_channels(layer_list: LayerList, call: Call) -> str:
    """Add a layer for nn.ChannelShuffle."""
    return _shuffled(layer_list, call, layer_list.source(call["input"]), call["groups"])


def _shuffled(layer_list: LayerList, call: Call, source: str, groups: int) -> str:
    """Add a layer that takes the first channel of each group, then the second of each, ..."""
    channels = layer_list.shape(source)[0]
    is_divided = groups > 0 and channels % groups == 0
    expect_form(is_divided, f"a shuffle of {channels} channels in {groups} groups")
    in_order = torch.arange(channels).reshape(groups, -1).T.reshape(-1)
    return layer_list.add("pick", call, [source], channels=in_order.tolist())


def flatten(layer_list: LayerList, call: Call) -> str:
    first = call["start_dim"]
    last = call["end_dim"]
    is_whole = (first, last) == (1, -1)
    expect_form(is_whole, f"a flatten from axis {first} to {last}, not from 1 to -1,")
    return layer_list.add("flatten", call)


def view(layer_list: LayerList, call: Call) -> str:
    """Add a flatten for x.view(1, m), or the layer of a channel shuffle.

    A shuffle is x.view(1, g, c, h, w).transpose(1, 2).reshape(1, g c, h, w). Its first view only
    notes the groups, and the second one adds the layer.
    """
    own_shape = layer_list.shape(call["input"])
    n = math.prod(own_shape)
    shape = call["shape"]
    are_numbers = all(isinstance(side, int) for side in shape)
    expect_form(are_numbers, "a view to sizes that are computed from numbers")
    known = math.prod(side for side in shape if side != -1)
    if known and n % known == 0:
        shape = tuple(n // known if side == -1 else side for side in shape)
    source = layer_list.source_of_view(call["input"])
    grouped = layer_list.grouped.get(call["input"])
    if shape == (1, n):
        expect_form(grouped is None, "a view of a transposed view")
        return layer_list.add("flatten", call)
    if shape == (1, *own_shape):
        if grouped is None:
            return source
        expect_form(grouped.is_transposed, "a view of a view")
        return _shuffled(layer_list, call, source, grouped.groups)
    is_grouped = len(shape) == 5 and shape[3:] == own_shape[1:] and shape[0] == 1
    expect_form(is_grouped and grouped is None, "a view other than (n, -1), one row a volume,")
    layer_list.grouped[call.node] = Grouped(shape[1])
    return source


def transpose(layer_list: LayerList, call: Call) -> str:
    """Note that the groups of channels are transposed, see `view`."""
    grouped = layer_list.grouped.get(call["input"])
    axes = {call["dim0"], call["dim1"]}
    is_known = grouped is not None and not grouped.is_transposed and axes == {1, 2}
    expect_form(is_known, "a transposition")
    assert grouped is not None
    layer_list.grouped[call.node] = Grouped(grouped.groups, is_transposed=True)
    return layer_list.source_of_view(call["input"])


def view_arguments(node: fx.Node) -> dict[str, Any]:
    """The shape of a view, which may be given as numbers, as a list, or by name."""
    shape = node.args[1:] or tuple(node.kwargs.values())
    if isinstance(shape[0], (tuple, list)):
        shape = tuple(shape[0])
    return {"input": node.args[0], "shape": shape}
