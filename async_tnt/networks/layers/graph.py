"""A network as data: its layers, which are checked, and the shape of what each layer computes.

    {"classifier": [layer, ...], "regressor": [layer, ...]}

The regressor is present if the configuration needs one. A spiking network stands under "spiking",
in the place of the classifier. A layer is an object with `op`, `name`, `inputs`, the parameters of
its operation, and `weights` if the operation has some. Inputs are names of earlier layers, or
"volume", the network's input (C, H, W). The last layer is the network's output, unless the model
names other outputs. `weights` maps each role to the name of a tensor in the file; a role that the
operation does not need may be missing. Sides are [y, x], paddings [top, left, bottom, right].

The operations, with their parameters and roles, are those of the table `OPERATIONS` in
`networks/layers/operations.py`; `python -m pydoc async_tnt.networks.layers.operations` lists them.
Those of a spiking network are in `networks/spiking/operations.py`. Every parameter is written, so
readers need no defaults. An operation that is not in the table may be written in the same format: a
release that cannot run the operation refuses the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.messages import short
from async_tnt.networks.layers.layer import MAX_SIDE, Layer, Shape
from async_tnt.networks.layers.operation import Operation
from async_tnt.networks.layers.operations import OPERATIONS

VOLUME = "volume"
"""The name of a network's input."""

CLASSIFIER = "classifier"
"""The name of the network that computes logits."""

REGRESSOR = "regressor"
"""The name of the network that computes the landmark."""

SPIKING = "spiking"
"""The name of a spiking network. It takes the place of the classifier."""

MAX_NUMBERS = 1 << 28
"""The most numbers in all maps of a network, with their padding, and in its layers' weights.

In float32 this is a gigabyte. A limit is needed because a file with a kilobyte of layers can ask
for any amount of memory. At 640 x 480 ResNet-50 has 2**27.9 numbers.

A program may set this limit and `MAX_PRODUCTS` before it makes or loads a model:
`async_tnt.networks.layers.graph.MAX_NUMBERS = 1 << 30`.
"""

MAX_PRODUCTS = 1 << 37
"""The most multiplications of one pass. They take some seconds on one core.

An addition in a pooling counts as 16 multiplications. At 640 x 480 VGG16 has 2**36.5."""

PRODUCTS_OF_AN_ADDITION = 16
"""How many multiplications take as long as one addition in a pooling."""

NUMBERS_OF_A_TAP = 100
"""How many float32 numbers take as much memory as one tap of a window while a program is made.

Taps lie in Python's lists at that time, which is why they take so much. The number was measured."""

Network = Mapping[str, Sequence[Layer]]
"""CLASSIFIER or REGRESSOR -> layers."""


def layer_shapes(
    layers: Sequence[Layer],
    volume: Shape,
    tensors: Mapping[str, Shape],
    outputs: Sequence[str] | None = None,
    operations: Mapping[str, Operation] = OPERATIONS,
) -> dict[str, Shape]:
    """Name of a layer -> the shape of its output; also VOLUME -> the shape of the volume.

    Parameters
    ----------
    layers : the layers of one network.
    volume : (C, H, W).
    tensors : name -> the shape of weights.
    outputs : the layers that compute the network's outputs, by default the last one. It is empty
        while more layers will follow.
    operations : name -> operation that a layer may have.

    Raises
    ------
    NotImplementedError : this release cannot run a layer. The message names the first such layer.
    ValueError : a layer does not fit. The message names the first such layer and what was expected.
    """
    if not layers and outputs is None:
        raise ValueError("a network must have at least one layer")
    checked = _CheckedLayers(volume, tensors, operations)
    for place, layer in enumerate(layers):
        name = _name_of(place, layer)
        try:
            checked.add(name, layer)
        except ValueError as error:
            raise ValueError(f"layer {name!r} ({layer['op']}): {error}") from None
    if outputs is None:
        outputs = (layers[-1]["name"],)
    for output in outputs:
        if output not in checked.shapes:
            raise ValueError(f"no layer is named {output!r}, which is an output")
        if output in checked.flat_maps:
            raise ValueError(
                f"layer {output!r} is an output, and a flattened map: a dense layer belongs behind "
                "it"
            )
    return checked.shapes


class ReadNetwork(NamedTuple):
    """The layers that were read from a network of another program."""

    layers: list[dict[str, Any]]
    """The layers that its outputs need, in the order in which they are computed."""
    weights: dict[str, np.ndarray]
    """Name -> weights of these layers."""
    outputs: dict[str, str]
    """Name of an output -> the layer that computes it."""


