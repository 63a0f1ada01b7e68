"""A model of the features that a network computes on the way to its answer."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import CLASSIFIER, VOLUME, tensors_of
from async_tnt.networks.layers.layer import Layer

if TYPE_CHECKING:
    from async_tnt.networks.models.model import Model

FEATURES = "features"
"""The name of the output."""


def feature_model(model: Model, layer: str | None) -> Model:
    """The model of a network up to a layer, see `Model.features`."""
    by_name = {one["name"]: one for one in model.layers}
    name = _default_layer(model, by_name) if layer is None else layer
    if name not in by_name:
        rule = f"must be a layer of the network: {', '.join(by_name)}"
        raise ParameterValueError("layer", rule, short(name))
    while by_name[name]["op"] == "flatten":
        (name,) = by_name[name]["inputs"]

    needed = {name}
    kept: list[Layer] = []
    for one in reversed(model.layers):
        if one["name"] in needed:
            needed.update(one["inputs"])
            kept.insert(0, one)
    network = {**model.network, CLASSIFIER: kept}
    tensors = tensors_of([one for layers in network.values() for one in layers])
    return replace(
        model,
        weights={key: values for key, values in model.weights.items() if key in tensors},
        classes=(),
        network=network,
        outputs={FEATURES: name},
    )


def _default_layer(model: Model, by_name: dict[str, Layer]) -> str:
    """The layer that the first dense layer reads, or without one, that which the last layer reads.

    Raises
    ------
    ParameterValueError : it is the volume itself.
    """
    dense = [one for one in model.layers if one["op"] == "dense"]
    head = dense[0] if dense else model.layers[-1]
    name: str = head["inputs"][0]
    while name != VOLUME and by_name[name]["op"] == "flatten":
        name = by_name[name]["inputs"][0]
    if name == VOLUME:
        raise ParameterValueError("layer", "must be given: the first dense layer reads the volume")
    return name
