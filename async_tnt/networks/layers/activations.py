"""Activations: functions of one number, applied to each number of a map."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.network.functions import FUNCTIONS
from async_tnt.kernels.network.program import FUNCTION, SUM
from async_tnt.networks.layers.layer import FINITE, LIMIT, NOT_NEGATIVE, Layer, Shape
from async_tnt.networks.layers.operation import (
    Operation,
    StepsRule,
    expect_weights,
    same_shape,
)
from async_tnt.networks.layers.steps import Map, StepList


def _relu_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    step = step_list.step_to_fold_into(layer, inputs[0])
    step.low = 0.0
    return step.output


def _leaky_relu_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    step = step_list.step_to_fold_into(layer, inputs[0])
    step.slopes[:] = layer["slope"]
    return step.output


def _prelu_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if weights["slope"] != (1,):
        expect_weights("slope", weights["slope"], inputs[0][:1])
    return inputs[0]


def _prelu_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    step = step_list.step_to_fold_into(layer, inputs[0])
    step.slopes[:] = step_list.tensor(layer, "slope")
    return step.output


def _clip_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    low = layer["low"]
    high = layer["high"]
    if low is not None and high is not None and low > high:
        raise ValueError(f"`low` must be at most `high`, got {low} and {high}")
    return inputs[0]


def _clip_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    step = step_list.step_to_fold_into(layer, inputs[0])
    step.low = -np.inf if layer["low"] is None else layer["low"]
    step.high = np.inf if layer["high"] is None else layer["high"]
    return step.output


def _softshrink_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Add steps for x - clip(x, -lambda, lambda), exactly 0 between -lambda and lambda."""
    (source,) = inputs
    limited = step_list.copy(source, source.like())
    step = limited.writers[0]
    step.low = -layer["lambd"]
    step.high = layer["lambd"]
    signs = np.outer([1, -1], np.ones(source.channels))
    return step_list.add(SUM, [source, limited], source.like(), signs, np.zeros(source.channels))


def _function_steps(name: str) -> StepsRule:
    """The rule of the steps of a compiled function.

    The function is given by its name in `kernels.network.functions.FUNCTIONS`.
    """
    function = list(FUNCTIONS).index(name)

    def steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
        (source,) = inputs
        zeros = np.zeros(source.channels)
        return step_list.add(FUNCTION, inputs, source.like(), [], zeros, function=function)

    return steps


def _hardsigmoid_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    step = step_list.step_to_fold_into(layer, inputs[0], linear=True)
    step.weights = step.weights / np.float32(6)
    step.bias = step.bias / np.float32(6) + np.float32(0.5)
    step.low = 0.0
    step.high = 1.0
    return step.output


def _function(name: str, description: str) -> Operation:
    """The operation of a compiled function without parameters."""
    return Operation(
        name=name,
        description=description,
        shape=same_shape,
        steps=_function_steps(name),
        flat_maps="kept",
    )


ACTIVATIONS = (
    Operation(
        name="relu",
        description="max(x, 0).",
        shape=same_shape,
        steps=_relu_steps,
        flat_maps="kept",
    ),
    Operation(
        name="leaky_relu",
        description="x, or slope x where x is negative.",
        parameters={"slope": FINITE},
        shape=same_shape,
        steps=_leaky_relu_steps,
        flat_maps="kept",
    ),
    Operation(
        name="prelu",
        description="x, or slope x where x is negative, with slopes (1,) or (C,).",
        roles={"slope": True},
        shape=_prelu_shape,
        steps=_prelu_steps,
    ),
    Operation(
        name="clip",
        description="x limited to [low, high]; null means no limit.",
        parameters={"low": LIMIT, "high": LIMIT},
        shape=_clip_shape,
        steps=_clip_steps,
        flat_maps="kept",
    ),
    Operation(
        name="softshrink",
        description="x moved towards 0 by lambda, and 0 where |x| is at most lambda.",
        parameters={"lambd": NOT_NEGATIVE},
        shape=same_shape,
        steps=_softshrink_steps,
        flat_maps="kept",
    ),
    _function("log1p", "log(1 + x)."),
    _function("sigmoid", "1 / (1 + exp(-x))."),
    _function("tanh", "The hyperbolic tangent."),
    _function("silu", "x sigmoid(x)."),
    _function("gelu", "x (1 + erf(x / sqrt 2)) / 2."),
    _function("gelu_tanh", "x (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3))) / 2."),
    _function("hardswish", "x clip(x + 3, 0, 6) / 6."),
    _function("erf", "The error function."),
    Operation(
        name="hardsigmoid",
        description="clip(x / 6 + 1/2, 0, 1).",
        shape=same_shape,
        steps=_hardsigmoid_steps,
        flat_maps="kept",
    ),
)
