"""A Model as a NIR graph."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.base.package import __version__
from async_tnt.networks.layers.graph import SPIKING
from async_tnt.networks.models.batch_norms import without_batch_norms
from async_tnt.networks.models.model import Model
from async_tnt.networks.nir.from_nir import OFF_FIRST, ORDERS, PolarityOrder
from async_tnt.networks.nir.relu_networks import relu_graph
from async_tnt.networks.nir.to_nir import nir_from_layers

if TYPE_CHECKING:
    import nir


PRODUCER = {"producer": f"async_tnt {__version__}"}
"""The metadata that say who wrote a graph."""


def to_nir(model: Model, *, polarity: PolarityOrder | None = None) -> nir.NIRGraph:
    """The network of a Model as a NIR graph, which `nir.write` writes to a file.

    If a spiking model came from a graph, `Model.from_nir` of the new graph, with the same
    `polarity`, `reset` and `dt`, gives the same layers and weights. These three, and the model's
    window and classes, are not part of what a graph means; they stand in its metadata.

    A network of ReLUs is written with its weights as they are. NIR 1.0 has no ReLU. So neurons (IF)
    with a threshold of 1 stand in place of the ReLUs. For an activation a, such a neuron fires
    floor(a) times within a window, as when a simulator converts a network. The metadata say that
    ReLUs are meant, and hold configuration, classes and record. So `Model.from_nir` gives the same
    network of ReLUs again. Batch norms become part of the layer before them, and a global average
    pooling becomes an average pooling of the whole map. For a spiking network with finer rates see
    `spiking_from_rates`.

    Parameters
    ----------
    polarity : the order of the input's two channels, for a spiking model. By default OFF is first,
        as in published graphs of N-MNIST. Where the network reads the channels in the other order,
        a convolution of one pixel swaps them. The input of a network of ReLUs is its volume.

    Raises
    ------
    ImportError : the library nir is not installed.
    NotImplementedError : a layer has no NIR form, such as a max pooling. The message names the
        layer.
    ValueError : `polarity` is unknown, or given for a network of ReLUs; or that has several
        outputs, or a landmark network.

    References
    ----------
    - Pedersen et al. 2024, Neuromorphic intermediate representation: a unified instruction set for
      interoperable brain-inspired computing, doi:10.1038/s41467-024-52259-9

    Examples
    --------
    >>> import nir
    >>> import numpy as np
    >>> ones = np.ones((2, 4, 4), np.float32)
    >>> sides = np.array([2, 4, 4])
    >>> nodes = {"input": nir.Input(sides), "if": nir.IF(ones, ones), "output": nir.Output(sides)}
    >>> graph = nir.NIRGraph(nodes, [("input", "if"), ("if", "output")])
    >>> again = to_nir(Model.from_nir(graph, reset="subtract"))
    >>> again.edges
    [('input', 'if'), ('if', 'output')]
    """
    if polarity is not None and polarity not in ORDERS:
        raise ParameterValueError("polarity", f"must be {' or '.join(ORDERS)}", short(polarity))
    if not model.is_spiking:
        if polarity is not None:
            raise ParameterValueError("polarity", "is for spiking models", short(polarity))
        return _relu_graph(model)
    order = polarity or OFF_FIRST
    return nir_from_layers(
        model.network[SPIKING],
        model.weights,
        model.config.shape,
        order,
        _metadata_of(model, order),
    )


def _relu_graph(model: Model) -> nir.NIRGraph:
    """The graph of a network of ReLUs."""
    if model.config.needs_regressor:
        raise ParameterValueError("model", "must have no landmark network: it has no NIR form")
    if len(model.outputs) > 1:
        rule = f"must have classes or one output, it has {len(model.outputs)}"
        raise ParameterValueError("model", rule)
    layers, weights = without_batch_norms(model)
    description = model.description()
    del description["format"]
    return relu_graph(layers, weights, model.config.shape, {**PRODUCER, **description})


def _metadata_of(model: Model, polarity: str) -> dict[str, Any]:
    """What a reader of the graph has to know.

    Raises
    ------
    NotImplementedError : neurons differ in what holds for a whole graph.
    """
    metadata: dict[str, Any] = {**PRODUCER, "polarity": polarity}
    for name in ("reset", "dt"):
        values = {layer[name] for layer in model.network[SPIKING] if name in layer}
        if len(values) > 1:
            texts = ", ".join(sorted(map(str, values)))
            raise NotImplementedError(
                f"layers differ in `{name}` ({texts}), but a NIR graph is read with one of them"
            )
        if values:
            metadata[name] = values.pop()
    metadata["window_us"] = model.config.window_us
    if model.classes:
        metadata["classes"] = json.dumps(model.classes)
    return metadata
