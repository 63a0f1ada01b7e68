"""Networks that read a volume times a factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.layer import Layer

SCALED = "scaled volume"
"""The name of the layer that multiplies a volume."""


def with_scaled_volume(
    name: str,
    layers: Sequence[Layer],
    weights: Mapping[str, np.ndarray],
    channels: int,
    scale: float,
) -> tuple[list[Layer], dict[str, Any]]:
    """Put a new layer, which multiplies the volume by `scale`, before the layers.

    The new layer is a batch norm. If the layers begin with such a layer, it gets another factor.

    Parameters
    ----------
    name : name of the network, with which the names of the new tensors begin.
    layers : the layers of the network.
    weights : the tensors of the network.
    channels : number of channels of the volume.
    scale : the factor.

    Returns
    -------
    All layers, the new layer first, and the tensors of the new layer.
    """
    if layers[0]["name"] == SCALED:
        tensor = layers[0]["weights"]["weight"]
        return list(layers), {tensor: weights[tensor] * np.float32(scale)}
    values = {"mean": 0.0, "variance": 1.0, "weight": scale}
    tensor_names = {role: f"{name}.scale.{role}" for role in values}
    scaling = {
        "op": "batch_norm",
        "name": SCALED,
        "inputs": [VOLUME],
        "weights": tensor_names,
        "epsilon": 0.0,
    }
    rewired = []
    for layer in layers:
        # a layer that read the volume now reads the new layer's output
        inputs = [SCALED if value == VOLUME else value for value in layer["inputs"]]
        rewired.append({**layer, "inputs": inputs})
    tensors = {
        tensor_names[role]: np.full(channels, value, np.float32) for role, value in values.items()
    }
    return [scaling, *rewired], tensors
