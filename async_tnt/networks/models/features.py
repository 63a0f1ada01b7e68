"""The layers that compute a network's features, on the way to its answer."""

from __future__ import annotations

from collections.abc import Sequence

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.layer import Layer

FEATURES = "features"
"""The name of the output of a model of features."""


def layers_up_to(layers: Sequence[Layer], layer: str | None) -> list[Layer]:
    """The layers that a layer needs, which is the last of them; see `Model.features`.

    Parameters
    ----------
    layers : all layers of the network.
    layer : name of the layer. None: the one that the first dense layer reads or, without dense
        layers, the one that the last layer reads. If it flattens a map, the layer of the map is
        taken instead.

    Raises
    ------
    ParameterValueError : there is no such layer, or it is the volume itself.
    """
    by_name = {one["name"]: one for one in layers}
    name = layer
    if name is None:
        dense = [one for one in layers if one["op"] == "dense"]
        head = dense[0] if dense else layers[-1]
        name = head["inputs"][0]
    elif not isinstance(name, str) or name not in by_name:
        rule = f"must be a layer of the network: {', '.join(by_name)}"
        raise ParameterValueError("layer", rule, short(name))
    while name != VOLUME and by_name[name]["op"] == "flatten":
        (name,) = by_name[name]["inputs"]
    if name == VOLUME:
        raise ParameterValueError("layer", "must be another one: this one is the volume itself")

    needed = {name}
    kept: list[Layer] = []
    for one in reversed(layers):
        if one["name"] in needed:
            needed.update(one["inputs"])
            kept.insert(0, one)
    return kept
