"""The rules of ONNX nodes that join maps, or arrange their numbers in another way."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.layers.picking import picked, sum_weight
from async_tnt.networks.onnx.layers import (
    FlatGroups,
    Grouped,
    Node,
    OnnxLayers,
    without_leading_ones,
)
from async_tnt.networks.onnx.norms import transpose_channels

# -- sums, products, concatenations ----------------------------------------------------------------


def add(onnx_layers: OnnxLayers, node: Node) -> None:
    n_constants = sum(name in onnx_layers.constants for name in node.inputs)
    if n_constants == 0:
        onnx_layers.add(node, "add", node.inputs)
        return
    expect_form(
        (len(node.inputs), n_constants) == (2, 1),
        "a sum other than of one map and a constant, or of maps,",
    )
    _affine(onnx_layers, node, role="bias")


def multiply(onnx_layers: OnnxLayers, node: Node) -> None:
    n_constants = sum(name in onnx_layers.constants for name in node.inputs)
    if n_constants == 0:
        _product(onnx_layers, node)
        return
    expect_form(n_constants == 1, "a product of constants")
    _affine(onnx_layers, node, role="weight")


def _affine(onnx_layers: OnnxLayers, node: Node, *, role: str) -> None:
    """Add a batch norm for a node that adds a constant, or multiplies by a constant.

    role : the constant's role in the batch norm: "bias" is added, "weight" multiplies.
    """
    (constant,) = [
        onnx_layers.constants[name] for name in node.inputs if name in onnx_layers.constants
    ]
    (source,) = [name for name in node.inputs if name not in onnx_layers.constants]
    _scale(onnx_layers, node, source, **{role: constant})


def _scale(onnx_layers: OnnxLayers, node: Node, source: str, **constants: np.ndarray) -> None:
    """Add a batch norm that multiplies by a constant `weight`, or adds a constant `bias`.

    Each constant has one number, or one for each channel.
    """
    n_channels, *sides_of_map = onnx_layers.shape(source)
    channel_shape = (n_channels, *[1] * len(sides_of_map))
    if source in onnx_layers.channels_last:
        channel_shape = (n_channels,)
    zeros = np.zeros(n_channels, onnx_layers.dtype)
    tensors = {"mean": zeros, "variance": zeros + 1}
    for role, constant in constants.items():
        # a constant of more axes would give the value more axes
        fits = constant.ndim <= 2 + len(sides_of_map)
        fits &= without_leading_ones(constant.shape) in ((), channel_shape)
        expect_form(fits, f"a constant of shape {constant.shape} here")
        tensors[role] = np.broadcast_to(constant.reshape(-1), n_channels)
    weights = {
        role: onnx_layers.tensor(f"{node.outputs[0]}.{role}", values)
        for role, values in tensors.items()
    }
    onnx_layers.add(node, "batch_norm", [source], weights=weights, epsilon=0.0)


def subtract(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add the layers of a difference: the sum with the negative of the second operand."""
    first, second = node.inputs
    if second in onnx_layers.constants:
        expect_form(first not in onnx_layers.constants, "a difference of constants")
        _scale(onnx_layers, node, first, bias=-onnx_layers.floating(second))
        return
    constant = onnx_layers.constants.get(first)
    minus_one = np.array(-1, onnx_layers.dtype)
    if constant is not None:
        _scale(onnx_layers, node, second, weight=minus_one, bias=constant)
        return
    _scale(onnx_layers, node, second, weight=minus_one)
    onnx_layers.add(node, "add", [first, node.outputs[0]])


def negative(onnx_layers: OnnxLayers, node: Node) -> None:
    _scale(onnx_layers, node, node.inputs[0], weight=np.array(-1, onnx_layers.dtype))


def divide(onnx_layers: OnnxLayers, node: Node) -> None:
    first, second = node.inputs
    is_known = second in onnx_layers.constants and first not in onnx_layers.constants
    expect_form(is_known, "a quotient other than of a map by a constant")
    constant = onnx_layers.floating(second)
    expect_form(bool((constant != 0).all()), "a quotient by zero")
    inverse = 1 / constant
    _scale(onnx_layers, node, first, weight=inverse.astype(onnx_layers.dtype))


