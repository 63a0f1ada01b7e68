"""Normalization by the numbers' own mean and variance: over channels, or over groups of them.

    y = (x - m) / sqrt(v + epsilon) * weight + bias,   v = mean((x - m)^2)

A layer norm takes m and v over the channels of each place, so a change stays where it is. A group
norm takes them over a group of channels at all places, so one change makes all numbers new.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from async_tnt.kernels.network.functions import FUNCTIONS
from async_tnt.kernels.network.program import FUNCTION, MIX, PICK, PRODUCT, SUM, TOTAL
from async_tnt.networks.layers.layer import NOT_NEGATIVE, POSITIVE, Layer, Shape
from async_tnt.networks.layers.operation import Operation, expect_map, expect_weights
from async_tnt.networks.layers.steps import Map, StepList

ROLES = {"weight": False, "bias": False}
"""The weights of both norms, which may be missing."""


def _layer_norm_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    for role, shape in weights.items():
        expect_weights(role, shape, inputs[0][:1])
    return inputs[0]


def _layer_norm_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    (source,) = inputs
    channels = source.channels
    one = Map(1, source.rows, source.columns)
    weights = np.full((1, channels, 1, 1), 1 / channels)

    def mean(values: Map, factor: float, bias: float) -> Map:
        return step_list.add(MIX, [values], one.like(), factor * weights, [bias])

    return _normalized(step_list, layer, source, mean)


def _group_norm_shape(layer: Layer, inputs: list[Shape], weights: dict[str, Shape]) -> Shape:
    expect_map(inputs[0])
    channels = inputs[0][0]
    if channels % layer["groups"]:
        raise ValueError(f"its {layer['groups']} groups must divide its {channels} channels")
    return _layer_norm_shape(layer, inputs, weights)


def _group_norm_steps(step_list: StepList, layer: Layer, inputs: list[Map]) -> Map:
    def mean(values: Map, factor: float, bias: float) -> Map:
        return _mean_of_groups(step_list, layer, values, factor, bias)

    return _normalized(step_list, layer, inputs[0], mean)


def _normalized(
    step_list: StepList, layer: Layer, source: Map, mean: Callable[[Map, float, float], Map]
) -> Map:
    """Add the steps of a norm.

    mean : adds steps that compute the mean of a map's numbers, times a factor, plus a bias.
    """
    centred = _of_two(step_list, TOTAL, source, mean(source, -1.0, 0.0))
    # the mean of large numbers is rounded: what is left of it is small, and known better
    centred = _of_two(step_list, TOTAL, centred, mean(centred, -1.0, 0.0))
    squares = _of_two(step_list, PRODUCT, centred, centred)
    return _scaled(step_list, layer, centred, mean(squares, 1.0, layer["epsilon"]))


def _mean_of_groups(
    step_list: StepList, layer: Layer, source: Map, factor: float, bias: float
) -> Map:
    """Add steps that compute the mean of each group, times a factor, plus a bias.

    Returns a map of one place, in which each channel has the number of its group.
    """
    channels = source.channels
    groups = layer["groups"]
    n_places = source.rows * source.columns
    means = step_list.sum_of_places(source, factor / n_places, np.zeros(channels))
    n_in_group = channels // groups
    weights = np.full((groups, n_in_group, 1, 1), 1 / n_in_group)
    biases = np.full(groups, bias)
    of_groups = step_list.add(MIX, [means], Map(groups, 1, 1), weights, biases, groups=groups)
    picked = np.repeat(np.arange(groups), n_in_group).tolist()
    zeros = np.zeros(channels)
    return step_list.add(PICK, [of_groups], Map(channels, 1, 1), [], zeros, picked=picked)


def _scaled(step_list: StepList, layer: Layer, centred: Map, variance: Map) -> Map:
    """Add steps that divide by sqrt(variance), then apply each channel's weight and bias."""
    channels = centred.channels
    root = step_list.add(
        FUNCTION,
        [variance],
        variance.like(),
        [],
        np.zeros(variance.channels),
        function=list(FUNCTIONS).index("inverse_sqrt"),
    )
    normal = _of_two(step_list, PRODUCT, centred, root)
    weight = step_list.tensor_or(layer, "weight", 1.0, channels)
    bias = step_list.tensor_or(layer, "bias", 0.0, channels)
    return step_list.add(SUM, [normal], normal.like(), weight[np.newaxis], bias)


def _of_two(step_list: StepList, kind: int, first: Map, second: Map) -> Map:
    zeros = np.zeros(first.channels)
    return step_list.add(kind, [first, second], first.like(), [], zeros)


NORMS = (
    Operation(
        name="layer_norm",
        description="The channels at each place, less their mean, by their standard deviation.",
        parameters={"epsilon": NOT_NEGATIVE},
        roles=ROLES,
        shape=_layer_norm_shape,
        steps=_layer_norm_steps,
    ),
    Operation(
        name="group_norm",
        description=(
            "The channels of each of `groups` groups at all places, less their mean, by their "
            "standard deviation."
        ),
        parameters={"groups": POSITIVE, "epsilon": NOT_NEGATIVE},
        roles=ROLES,
        shape=_group_norm_shape,
        steps=_group_norm_steps,
    ),
)
