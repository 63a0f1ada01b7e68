"""A network without batch norms: they become part of the layers before them."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.networks.layers.graph import CLASSIFIER, tensors_of
from async_tnt.networks.layers.layer import Layer
from async_tnt.networks.models.model import Model

Layers = list[dict[str, Any]]

Weights = dict[str, np.ndarray]


def without_batch_norms(model: Model) -> tuple[Layers, Weights]:
    """The layers and weights of the network, in which batch norms are part of other layers.

    Raises
    ------
    NotImplementedError : a batch norm does not stand behind a convolution or a dense layer, or
        another layer reads its input, too.
    """
    layers = [dict(layer) for layer in model.network[CLASSIFIER]]
    weights = dict(model.weights)
    by_name = {layer["name"]: layer for layer in layers}
    outputs = set(model.outputs.values())
    kept: Layers = []
    folded: dict[str, str] = {}
    for layer in layers:
        layer["inputs"] = [folded.get(name, name) for name in layer["inputs"]]
        if layer["op"] != "batch_norm":
            kept.append(layer)
            continue
        (source,) = layer["inputs"]
        before = by_name.get(source)
        n_readers = sum(source in other["inputs"] for other in layers)
        is_linear = before is not None and before["op"] in ("conv", "dense")
        if before is None or not is_linear or n_readers > 1 or source in outputs:
            raise NotImplementedError(
                f"layer {layer['name']!r} (batch_norm): it must be the only reader of a "
                "convolution or a dense layer"
            )
        _fold(before, layer, weights)
        folded[layer["name"]] = source
    used = tensors_of(kept)
    return kept, {name: values for name, values in weights.items() if name in used}


def _fold(before: dict[str, Any], norm: Layer, weights: Weights) -> None:
    """Make a batch norm part of the layer before, which gets weights of its own."""
    roles = norm["weights"]
    mean = weights[roles["mean"]].astype(np.float64)
    variance = weights[roles["variance"]].astype(np.float64)
    factor = 1.0 / np.sqrt(variance + norm["epsilon"])
    if "weight" in roles:
        factor *= weights[roles["weight"]]
    own = before["weights"]
    weight = weights[own["weight"]]
    bias = weights[own["bias"]].astype(np.float64) if "bias" in own else 0.0
    bias = (bias - mean) * factor
    if "bias" in roles:
        bias = bias + weights[roles["bias"]]
    before["weights"] = {role: f"{norm['name']}.{role}" for role in ("weight", "bias")}
    by_filter = factor.reshape(-1, *[1] * (weight.ndim - 1))
    weights[before["weights"]["weight"]] = (weight * by_filter).astype(np.float32)
    weights[before["weights"]["bias"]] = bias.astype(np.float32)
