"""Sums and products in a torch module: of maps, and of a map with constants, which become a batch norm."""

from __future__ import annotations

from typing import Any

import torch
from torch import fx

from async_tnt.networks.conversion_check import expect_form
from async_tnt.networks.torch_layers import Call, LayerList, float_array


def add_rule(made: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None:
        return made.add("add", call, [call["input"], call["other"]])
    return _affine(made, call, x, shift=constant)


def sub_rule(made: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"]:
        raise NotImplementedError("a difference other than a map less a constant has no compiled form")
    return _affine(made, call, x, shift=-constant)


def mul_rule(made: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None:
        raise NotImplementedError("a product of two maps has no compiled form")
    return _affine(made, call, x, factor=constant)


def div_rule(made: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"] or call.arguments.get("rounding_mode"):
        raise NotImplementedError("a quotient other than a map by a constant has no compiled form")
    return _affine(made, call, x, factor=1 / constant)


def _with_constant(call: Call) -> tuple[Any, torch.Tensor | None]:
    """The two operands: what is computed from the volume first, and the other one where it is a constant."""
    x, other = call["input"], call["other"]
    if isinstance(other, fx.Node):
        x, other = other, x
    if isinstance(other, (int, float)):
        return x, torch.tensor(float(other), dtype=torch.float64)
    return x, other.detach() if isinstance(other, torch.Tensor) else None


def _affine(made: LayerList, call: Call, x: Any, factor: Any = None, shift: Any = None) -> str:
    """As a batch norm: a constant of one number, or of one for each channel."""
    channels, *sides = made.shape(x)
    weights = {}
    for role, values in {"weight": factor, "bias": shift, "mean": torch.zeros(1), "variance": torch.ones(1)}.items():
        if values is None:
            continue
        shape = list(values.shape)
        while shape[:1] == [1]:
            del shape[0]
        expect_form(shape in ([], [channels, *[1] * len(sides)]), f"a constant of shape {list(values.shape)} here")
        weights[role] = f"{made.prefix}{call.node.name}.{role}"
        made.weights[weights[role]] = float_array(values.reshape(-1).expand(channels))
    return made.add("batch_norm", call, [x], weights=weights, epsilon=0.0)
