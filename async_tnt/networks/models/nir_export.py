"""A spiking Model as a NIR graph."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, get_args

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.base.package import __version__
from async_tnt.networks.layers.graph import SPIKING
from async_tnt.networks.models.model import Model
from async_tnt.networks.nir.from_nir import PolarityOrder
from async_tnt.networks.nir.to_nir import nir_from_layers

if TYPE_CHECKING:
    import nir


def to_nir(model: Model, *, polarity: PolarityOrder = "off_first") -> nir.NIRGraph:
    """The network of a spiking Model as a NIR graph, which `nir.write` writes to a file.

    `Model.from_nir` with the same `polarity`, `reset` and `dt` gives the layers and weights again
    if they came from a graph. These three and the model's window and classes are not part of a
    graph's meaning; they stand in its metadata.

    A network of ReLUs has no NIR form, because NIR 1.0 has no ReLU and no maximum. Its rate-based
    form is a spiking model: see `spiking_from_rates`.

    Parameters
    ----------
    polarity : the order of the input's two channels. Published graphs of N-MNIST have OFF first.
        Where the network reads the channels in the other order, a convolution of one pixel swaps
        them.

    Raises
    ------
    ImportError : the library nir is not installed.
    NotImplementedError : a layer has no NIR form. The message names the layer.
    ValueError : the model is no spiking model, or `polarity` is unknown.

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
    if polarity not in get_args(PolarityOrder):
        rule = f"must be {' or '.join(get_args(PolarityOrder))}"
        raise ParameterValueError("polarity", rule, short(polarity))
    if not model.is_spiking:
        rule = (
            "must be a spiking model, as NIR has no ReLU; `spiking_from_rates` makes one of a "
            "network of ReLUs"
        )
        raise ParameterValueError("model", rule, short(repr(model)))
    return nir_from_layers(
        model.network[SPIKING],
        model.weights,
        model.config.shape,
        polarity,
        _metadata_of(model, polarity),
    )


def _metadata_of(model: Model, polarity: str) -> dict[str, Any]:
    """What a reader of the graph has to know.

    Raises
    ------
    NotImplementedError : neurons differ in what holds for a whole graph.
    """
    metadata: dict[str, Any] = {"producer": f"async_tnt {__version__}", "polarity": polarity}
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