def needed_layers(
    layers: Sequence[dict[str, Any]],
    weights: Mapping[str, np.ndarray],
    outputs: Mapping[str, str],
) -> ReadNetwork:
    """The layers that are needed for some outputs, and their weights.

    If there is one output, the last of these layers computes it.

    Parameters
    ----------
    outputs : name of an output -> the layer that computes it, or VOLUME.
    """
    needed = set(outputs.values())
    kept: list[dict[str, Any]] = []
    for layer in reversed(layers):
        if layer["name"] in needed:
            needed.update(layer["inputs"])
            kept.insert(0, layer)
    used = tensors_of(kept)
    used_weights = {name: w for name, w in weights.items() if name in used}
    return ReadNetwork(kept, used_weights, dict(outputs))


def tensors_of(layers: Sequence[Layer]) -> set[str]:
    """The names of all weights of a network."""
    return {tensor for layer in layers for tensor in layer.get("weights", {}).values()}


def _name_of(place: int, layer: Layer) -> str:
    """The layer's name. This raises a ValueError if `layer` is no layer."""
    name = layer.get("name") if isinstance(layer, Mapping) else None
    if not isinstance(name, str) or not isinstance(layer.get("op"), str):
        raise ValueError(
            f"layer {place} must be an object with `name` and `op`, got {short(layer)}"
        )
    return name


class _CheckedLayers:
    """The layers of a network that have been checked so far.

    Attributes
    ----------
    shapes : layer -> the shape of its output; also VOLUME -> the shape of the volume.
    flat_maps : the layers whose output is a map of more than one place, flattened to a vector. Only
        a dense layer may read such a vector, as it depends on the order of the map's numbers.
    """

    def __init__(
        self,
        volume: Shape,
        tensors: Mapping[str, Shape],
        operations: Mapping[str, Operation],
    ) -> None:
        self._operations = operations
        self.shapes: dict[str, Shape] = {VOLUME: volume}
        self.flat_maps: set[str] = set()
        self._tensors = tensors
        self._n_numbers = 0
        self._n_products = 0

    def add(self, name: str, layer: Layer) -> None:
        """Check one more layer.

        Raises
        ------
        NotImplementedError : this release has no such operation.
        ValueError : the layer does not fit.
        """
        if name in self.shapes:
            raise ValueError("another layer has this name")
        operation = self._operations.get(layer["op"])
        if operation is None:
            known = ", ".join(self._operations)
            raise NotImplementedError(
                f"layer {name!r} is a {layer['op']!r}; this release knows {known}"
            )
        _check_fields(layer, operation)
        inputs = self._input_shapes(layer, operation)
        weights = _weight_shapes(layer, operation, self._tensors)
        shape = operation.shape(layer, inputs, weights)
        if max(shape[1:], default=1) >= MAX_SIDE:
            raise ValueError(f"its map {shape} must have sides below {MAX_SIDE}")
        self.shapes[name] = shape
        self._count_cost(layer, operation, inputs, weights)
        if self._is_flat_map(layer, operation, inputs):
            self.flat_maps.add(name)

    def _input_shapes(self, layer: Layer, operation: Operation) -> list[Shape]:
        inputs = layer["inputs"]
        is_list = isinstance(inputs, Sequence) and not isinstance(inputs, str)
        if not is_list or not all(isinstance(name, str) for name in inputs):
            raise ValueError(f"`inputs` must be a list of names, got {short(inputs)}")
        for name in inputs:
            if name not in self.shapes:
                raise ValueError(f"no earlier layer is named {name!r}")
        if len(inputs) < operation.n_inputs or (operation.n_inputs == 1 and len(inputs) > 1):
            expected = "2 inputs or more" if operation.n_inputs > 1 else "1 input"
            raise ValueError(f"must have {expected}, got {len(inputs)}")
        return [self.shapes[name] for name in inputs]

    def _count_cost(
        self, layer: Layer, operation: Operation, inputs: list[Shape], weights: dict[str, Shape]
    ) -> None:
        """Add the layer's cost to the sums over all layers.

        Raises
        ------
        ValueError : a sum is above MAX_NUMBERS or MAX_PRODUCTS.
        """
        output = self.shapes[layer["name"]]
        n_numbers, n_products = _cost(layer, operation, inputs, output, weights)
        self._n_numbers += n_numbers
        if self._n_numbers > MAX_NUMBERS:
            raise ValueError(
                f"up to here maps and weights are {self._n_numbers:_} numbers, "
                f"{_more_than('MAX_NUMBERS', MAX_NUMBERS)}"
            )
        self._n_products += n_products
        if self._n_products > MAX_PRODUCTS:
            raise ValueError(
                f"up to here a pass has {self._n_products:_} multiplications, "
                f"{_more_than('MAX_PRODUCTS', MAX_PRODUCTS)}"
            )

    def _is_flat_map(self, layer: Layer, operation: Operation, inputs: list[Shape]) -> bool:
        """Whether the layer's output is a flattened map.

        Raises
        ------
        ValueError : an input of the layer is a flattened map, but the operation must not have one.
        """
        if layer["op"] == "flatten" and len(inputs[0]) == 3:
            channels = inputs[0][:1]
            return self.shapes[layer["name"]] != channels
        flat_inputs = self.flat_maps.intersection(layer["inputs"])
        if not flat_inputs or operation.flat_maps == "read":
            return False
        if operation.flat_maps == "refused":
            raise ValueError(
                f"{flat_inputs.pop()!r} is a flattened map: a dense layer belongs between"
            )
        return True


