"""The networks that decide about a stream: its model's own, or networks that are passed instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import short
from async_tnt.networks.loading import load_model
from async_tnt.networks.models.compiled import CompiledRegressor
from async_tnt.networks.models.compiled_network import CompiledNetwork, compiled_network_of
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.streaming.window_classifier import Classifier
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.regressor import Regressor


@dataclass(frozen=True)
class StreamNetworks:
    """The configuration and the networks of a stream. The fields are parameters of `Processor`."""

    config: TNTConfig
    classifier: Classifier | CompiledNetwork | SpikingNetwork
    regressor: Regressor | None
    classes: Sequence[str] | None


def networks_of(
    model: Model | TNTConfig | str | Path,
    classifier: Classifier | None,
    regressor: Regressor | None,
    classes: Sequence[str] | None,
) -> StreamNetworks:
    """The configuration and the networks of a stream; what is not passed comes from the model.

    The parameters are those of `Processor`.

    Raises
    ------
    ParameterTypeError : `model` is of another type, or is a configuration and `classifier` is
        None.
    """
    if isinstance(model, (str, Path)):
        model = load_model(model)
    if isinstance(model, TNTConfig):
        if classifier is None:
            rule = "is missing: a TNTConfig alone cannot decide; pass a Model or a callable"
            raise ParameterTypeError("classifier", rule)
        return StreamNetworks(model, classifier, regressor, classes)
    if not isinstance(model, Model):
        rule = "must be a Model, the name or path of one, or a TNTConfig"
        raise ParameterTypeError("model", rule, type(model).__name__)

    if model.is_spiking:
        return _spiking_networks(model, classifier, classes)
    network: Classifier | CompiledNetwork | None = classifier
    if network is None:
        network = compiled_network_of(model)
    elif isinstance(network, CompiledNetwork) and not model.outputs:
        rule = "must return logits: the model has classes, and a CompiledNetwork raw outputs"
        raise ParameterTypeError("classifier", rule)
    elif model.outputs and not isinstance(network, CompiledNetwork):
        rule = "must be a CompiledNetwork, because the model has raw outputs"
        raise ParameterTypeError("classifier", rule, type(network).__name__)
    if regressor is None and model.config.needs_regressor:
        regressor = CompiledRegressor(model)
    if classes is None:
        classes = model.classes
    if classes and model.outputs:
        rule = "are for a network of logits; the model has raw outputs"
        raise ParameterValueError("classes", rule, short(classes))
    return StreamNetworks(model.config, network, regressor, classes)


def _spiking_networks(
    model: Model, classifier: Classifier | None, classes: Sequence[str] | None
) -> StreamNetworks:
    """The networks of a stream with a spiking model."""
    if classifier is not None and not isinstance(classifier, SpikingNetwork):
        rule = "must not be given: the events go through the spiking model's own network"
        raise ParameterTypeError("classifier", rule, type(classifier).__name__)
    network = SpikingNetwork(model) if classifier is None else classifier
    names = model.classes if classes is None else tuple(classes)
    if names and model.outputs:
        rule = "are for a network of logits; the model has raw outputs"
        raise ParameterValueError("classes", rule, short(names))
    return StreamNetworks(model.config, network, None, names)
