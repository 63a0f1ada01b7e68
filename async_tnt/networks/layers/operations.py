"""The operations that a layer may be, which values their parameters may have, and the shape of what
each computes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MAX_SIDE = 1 << 15
Layer = Mapping[str, Any]
Shape = tuple[int, ...]
"""(C, H, W), or (N,)."""


@dataclass(frozen=True)
class Check:
    words: str
    holds: Callable[[Any], bool]


def _is_whole(value: Any, low: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value < MAX_SIDE


def _is_number(value: Any) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < 1 << 63
    return isinstance(value, float) and not math.isnan(value)


def _whole_numbers(n: int, low: int) -> Check:
    words = f"a list of {n} whole numbers from {low} on"
    return Check(
        words,
        lambda value: (
            isinstance(value, list) and len(value) == n and all(_is_whole(v, low) for v in value)
        ),
    )


SIDES = _whole_numbers(2, 1)
PADDING = _whole_numbers(4, 0)
POSITIVE = Check("a positive whole number", lambda value: _is_whole(value, 1))
LIMIT = Check("a number, or null", lambda value: value is None or _is_number(value))
FINITE = Check("a finite number", lambda value: _is_number(value) and math.isfinite(value))
NOT_NEGATIVE = Check("a finite number from 0 on", lambda value: FINITE.holds(value) and value >= 0)

ShapeRule = Callable[[Layer, list[Shape], dict[str, Shape]], Shape]


@dataclass(frozen=True)
class Operation:
    """Parameters, roles of weights (True: needed), the number of inputs (2: or more), and the shape
    of the output."""

    shape: ShapeRule
    parameters: Mapping[str, Check]
    roles: Mapping[str, bool]
    n_inputs: int = 1


def _windowed(layer: Layer, shape: Shape, dilation: Sequence[int] = (1, 1)) -> tuple[int, int]:
    """Sides of the output of a convolution or pooling."""
    if len(shape) != 3:
        raise ValueError(f"its input must be a map (C, H, W), got {shape}")
    top, left, bottom, right = layer["padding"]
    sides = []
    for axis, side in enumerate((shape[1] + top + bottom, shape[2] + left + right)):
        reach = (layer["kernel"][axis] - 1) * dilation[axis] + 1
        if reach > side:
            raise ValueError(
                f"its kernel reaches over {reach} places, its input has {side} with the padding "
                f"(input {shape})"
            )
        sides.append((side - reach) // layer["stride"][axis] + 1)
    return sides[0], sides[1]


def _expect(role: str, shape: Shape, expected: Shape) -> None:
    if shape != expected:
        raise ValueError(f"its {role} must have shape {expected} here, got {shape}")


def _conv(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    sides = _windowed(layer, inputs[0], layer["dilation"])
    channels, groups = inputs[0][0], layer["groups"]
    n_filters = weights["weight"][0] if weights["weight"] else 0
    if channels % groups or n_filters % groups or n_filters == 0:
        raise ValueError(
            f"{groups} groups must divide its {channels} channels and {n_filters} filters"
        )
    _expect("weight", weights["weight"], (n_filters, channels // groups, *layer["kernel"]))
    _expect("bias", weights.get("bias", (n_filters,)), (n_filters,))
    return n_filters, *sides


def _dense(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs[0]) != 1:
        raise ValueError(f"its input must be flat, got {inputs[0]}: a flatten belongs before it")
    n_units = weights["weight"][0] if weights["weight"] else 0
    if n_units == 0:
        raise ValueError("it must have at least one unit")
    _expect("weight", weights["weight"], (n_units, *inputs[0]))
    _expect("bias", weights.get("bias", (n_units,)), (n_units,))
    return (n_units,)


def _batch_norm(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    for role, shape in weights.items():
        _expect(role, shape, inputs[0][:1])
    return inputs[0]


def _prelu(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if weights["slope"] != (1,):
        _expect("slope", weights["slope"], inputs[0][:1])
    return inputs[0]


def _same(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    return inputs[0]


def _clip(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    low, high = layer["low"], layer["high"]
    if low is not None and high is not None and low > high:
        raise ValueError(f"`low` must be at most `high`, got {low} and {high}")
    return inputs[0]


def _pool(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    sides = _windowed(layer, inputs[0])
    top, left, bottom, right = layer["padding"]
    if max(top, bottom) >= layer["kernel"][0] or max(left, right) >= layer["kernel"][1]:
        raise ValueError(f"padding {layer['padding']} must be less than kernel {layer['kernel']}")
    return inputs[0][0], *sides


def _adaptive_pool(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    rows, columns = layer["size"]
    return _global_pool(layer, inputs, weights)[0], rows, columns


def _global_pool(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs[0]) != 3:
        raise ValueError(f"its input must be a map (C, H, W), got {inputs[0]}")
    return inputs[0][0], 1, 1


def _depth_to_space(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    block = layer["block"]
    channels, rows, columns = _global_pool(layer, inputs, weights)[0], *inputs[0][1:]
    if channels % block**2:
        raise ValueError(f"blocks of {block} x {block} must divide its {channels} channels")
    return channels // block**2, block * rows, block * columns


def _add(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(set(inputs)) > 1:
        raise ValueError(f"its inputs must have one shape, got {', '.join(map(str, inputs))}")
    return inputs[0]


def _concat(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len({shape[1:] for shape in inputs}) > 1 or len({len(shape) for shape in inputs}) > 1:
        raise ValueError(
            f"its inputs must differ in their channels only, got {', '.join(map(str, inputs))}"
        )
    return sum(shape[0] for shape in inputs), *inputs[0][1:]


def _flatten(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    return (math.prod(inputs[0]),)


def _centroid(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs[0]) != 3 or inputs[0][0] != 1:
        raise ValueError(f"its input must be a heatmap (1, H, W), got {inputs[0]}")
    return (2,)


ELEMENTWISE = "log1p", "sigmoid", "tanh", "silu", "gelu", "gelu_tanh", "hardswish", "hardsigmoid"
"""Functions of each number by itself, without parameters."""
_WINDOW = {"kernel": SIDES, "stride": SIDES, "padding": PADDING}
OPERATIONS: dict[str, Operation] = {
    "conv": Operation(
        _conv, {**_WINDOW, "dilation": SIDES, "groups": POSITIVE}, {"weight": True, "bias": False}
    ),
    "dense": Operation(_dense, {}, {"weight": True, "bias": False}),
    "batch_norm": Operation(
        _batch_norm,
        {"epsilon": NOT_NEGATIVE},
        {"mean": True, "variance": True, "weight": False, "bias": False},
    ),
    "relu": Operation(_same, {}, {}),
    "leaky_relu": Operation(_same, {"slope": FINITE}, {}),
    "prelu": Operation(_prelu, {}, {"slope": True}),
    "clip": Operation(_clip, {"low": LIMIT, "high": LIMIT}, {}),
    **{name: Operation(_same, {}, {}) for name in ELEMENTWISE},
    "max_pool": Operation(_pool, _WINDOW, {}),
    "average_pool": Operation(_pool, _WINDOW, {}),
    "sum_pool": Operation(_pool, _WINDOW, {}),
    "inside_average_pool": Operation(_pool, _WINDOW, {}),
    "adaptive_average_pool": Operation(_adaptive_pool, {"size": SIDES}, {}),
    "global_average_pool": Operation(_global_pool, {}, {}),
    "depth_to_space": Operation(_depth_to_space, {"block": POSITIVE}, {}),
    "add": Operation(_add, {}, {}, n_inputs=2),
    "concat": Operation(_concat, {}, {}, n_inputs=2),
    "flatten": Operation(_flatten, {}, {}),
    "heatmap_centroid": Operation(_centroid, {}, {}),
}
