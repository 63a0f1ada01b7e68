"""A network as data: the layers that a model's file lists, checked, with the shape of what each
computes.

    {"classifier": [layer, ...], "regressor": [layer, ...]}      the regressor where the
                                                                 configuration needs one

A layer is an object with `op`, `name`, `inputs` and the parameters of its op. Inputs are names of
earlier layers or "volume", the network's input (C, H, W). The last layer is the network's output.
`weights` maps each role to the name of a tensor in the file, a role in brackets may be missing.
Sides are [y, x], paddings [top, left, bottom, right].

    op                   parameters
    conv                 kernel, stride, padding, dilation, groups;
                         weights: weight (F, C / groups, *kernel), [bias] (F,)
    dense                weights: weight (N, M), [bias] (N,)
    batch_norm           epsilon; weights: mean, variance, [weight], [bias], each (C,)
    relu
    leaky_relu           slope
    prelu                weights: slope, (1,) or (C,)
    clip                 low, high; null: no limit
    log1p, sigmoid, tanh, silu, gelu, gelu_tanh, hardswish, hardsigmoid
    max_pool             kernel, stride, padding
    average_pool         kernel, stride, padding: padded places count, as zeros
    sum_pool             kernel, stride, padding
    inside_average_pool  kernel, stride, padding: padded places do not count
    adaptive_average_pool  size: from input floor(k n / size) to ceil((k + 1) n / size), along each
                           axis
    global_average_pool  to (C, 1, 1)
    depth_to_space       block: channel c block^2 + i block + j of a place goes to row i, column j
                         of a block
    add, concat          of two inputs or more; channels one after the other
    flatten              to (C * H * W,), in C order
    heatmap_centroid     to (x, y) in grid pixels: the mean place under a softmax over all places of
                         (1, H, W)

Every parameter is written, so readers need no defaults. What is not in this table may be written in
the same format: a release that cannot run it refuses the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from async_tnt.base.checks import short
from async_tnt.networks.layers.operations import (
    ELEMENTWISE,
    MAX_SIDE,
    OPERATIONS,
    Layer,
    Operation,
    Shape,
)
from async_tnt.networks.layers.uneven_windows import adaptive_spans

VOLUME = "volume"
CLASSIFIER, REGRESSOR = "classifier", "regressor"
MAX_NUMBERS = 1 << 28
"""Of all maps of a network with their padding, and of its layers' weights: a gigabyte. A kilobyte
of layers can ask for any amount. At 640 x 480 ResNet-50 has 2**27.9. It and the next limit are a
program's to set, before it makes or loads a model: `async_tnt.networks.layers.graph.MAX_NUMBERS = 1 <<
30`."""
MAX_PRODUCTS = 1 << 37
"""Multiplications of one pass, an addition in a pool counting as 16: some seconds on one core. At
640 x 480 VGG16 has 2**36.5."""

Network = Mapping[str, Sequence[Layer]]


def layer_shapes(
    layers: Sequence[Layer], volume: Shape, tensors: Mapping[str, Shape], *, partial: bool = False
) -> dict[str, Shape]:
    """What each layer computes, by its name, and the volume.

    Parameters
    ----------
    layers : of one network.
    volume : (C, H, W).
    tensors : the shapes of the weights.
    partial : whether more layers are to come.

    Raises
    ------
    NotImplementedError : names the first layer that this release cannot run.
    ValueError : names the first layer that does not fit, and what was expected.
    """
    shapes: dict[str, Shape] = {VOLUME: volume}
    flat_maps: set[str] = set()  # of more than one place
    n_numbers = n_products = 0
    if not layers and not partial:
        raise ValueError("a network must have at least one layer")
    for place, layer in enumerate(layers):
        name = layer.get("name") if isinstance(layer, Mapping) else None
        if (
            not isinstance(layer, Mapping)
            or not isinstance(name, str)
            or not isinstance(layer.get("op"), str)
        ):
            raise ValueError(
                f"layer {place} must be an object with `name` and `op`, got {short(layer)}"
            )
        try:
            if name in shapes:
                raise ValueError("another layer has this name")
            shapes[name] = _shape_of(layer, shapes, tensors)
            if max(shapes[name][1:], default=1) >= MAX_SIDE:
                raise ValueError(f"its map {shapes[name]} must have sides below {MAX_SIDE}")
            numbers, products = _cost(layer, shapes, tensors)
            n_numbers, n_products = n_numbers + numbers, n_products + products
            if n_numbers > MAX_NUMBERS:
                more = f"more than {MAX_NUMBERS:_} (a program may raise async_tnt.networks.layers.graph.MAX_NUMBERS)"
                raise ValueError(f"up to here maps and weights are {n_numbers:_} numbers, {more}")
            if n_products > MAX_PRODUCTS:
                more = f"more than {MAX_PRODUCTS:_} (a program may raise async_tnt.networks.layers.graph.MAX_PRODUCTS)"
                raise ValueError(f"up to here a pass has {n_products:_} multiplications, {more}")
            if _is_flat_map(layer, shapes, flat_maps):
                flat_maps.add(name)
        except ValueError as error:
            raise ValueError(f"layer {name!r} ({layer['op']}): {error}") from None
    if not partial and name in flat_maps:
        raise ValueError(
            f"layer {name!r} is the output, and a flattened map: a dense layer belongs behind it"
        )
    return shapes


def _cost(
    layer: Layer, shapes: Mapping[str, Shape], tensors: Mapping[str, Shape]
) -> tuple[int, int]:
    """What counts for MAX_NUMBERS and for MAX_PRODUCTS."""
    source, output = shapes[layer["inputs"][0]], shapes[layer["name"]]
    weights = {role: tensors[name] for role, name in layer.get("weights", {}).items()}
    n_output, n_each, kernel = math.prod(output), len(layer["inputs"]), layer.get("kernel", ())
    n_numbers = n_output + sum(map(math.prod, weights.values()))
    if "padding" in layer:
        top, left, bottom, right = layer["padding"]
        n_numbers += source[0] * (source[1] + top + bottom) * (
            source[2] + left + right
        ) - math.prod(source)
    if layer["op"] == "adaptive_average_pool":
        kernel = [adaptive_spans(*axis)[-1] for axis in zip(output[1:], source[1:], strict=True)]
    if kernel:
        n_taps = math.prod(kernel)
        n_each = 16 * n_taps
        n_numbers += 100 * n_taps  # measured: Python's lists of them, while a program is made
        if layer["op"] in ("adaptive_average_pool", "inside_average_pool"):
            # each place has its own weights
            n_numbers += n_taps * math.prod(output[1:]) * (output[0] + 16)
    if "weight" in weights and layer["op"] != "batch_norm":
        n_each = math.prod(weights["weight"][1:])
    return n_numbers, max(n_output * n_each, math.prod(source))


def tensors_of(layers: Sequence[Layer]) -> set[str]:
    """The names of all weights of a network."""
    return {tensor for layer in layers for tensor in layer.get("weights", {}).values()}


def _is_flat_map(layer: Layer, shapes: Mapping[str, Shape], flat_maps: set[str]) -> bool:
    """Whether a layer computes a map of more than one place as a vector, whose order only a dense
    layer knows."""
    if layer["op"] == "flatten" and len(shapes[layer["inputs"][0]]) == 3:
        return shapes[layer["name"]] != shapes[layer["inputs"][0]][:1]
    read = flat_maps.intersection(layer["inputs"])
    if not read or layer["op"] == "dense":
        return False
    if layer["op"] not in ("flatten", "relu", "leaky_relu", "clip", *ELEMENTWISE):
        raise ValueError(f"{read.pop()!r} is a flattened map: a dense layer belongs between")
    return True


def _shape_of(layer: Layer, shapes: Mapping[str, Shape], tensors: Mapping[str, Shape]) -> Shape:
    if (op := OPERATIONS.get(layer["op"])) is None:
        raise NotImplementedError(
            f"layer {layer['name']!r} is a {layer['op']!r}; this release knows "
            f"{', '.join(OPERATIONS)}"
        )
    expected = {"op", "name", "inputs", *op.parameters, *(["weights"] if op.roles else [])}
    if set(layer) != expected:
        missing, unknown = sorted(expected - set(layer)), sorted(set(layer) - expected)
        if unknown and not missing:
            raise NotImplementedError(
                f"layer {layer['name']!r} ({layer['op']}) has {', '.join(unknown)}"
            )
        raise ValueError(f"must have {', '.join(missing)}")
    for name, check in op.parameters.items():
        if not check.holds(layer[name]):
            raise ValueError(f"`{name}` must be {check.words}, got {short(layer[name])}")
    inputs = layer["inputs"]
    if (
        not isinstance(inputs, Sequence)
        or isinstance(inputs, str)
        or not all(isinstance(name, str) for name in inputs)
    ):
        raise ValueError(f"`inputs` must be a list of names, got {short(inputs)}")
    if unknown := [name for name in inputs if name not in shapes]:
        raise ValueError(f"no earlier layer is named {unknown[0]!r}")
    if len(inputs) < op.n_inputs or (op.n_inputs == 1 and len(inputs) > 1):
        expected_inputs = "2 inputs or more" if op.n_inputs > 1 else "1 input"
        raise ValueError(f"must have {expected_inputs}, got {len(inputs)}")
    return op.shape(layer, [shapes[name] for name in inputs], _weights(layer, op, tensors))


def _weights(layer: Layer, op: Operation, tensors: Mapping[str, Shape]) -> dict[str, Shape]:
    """Role -> shape."""
    if not op.roles:
        return {}
    weights = layer["weights"]
    if not isinstance(weights, Mapping) or not all(
        isinstance(name, str) for name in weights.values()
    ):
        raise ValueError(f"`weights` must map roles to names of tensors, got {short(weights)}")
    unknown = set(weights) - set(op.roles)
    missing = [role for role, needed in op.roles.items() if needed and role not in weights]
    if unknown or missing:
        raise ValueError(
            f"`weights` must be {', '.join(op.roles)}, got {', '.join(weights) or 'none'}"
        )
    if lost := [name for name in weights.values() if name not in tensors]:
        raise ValueError(f"no tensor is named {lost[0]!r}")
    return {role: tuple(tensors[name]) for role, name in weights.items()}
