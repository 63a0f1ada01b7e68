"""WindowOutputs: the answers about windows of a network of raw outputs."""

from __future__ import annotations

from typing import Any

from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.networks.models.compiled_network import CompiledNetwork
from async_tnt.streaming.decision import Trigger
from async_tnt.streaming.output import Output
from async_tnt.volume.config import TNTConfig
from async_tnt.volume.volume import TNTVolume


class WindowOutputs:
    """A network of raw outputs, which answers about windows as a `WindowClassifier` does.

    Parameters
    ----------
    config : TNTConfig of the volumes.
    network : the network.
    confidence : must be None, because only classes have a confidence.

    Attributes
    ----------
    classifier : the network, which stands where other streams have a classifier.
    classes : an empty tuple.
    outputs : name of an output -> its shape.
    decides_in_stretches : False, because only one answer's arrays are kept.
    answers_are_views : True.
    """

    decides_in_stretches = False
    answers_are_views = True
    classes: tuple[str, ...] | None = ()

    def __init__(
        self, config: TNTConfig, network: CompiledNetwork, confidence: float | None
    ) -> None:
        self._config = config
        self.exchange(network, confidence)

    def exchange(self, network: Any, confidence: float | None = None) -> None:
        """Use another network with the same outputs from now on."""
        self.check_confidence(confidence)
        if not isinstance(network, CompiledNetwork):
            rule = "must be a CompiledNetwork, because the model has raw outputs"
            raise ParameterTypeError("classifier", rule, type(network).__name__)
        if network.shape != self._config.shape:
            rule = f"must take volumes of shape {self._config.shape}"
            raise ParameterValueError("classifier", rule, f"one for {network.shape}")
        self.classifier = network
        self.outputs = dict(zip(network.names, network.output_shapes, strict=True))

    def check_confidence(self, confidence: float | None) -> None:
        """Refuse a level of confidence."""
        if confidence is not None:
            rule = "is for models with classes; this one has raw outputs"
            raise ParameterValueError("confidence", rule)

    def forget(self) -> None:
        """Do nothing: no answer depends on an earlier one."""

    def decide(
        self,
        volume: TNTVolume,
        trigger: Trigger,
        complete: bool = False,
    ) -> Output:
        """The answer about a volume's open window. For the parameters see `WindowClassifier`."""
        start_us, time_us, n_events = volume.moment()
        network = self.classifier
        arrays = network.refresh(volume)
        return Output(
            arrays,
            network.names,
            network.changed,
            start_us,
            time_us,
            n_events,
            complete,
            trigger,
        )