def _more_than(name: str, limit: int) -> str:
    return f"more than {limit:_} (a program may raise async_tnt.networks.layers.graph.{name})"


def _check_fields(layer: Layer, operation: Operation) -> None:
    """Refuse a layer with other fields than its operation has, or with a wrong value."""
    expected = {"op", "name", "inputs", *operation.parameters}
    if operation.roles:
        expected.add("weights")
    missing = sorted(expected - set(layer))
    unknown = sorted(set(layer) - expected)
    if missing:
        raise ValueError(f"must have {', '.join(missing)}")
    if unknown:
        raise NotImplementedError(
            f"layer {layer['name']!r} ({layer['op']}) has {', '.join(unknown)}"
        )
    for name, check in operation.parameters.items():
        if not check.holds(layer[name]):
            raise ValueError(f"`{name}` must be {check.words}, got {short(layer[name])}")


def _weight_shapes(
    layer: Layer, operation: Operation, tensors: Mapping[str, Shape]
) -> dict[str, Shape]:
    """The shapes of a layer's weights, by role."""
    if not operation.roles:
        return {}
    weights = layer["weights"]
    is_mapping = isinstance(weights, Mapping)
    if not is_mapping or not all(isinstance(name, str) for name in weights.values()):
        raise ValueError(f"`weights` must map roles to names of tensors, got {short(weights)}")
    unknown = set(weights) - set(operation.roles)
    needed = {role for role, is_needed in operation.roles.items() if is_needed}
    if unknown or not needed <= set(weights):
        raise ValueError(
            f"`weights` must be {', '.join(operation.roles)}, got {', '.join(weights) or 'none'}"
        )
    for name in weights.values():
        if name not in tensors:
            raise ValueError(f"no tensor is named {name!r}")
    return {role: tuple(tensors[name]) for role, name in weights.items()}


def _cost(
    layer: Layer,
    operation: Operation,
    inputs: list[Shape],
    output: Shape,
    weights: Mapping[str, Shape],
) -> tuple[int, int]:
    """How many numbers a layer has, and how many multiplications.

    MAX_NUMBERS and MAX_PRODUCTS limit the sums over all layers.
    """
    source = inputs[0]
    n_numbers = math.prod(output) + sum(map(math.prod, weights.values()))
    n_products_each = len(inputs)  # multiplications for each number of the output
    if "padding" in layer:
        top, left, bottom, right = layer["padding"]
        channels, rows, columns = source
        n_padded = channels * (rows + top + bottom) * (columns + left + right)
        n_numbers += n_padded - math.prod(source)
    kernel = operation.kernel(layer, source, output)
    if kernel:
        n_taps = math.prod(kernel)
        n_products_each = PRODUCTS_OF_AN_ADDITION * n_taps
        n_numbers += NUMBERS_OF_A_TAP * n_taps
        if operation.own_weights:
            n_places = math.prod(output[1:])
            # A tap has a weight for each channel. It also has 16 numbers in the arrays from which
            # these weights are computed.
            n_numbers += n_taps * n_places * (output[0] + 16)
    if "weight" in weights:
        n_products_each = math.prod(weights["weight"][1:])
    # a layer takes at least as long as it takes to read its input
    return n_numbers, max(math.prod(output) * n_products_each, math.prod(source))