def _product(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a product of two maps. For x sigmoid(x), as torch exports it, it is a silu."""
    for x, factor in (node.inputs, node.inputs[::-1]):
        layer = onnx_layers.layer_of(factor)
        if layer["op"] == "sigmoid" and layer["inputs"] == [onnx_layers.layer_name(x)]:
            onnx_layers.add(node, "silu", [x])
            return
    onnx_layers.add(node, "multiply", node.inputs)


def sum_of_channels(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a convolution of one place for the sum of the channels at each place.

    The sum of stacked maps becomes their sum.
    """
    axes = _axes(onnx_layers, node)
    if node.inputs[0] in onnx_layers.stacked:
        expect_form(axes == [0] and not node.get("keepdims", 1), "a sum of this stack")
        parts = onnx_layers.stacked[node.inputs[0]]
        if len(parts) == 1:
            onnx_layers.alias(node, parts[0])
        else:
            onnx_layers.add(node, "add", parts)
        return
    channels, *sides = onnx_layers.shape(node.inputs[0])
    is_known = list(axes or []) in ([1], [-3]) and len(sides) == 2 and node.get("keepdims", 1)
    expect_form(bool(is_known), f"a sum over axes {axes}, not of the channels of a map (1),")
    weight, parameters = sum_weight(channels)
    name = onnx_layers.tensor(f"{node.outputs[0]}.weight", weight.astype(onnx_layers.dtype))
    onnx_layers.add(node, "conv", node.inputs[:1], weights={"weight": name}, **parameters)


def _axes(onnx_layers: OnnxLayers, node: Node) -> list[int] | None:
    """The axes of a node: an attribute, or from opset 13 on an input."""
    axes = node.get("axes")
    if axes is None:
        given = onnx_layers.constant(node, 1)
        axes = None if given is None else given.reshape(-1)
    return None if axes is None else [int(axis) for axis in axes]


def unsqueeze(onnx_layers: OnnxLayers, node: Node) -> None:
    """Note a map that gets a first axis, along which maps are stacked: no layer is added."""
    (source, *_) = node.inputs
    is_map = len(onnx_layers.shape(source)) == 3 and source not in onnx_layers.channels_last
    is_known = is_map and source not in onnx_layers.grouped
    expect_form(is_known and _axes(onnx_layers, node) == [0], "an axis here")
    onnx_layers.stacked[node.outputs[0]] = [source]


def concat(onnx_layers: OnnxLayers, node: Node) -> None:
    axis = node.get("axis")
    if all(name in onnx_layers.stacked for name in node.inputs):
        expect_form(axis == 0, "a stack of stacks")
        parts = [part for name in node.inputs for part in onnx_layers.stacked[name]]
        onnx_layers.stacked[node.outputs[0]] = parts
        return
    expect_form(axis in (1, -3), f"axis {axis}, not channels (1),")
    if len(node.inputs) == 1:
        onnx_layers.alias(node, node.inputs[0])
        return
    onnx_layers.add(node, "concat", node.inputs)


# -- the order of numbers --------------------------------------------------------------------------


def depth_to_space(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a depth_to_space, after the channels are brought into its order.

    In the mode DCR, channel (i block + j) C + c becomes channel c of row i, column j of a block.
    """
    block = node.get("blocksize")
    sources = node.inputs[:1]
    if node.get("mode", "DCR") == "DCR":
        channels = np.arange(onnx_layers.shape(sources[0])[0])
        expect_form(channels.size % block**2 == 0, f"blocks of {block} of {channels.size} channels")
        in_order = channels.reshape(block**2, -1).T.reshape(-1)
        onnx_layers.add(node, "pick", sources, channels=in_order.tolist())
        sources = node.outputs
    onnx_layers.add(node, "depth_to_space", sources, block=block)


def cut(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add the layers of a Slice, which takes some channels, rows and columns."""
    names = ("starts", "ends", "axes", "steps")
    if onnx_layers.opset < 10:
        parts = [node.get(name) for name in names]
    else:
        constants = [onnx_layers.constant(node, 1 + k) for k in range(4)]
        parts = [None if values is None else values.tolist() for values in constants]
    starts, ends, axes, steps = parts
    expect_form(starts is not None and ends is not None, "a Slice without starts or ends")
    shape = (1, *onnx_layers.shape(node.inputs[0]))
    axes = list(range(len(starts))) if axes is None else axes
    steps = [1] * len(starts) if steps is None else steps
    taken = [range(side) for side in shape]
    for axis, first, end, every in zip(axes, starts, ends, steps, strict=True):
        expect_form(every >= 1, f"a Slice by steps of {every}")
        expect_form(-len(shape) <= axis < len(shape), f"a Slice of axis {axis}")
        taken[axis] = range(shape[axis])[slice(first, end, every)]
    expect_form(all(len(one) > 0 for one in taken), "a Slice that takes nothing")
    _take(onnx_layers, node, taken)


def _take(onnx_layers: OnnxLayers, node: Node, taken: Sequence[range]) -> None:
    """Add the layers that take some channels, rows and columns.

    taken : what is taken along each axis: of the batch, of the channels and, for a map, of rows and
        columns.
    """
    sources = node.inputs[:1]
    channels, *sides = onnx_layers.shape(sources[0])
    if len(taken[1]) < channels:
        onnx_layers.add(node, "pick", sources, channels=list(taken[1]))
        sources = node.outputs
    if [len(one) for one in taken[2:]] == sides:
        onnx_layers.alias(node, sources[0])
        return
    dropped = [side - 1 - one[-1] for one, side in zip(taken[2:], sides, strict=True)]
    start = [one.start for one in taken[2:]]
    weight, parameters = picked(len(taken[1]), start, [one.step for one in taken[2:]], dropped)
    name = onnx_layers.tensor(f"{node.outputs[0]}.weight", weight.astype(onnx_layers.dtype))
    onnx_layers.add(node, "conv", sources, weights={"weight": name}, **parameters)


def split(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a layer for each part of the channels."""
    axis = node.get("axis", 0)
    expect_form(axis in (1, -3), f"a Split of axis {axis}, not of channels (1),")
    channels = onnx_layers.shape(node.inputs[0])[0]
    sizes = node.get("split")
    given = onnx_layers.constant(node, 1)
    if given is not None:
        sizes = given.tolist()
    if sizes is None:
        size = -(-channels // len(node.outputs))  # rounded up
        sizes = [size] * (len(node.outputs) - 1)
        sizes.append(channels - sum(sizes))
    fits = len(sizes) == len(node.outputs) and sum(sizes) == channels and min(sizes) > 0
    expect_form(fits, f"a Split of {channels} channels into {sizes}")
    first = 0
    for output, size in zip(node.outputs, sizes, strict=True):
        taken = list(range(first, first + size))
        onnx_layers.add_value(output, "pick", node.inputs[:1], {"channels": taken})
        first += size


def gather(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a layer that takes some channels."""
    shape = (1, *onnx_layers.shape(node.inputs[0]))
    axis = node.get("axis", 0)
    expect_form(axis % len(shape) == 1, f"a Gather of axis {axis}, not of channels (1),")
    indices = onnx_layers.constant(node, 1)
    expect_form(indices is not None and indices.ndim == 1, "a Gather of other than a list")
    assert indices is not None
    in_range = bool(((indices >= -shape[1]) & (indices < shape[1])).all())
    expect_form(in_range, f"a Gather of channels that {shape[1]} channels do not have")
    channels = [range(shape[1])[index] for index in indices.tolist()]
    onnx_layers.add(node, "pick", node.inputs[:1], channels=channels)


def flatten(onnx_layers: OnnxLayers, node: Node) -> None:
    axis = node.get("axis", 1)
    expect_form(axis == 1, f"axis {axis}, not 1,")
    onnx_layers.add(node, "flatten", node.inputs[:1])


def reshape(onnx_layers: OnnxLayers, node: Node) -> None:
    """Add a flatten for a reshape to (n, m), one row a volume, or the layer of a channel shuffle.

    A shuffle is a reshape of (n, g c, h, w) to (n, g, c, h, w), a transposition of the second and
    third axis, and a reshape back. The first reshape only notes the groups, and the second one adds
    the layer.
    """
    own_shape = onnx_layers.shape(node.inputs[0])
    target = onnx_layers.constant(node, 1)
    expect_form(target is not None and target.ndim == 1, "a reshape to a shape that is computed")
    assert target is not None
    shape = _new_shape(onnx_layers, node, target.tolist())
    source = node.inputs[0]
    grouped = onnx_layers.grouped.get(source)
    flat = onnx_layers.flat_groups.get(source)
    if flat is not None:
        is_whole = shape == (1, *own_shape) and flat.epsilon is not None
        expect_form(is_whole, f"a reshape of groups to {target.tolist()}")
        given = {"weights": {}, "groups": flat.groups, "epsilon": flat.epsilon}
        onnx_layers.add(node, "group_norm", [flat.source], **given)
    elif grouped is not None:
        is_shuffle = shape == (1, *own_shape) and grouped.is_transposed
        expect_form(is_shuffle, f"a reshape of groups of channels to {target.tolist()}")
        channels = np.arange(own_shape[0])
        in_order = channels.reshape(grouped.groups, -1).T.reshape(-1).tolist()
        onnx_layers.add(node, "pick", [grouped.source], channels=in_order)
    elif shape == (1, math.prod(own_shape)):
        onnx_layers.add(node, "flatten", node.inputs[:1])
    elif shape == (1, *own_shape):
        onnx_layers.alias(node, source)
    elif len(shape) == 3 and len(own_shape) == 3 and own_shape[0] % shape[1] == 0:
        onnx_layers.flat_groups[node.outputs[0]] = FlatGroups(source, shape[1])
    else:
        is_grouped = len(shape) == 5 and shape[3:] == own_shape[1:] and shape[0] == 1
        words = f"a reshape to {target.tolist()}, not (n, -1), one row a volume,"
        expect_form(is_grouped, words)
        onnx_layers.group(node, Grouped(source, shape[1]))


def _new_shape(onnx_layers: OnnxLayers, node: Node, target: list[int]) -> tuple[int, ...]:
    """The shape that a reshape gives, for one volume.

    Exported files may have the batch size of another number of volumes, or leave it open: the first
    side is that of one volume if the other sides hold all of its numbers.
    """
    own_shape = (1, *onnx_layers.shape(node.inputs[0]))
    n = math.prod(own_shape)
    sides = list(target)
    if not node.get("allowzero", 0):
        # 0 stands for the side of the input at the same place
        sides = [
            own_shape[k] if side == 0 and k < len(own_shape) else side
            for k, side in enumerate(sides)
        ]
    if len(sides) > 1 and sides[0] in (-1, 1) and math.prod(sides[1:]) == n:
        return (1, *sides[1:])
    known = math.prod(side for side in sides if side != -1)
    if known > 0 and n % known == 0:
        sides = [n // known if side == -1 else side for side in sides]
    return tuple(sides)


def transpose(onnx_layers: OnnxLayers, node: Node) -> None:
    """Note that the groups of channels are transposed, see `reshape`, or that channels are last."""
    grouped = onnx_layers.grouped.get(node.inputs[0])
    if len(node.get("perm", [])) == 4:
        transpose_channels(onnx_layers, node)
        return
    is_known = list(node.get("perm", [])) == [0, 2, 1, 3, 4] and grouped is not None
    expect_form(is_known, f"a transposition by {node.get('perm')}")
    assert grouped is not None
    onnx_layers.group(node, Grouped(grouped.source, grouped.groups, is_transposed=True))
