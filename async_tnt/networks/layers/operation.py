"""The description of an operation of layers: its shape, steps, parameters and weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from async_tnt.networks.layers.layer import Check, Layer, Shape
from async_tnt.networks.layers.places import Axis, axis_through_window
from async_tnt.networks.layers.steps import Map, StepList

ShapeRule = Callable[[Layer, list[Shape], dict[str, Shape]], Shape]
"""Layer, shapes of its inputs, role -> shape of its weights; returns the shape of its output.

It raises a ValueError if the layer, its inputs and its weights do not fit each other."""

StepsRule = Callable[[StepList, Layer, list[Map]], Map]
"""Steps so far, layer, its inputs; adds the layer's steps, and returns the map of its output."""


def no_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Raise an error: the operation has no compiled steps."""
    raise AssertionError(f"{layer['op']} is an operation of spiking networks")


PlacesRule = Callable[[Layer, int, Axis], Axis]
"""Layer, 0 for rows or 1 for columns, that axis of the first input; returns the output's axis."""

KernelRule = Callable[[Layer, Shape, Shape], Sequence[int]]
"""Layer, shape of its first input, shape of its output; returns the size of the output's windows.

The size says how many rows and columns of the input a place of the output may depend on. It is
empty if each place of the output depends on one place only."""


def kernel_of(layer: Layer, source: Shape, output: Shape) -> Sequence[int]:
    """The layer's parameter `kernel`, or an empty tuple if the layer has none."""
    kernel: Sequence[int] = layer.get("kernel", ())
    return kernel


@dataclass(frozen=True)
class Operation:
    """The description of an operation, which a layer names as its `op`.

    Parameters
    ----------
    name : the `op` of layers with this operation.
    description : what the operation computes, in a sentence.
    shape : the rule of the output's shape.
    steps : the rule of the compiled steps; operations of spiking networks alone have none.
    parameters : name of a parameter -> the rule of its values.
    roles : role of weights -> whether a layer must have weights in this role.
    n_inputs : 1 for one input; 2 for two or more inputs.
    flat_maps : what the operation does with a flattened map. "read": it takes the map's numbers in
        the order in which they are stored, as a dense layer does, and its output is no flattened
        map. "kept": it computes each number from the number at the same index, so the order stays.
        "refused": it must not have such an input.
    places : the rule that says where the places of the output lie.
    kernel : the rule that says how much of the input a place of the output depends on.
    own_weights : whether each place of the output has weights of its own. If so, the weights of all
        places count towards MAX_NUMBERS.
    """

    name: str
    description: str
    shape: ShapeRule
    steps: StepsRule = no_steps
    parameters: Mapping[str, Check] = field(default_factory=dict)
    roles: Mapping[str, bool] = field(default_factory=dict)
    n_inputs: int = 1
    flat_maps: Literal["refused", "kept", "read"] = "refused"
    places: PlacesRule = axis_through_window
    kernel: KernelRule = kernel_of
    own_weights: bool = False


# -- parts of shape rules --------------------------------------------------------------------------


def same_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    """The shape of the input."""
    return inputs[0]


def expect_map(shape: Shape) -> None:
    """Refuse an input that is no map."""
    if len(shape) != 3:
        raise ValueError(f"its input must be a map (C, H, W), got {shape}")


def expect_weights(role: str, shape: Shape, expected: Shape) -> None:
    """Refuse weights of another shape than the expected one."""
    if shape != expected:
        raise ValueError(f"its {role} must have shape {expected} here, got {shape}")


def sides_through_window(
    layer: Layer, source: Shape, dilation: Sequence[int] = (1, 1)
) -> tuple[int, int]:
    """Rows and columns of the output of a convolution or pooling, for an input of this shape."""
    expect_map(source)
    top, left, bottom, right = layer["padding"]
    padded = (source[1] + top + bottom, source[2] + left + right)
    sides = []
    for axis, side in enumerate(padded):
        reach = (layer["kernel"][axis] - 1) * dilation[axis] + 1
        if reach > side:
            raise ValueError(
                f"its kernel reaches over {reach} places, its input has {side} with the padding "
                f"(input {source})"
            )
        sides.append((side - reach) // layer["stride"][axis] + 1)
    return sides[0], sides[1]


# -- parts of step rules ---------------------------------------------------------------------------


def window_of(layer: Layer) -> dict[str, tuple[int, int]]:
    """Kernel, stride and the padding before the first row and column, as a `Step` has them."""
    top, left, _, _ = layer["padding"]
    return {
        "kernel": tuple(layer["kernel"]),
        "stride": tuple(layer["stride"]),
        "padding": (top, left),
    }
