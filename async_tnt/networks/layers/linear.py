"""Convolutions, dense layers and batch norms: sums of products with weights."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.network.program import MIX, SUM
from async_tnt.networks.layers.layer import NOT_NEGATIVE, PADDING, POSITIVE, SIDES, Layer, Shape
from async_tnt.networks.layers.operation import (
    Operation,
    expect_weights,
    sides_through_window,
    window_of,
)
from async_tnt.networks.layers.steps import Map, StepList

# -- convolution -----------------------------------------------------------------------------------


def _conv_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    sides = sides_through_window(layer, inputs[0], layer["dilation"])
    channels = inputs[0][0]
    groups = layer["groups"]
    n_filters = weights["weight"][0] if weights["weight"] else 0
    if channels % groups or n_filters % groups or n_filters == 0:
        raise ValueError(
            f"{groups} groups must divide its {channels} channels and {n_filters} filters"
        )
    expected = (n_filters, channels // groups, *layer["kernel"])
    expect_weights("weight", weights["weight"], expected)
    expect_weights("bias", weights.get("bias", (n_filters,)), (n_filters,))
    return n_filters, *sides


def _conv_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Add the one step of a convolution; returns its output.

    The step is a SUM for a depthwise convolution of one filter a channel, otherwise a MIX.
    """
    channels = inputs[0].channels
    weight = step_list.tensor(layer, "weight")
    n_filters = len(weight)
    bias = step_list.tensor_or(layer, "bias", 0.0, n_filters)
    output = step_list.output_of(layer)
    window = {**window_of(layer), "dilation": tuple(layer["dilation"])}
    if layer["groups"] == n_filters == channels:
        taps = weight.reshape(n_filters, -1).T
        return step_list.add(SUM, inputs, output, taps, bias, **window)
    return step_list.add(MIX, inputs, output, weight, bias, groups=layer["groups"], **window)


# -- dense layer -----------------------------------------------------------------------------------


def _dense_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    if len(inputs[0]) != 1:
        raise ValueError(f"its input must be flat, got {inputs[0]}: a flatten belongs before it")
    n_units = weights["weight"][0] if weights["weight"] else 0
    if n_units == 0:
        raise ValueError("it must have at least one unit")
    expect_weights("weight", weights["weight"], (n_units, *inputs[0]))
    expect_weights("bias", weights.get("bias", (n_units,)), (n_units,))
    return (n_units,)


def _dense_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Add the steps of a dense layer; returns the output of the last one.

    If the input is one place, there is one step. If the input is a flattened map, a first step
    computes what each place adds to the output, and further steps sum this over all places.
    """
    (source,) = inputs
    weight = step_list.tensor(layer, "weight")
    n_units = len(weight)
    bias = step_list.tensor_or(layer, "bias", 0.0, n_units)
    place_weights = weight.reshape(n_units, source.channels, source.rows, source.columns)
    if source.sides == (1, 1):
        return step_list.add(MIX, inputs, Map(n_units, 1, 1), place_weights, bias)
    parts = step_list.add(
        MIX,
        inputs,
        Map(n_units, source.rows, source.columns),
        place_weights.transpose(2, 3, 0, 1),
        np.zeros(n_units),
        own_weights=True,
    )
    return step_list.sum_of_places(parts, 1.0, bias)


# -- batch norm ------------------------------------------------------------------------------------


def _batch_norm_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    for role, shape in weights.items():
        expect_weights(role, shape, inputs[0][:1])
    return inputs[0]


def _batch_norm_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    """Scale the weights of the step before, and scale and shift its bias.

    So a batch norm has no step of its own.
    """
    n = len(step_list.tensor(layer, "mean"))
    mean = step_list.tensor(layer, "mean").astype(np.float64)
    variance = step_list.tensor(layer, "variance").astype(np.float64)
    weight = step_list.tensor_or(layer, "weight", 1.0, n).astype(np.float64)
    bias = step_list.tensor_or(layer, "bias", 0.0, n).astype(np.float64)
    factor = weight / np.sqrt(variance + layer["epsilon"])

    step = step_list.step_to_fold_into(layer, inputs[0], linear=True)
    weight_factor = factor if step.kind == SUM else factor[:, None, None, None]
    step.weights = (step.weights * weight_factor).astype(np.float32)
    step.bias = ((step.bias - mean) * factor + bias).astype(np.float32)
    return step.output


LINEAR = (
    Operation(
        name="conv",
        description="A convolution; weight (F, C / groups, *kernel), bias (F,).",
        parameters={
            "kernel": SIDES,
            "stride": SIDES,
            "padding": PADDING,
            "dilation": SIDES,
            "groups": POSITIVE,
        },
        roles={"weight": True, "bias": False},
        shape=_conv_shape,
        steps=_conv_steps,
    ),
    Operation(
        name="dense",
        description="A product with a matrix; weight (N, M), bias (N,).",
        roles={"weight": True, "bias": False},
        shape=_dense_shape,
        steps=_dense_steps,
        flat_maps="read",
    ),
    Operation(
        name="batch_norm",
        description=(
            "(x - mean) / sqrt(variance + epsilon) weight + bias, with (C,) numbers of each."
        ),
        parameters={"epsilon": NOT_NEGATIVE},
        roles={"mean": True, "variance": True, "weight": False, "bias": False},
        shape=_batch_norm_shape,
        steps=_batch_norm_steps,
    ),
)
