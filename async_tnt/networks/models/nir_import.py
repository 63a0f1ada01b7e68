"""Models of NIR graphs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from async_tnt.base.checks import ParameterError, ParameterTypeError
from async_tnt.base.files import user_path
from async_tnt.networks.layers.graph import CLASSIFIER, SPIKING
from async_tnt.networks.models.model_file import read_description
from async_tnt.networks.nir.from_nir import Meaning, layers_from_nir
from async_tnt.networks.nir.graph import Graph, graph_of, read_graph
from async_tnt.networks.nir.relu_networks import is_of_relus, relu_layers
from async_tnt.networks.spiking.outputs import outputs_of
from async_tnt.volume.config import WINDOW_US, TNTConfig

Made = TypeVar("Made")
"""A Model. Its module imports this one, so it is not imported here."""


def model_of_nir(
    make: Callable[..., Made],
    graph: Any,
    meaning: Meaning,
    classes: Sequence[str] | None,
    window_us: int | None,
    record: Mapping[str, Any] | None,
) -> Made:
    """See `Model.from_nir`.

    Parameters
    ----------
    make : makes a Model of its fields.
    """
    where = ""
    if isinstance(graph, (str, Path)):
        opened = read_graph(user_path(graph))
        where = f"{graph}: "
    elif hasattr(graph, "to_dict"):
        opened = graph_of(graph.to_dict())
    else:
        rule = "must be the path of a .nir file, or a nir.NIRGraph"
        raise ParameterTypeError("graph", rule, type(graph).__name__)
    try:
        if meaning.reset is None and is_of_relus(opened):
            given = {"classes": classes, "window_us": window_us, "record": record}
            _refuse(given | {"dt": meaning.dt, "polarity": meaning.polarity})
            return _relu_model(make, opened)
        read = layers_from_nir(opened, meaning)
        config = TNTConfig(
            sensor=read.sensor,
            grid=read.sensor,
            representation="count",
            window_us=WINDOW_US if window_us is None else window_us,
        )
        return make(
            config,
            read.weights,
            () if classes is None else classes,
            record or {},
            network={SPIKING: read.layers},
            outputs=outputs_of(read.layers) if classes is None else {},
        )
    except ParameterError:
        raise
    except (NotImplementedError, ValueError) as error:
        raise type(error)(f"{where}{error}") from None


def _refuse(given: Mapping[str, Any]) -> None:
    """Refuse parameters of spiking networks for a network of ReLUs."""
    for name, value in given.items():
        if value is not None:
            rule = (
                "is for spiking networks, and this graph is of a network of ReLUs, which has its "
                "own; with `reset` it is read as a spiking one"
            )
            raise ParameterTypeError(name, rule)


def _relu_model(make: Callable[..., Made], graph: Graph) -> Made:
    """The model that `to_nir` wrote.

    Raises
    ------
    ValueError : its metadata are damaged, or the network does not fit to them.
    NotImplementedError : this release cannot run the network.
    """
    metadata = {}
    for name, value in graph.metadata.items():
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if isinstance(text, str):
            metadata[name] = text
    try:
        description = read_description(metadata)
        layers, weights = relu_layers(graph, description.config.shape)
        outputs = description.outputs
        if isinstance(outputs, dict) and len(outputs) == 1 and layers:
            outputs = dict.fromkeys(outputs, layers[-1]["name"])
        return make(
            description.config,
            weights,
            description.classes,
            description.record,
            network={CLASSIFIER: layers},
            outputs=outputs,
            by_share=description.by_share,
        )
    except (ParameterError, TypeError) as error:  # about the file, not about a parameter
        raise ValueError(str(error)) from None
