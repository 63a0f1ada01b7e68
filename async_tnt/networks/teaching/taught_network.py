"""The layers of a network with taught classes: the trained network, and a row for each new class.

    features -> flatten -> dense  \\
                                    concat -> pick
    logits of the trained classes /

`pick` leaves forgotten classes out. All layers of the trained network stay as they are, so the
logits of its classes keep their bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any

import numpy as np

from async_tnt.networks.layers.graph import CLASSIFIER, Network, needed_layers
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.teaching.closed_form import weights_of
from async_tnt.networks.teaching.statistics import Statistics

LEAST_PLACES = 16
"""The fewest places of a map that is chosen for the features. Smaller maps lie behind the last
poolings, where too little is left of what only new classes need."""

MOST_FEATURES = 4096
"""The most features, as their covariance must fit into the memory."""

PREFIX = "taught"
"""What the names of the new layers and weights begin with."""


def features_layer(layers: Sequence[Layer], shapes: Mapping[str, Shape]) -> str | None:
    """The layer whose numbers are the features: the last map with at least `LEAST_PLACES` places.

    Only layers before the logits with at most `MOST_FEATURES` numbers are considered. If none of
    them is a map of so many places, it is the last of them; if there are none, the result is None.
    """
    *before, _ = layers
    by_name = {layer["name"]: layer for layer in before}
    flat_maps = _flat_maps(before, shapes)
    candidates = [
        name for name in by_name if name not in flat_maps and prod(shapes[name]) <= MOST_FEATURES
    ]
    maps = [name for name in candidates if prod(shapes[name][1:]) >= LEAST_PLACES]
    found = maps or candidates
    return found[-1] if found else None


def _flat_maps(layers: Sequence[Layer], shapes: Mapping[str, Shape]) -> set[str]:
    """The layers whose output is a flattened map, or has its order: they are no outputs."""
    flat: set[str] = set()
    for layer in layers:
        inputs = layer["inputs"]
        flattens = layer["op"] == "flatten" and prod(shapes[inputs[0]][1:]) > 1
        if flattens or (layer["op"] != "dense" and flat.intersection(inputs)):
            flat.add(layer["name"])
    return flat


def trained_network(
    network: Network, weights: Mapping[str, np.ndarray], logits: str
) -> tuple[dict[str, Sequence[Layer]], dict[str, np.ndarray]]:
    """The network up to the layer of the trained logits, and its weights."""
    read = needed_layers(
        [dict(layer) for layer in network[CLASSIFIER]], weights, {CLASSIFIER: logits}
    )
    own = {tensor for layer in network[CLASSIFIER] for tensor in layer.get("weights", {}).values()}
    others = {name: w for name, w in weights.items() if name not in own}
    return {**network, CLASSIFIER: read.layers}, {**others, **read.weights}


def taught_network(
    network: Network,
    weights: Mapping[str, np.ndarray],
    shapes: Mapping[str, Shape],
    statistics: Statistics,
) -> tuple[dict[str, Sequence[Layer]], dict[str, np.ndarray]]:
    """The trained network with a logit for each taught class, and without forgotten ones.

    Parameters
    ----------
    network, weights, shapes : those of the trained network.
    statistics : which classes there are, and their moments.
    """
    layers = [dict(layer) for layer in network[CLASSIFIER]]
    tensors = dict(weights)
    name_of = _names(layers, weights)
    last = statistics.logits

    def add(op: str, name: str, inputs: list[str], **fields: Any) -> str:
        layers.append({"op": op, "name": name_of(name), "inputs": inputs, **fields})
        return name_of(name)

    if statistics.margins:
        if len(shapes[last]) == 3:
            last = add("flatten", "trained", [last])
        features = statistics.layer
        if len(shapes[features]) == 3:
            features = add("flatten", "features", [features])
        names = {"weight": name_of("dense.weight"), "bias": name_of("dense.bias")}
        tensors[names["weight"]], tensors[names["bias"]] = weights_of(statistics)
        rows = add("dense", "dense", [features], weights=names)
        last = add("concat", "logits", [last, rows])
    kept = [
        k
        for k, name in enumerate(statistics.trained)
        if name in statistics.moments and name not in statistics.margins
    ]
    if len(kept) < len(statistics.trained):
        n_trained = len(statistics.trained)
        taught = range(n_trained, n_trained + len(statistics.margins))
        add("pick", "kept", [last], channels=[*kept, *taught])
    return {**network, CLASSIFIER: layers}, tensors


def _names(layers: Sequence[Layer], weights: Mapping[str, np.ndarray]) -> Callable[[str], str]:
    """A function from a short name to a name that no layer and no tensor has."""
    used = {layer["name"] for layer in layers} | set(weights)
    prefix = PREFIX
    while any(name.startswith(f"{prefix}.") for name in used):
        prefix = f"_{prefix}"
    return lambda name: f"{prefix}.{name}"
