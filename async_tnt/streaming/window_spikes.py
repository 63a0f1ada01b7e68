"""WindowSpikes: the answers about windows of a spiking network."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.base.box import Box
from async_tnt.base.checks import ParameterTypeError, ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.spiking.decide import absorb_spikes_and_decide
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.networks.spiking.outputs import FIRST_SPIKES, MEMBRANES, SPIKES
from async_tnt.streaming.decision import Decision, Trigger
from async_tnt.streaming.output import Output
from async_tnt.streaming.stretches import decide_stretch, not_finite_error
from async_tnt.volume.events import Columns
from async_tnt.volume.volume import TNTVolume


class WindowSpikes:
    """A spiking network, which answers about windows as a `WindowClassifier` does.

    The logits of a class are its neuron's spikes in the window, or the membrane of a leaky
    integrator. The largest one is decided for; among classes with equally many spikes, the one with
    the largest membrane. Probabilities are the softmax of the logits.

    Parameters
    ----------
    network : the network.
    classes : class names; empty for a network of raw outputs.
    confidence : must be None for a network of raw outputs, because only classes have a confidence.

    Attributes
    ----------
    classifier : the network, which stands where other streams have a classifier.
    classes : class names.
    outputs : name of a raw output -> its shape.
    decides_in_stretches : whether `decide_stretch` can be called: answers are decisions.
    answers_are_views : whether answers are `Output` values.
    """

    def __init__(
        self, network: SpikingNetwork, classes: tuple[str, ...], confidence: float | None
    ) -> None:
        self.classes: tuple[str, ...] | None = classes
        self.answers_are_views = not classes
        self.decides_in_stretches = bool(classes)
        self.classifier = network
        self.outputs = network.outputs
        self.check_confidence(confidence)
        if classes and len(classes) != network.n_classes:
            rule = f"must be {network.n_classes} names, one for each neuron of the output"
            raise ParameterValueError("classes", rule, short(classes))

    def exchange(self, network: Any, confidence: float | None = None) -> None:
        """Refuse another network: the neurons of open windows belong to this one."""
        if network is not self.classifier:
            rule = "cannot be exchanged: the neurons of open windows belong to a spiking network"
            raise ParameterTypeError("classifier", rule)

    def check_confidence(self, confidence: float | None) -> None:
        """Refuse a level of confidence for a network of raw outputs."""
        if confidence is not None and not self.classes:
            rule = "is for models with classes; this one has raw outputs"
            raise ParameterValueError("confidence", rule)

    def prepare_stretches(self) -> None:
        """Compile the kernel of `decide_stretch`, so that no event waits for the compiler."""
        prepare(absorb_spikes_and_decide)

    def decide_stretch(
        self, volume: TNTVolume, triggers: np.ndarray, columns: Columns, first: int, last: int
    ) -> tuple[int, list[Decision], ValueError | None]:
        """Add events to a volume, and decide: see `WindowClassifier.decide_stretch`."""
        assert isinstance(volume, SpikingVolume) and self.classes is not None

        def call(absorbed: int, *answers: np.ndarray) -> tuple[int, int, int]:
            return volume.decide_stretch(columns, absorbed, last, triggers, *answers)

        return decide_stretch(call, self.classes, triggers, first, last)

    def forget(self) -> None:
        """Do nothing: no answer depends on an earlier one."""

    def decide(
        self,
        volume: TNTVolume,
        trigger: Trigger,
        complete: bool = False,
    ) -> Decision | Output:
        """The answer about a volume's open window. For the parameters see `WindowClassifier`."""
        assert isinstance(volume, SpikingVolume)
        window = volume.moment()
        if not self.classes:
            return self._output(volume, window, trigger, complete)
        index, logits, probabilities = volume.answer()
        if index < 0:
            raise not_finite_error(logits)
        return Decision(
            self.classes[index], index, probabilities, logits, *window, complete, trigger
        )

    def _output(
        self, volume: SpikingVolume, window: tuple[int, int, int], trigger: Trigger, complete: bool
    ) -> Output:
        """The answer of a network of raw outputs."""
        start_us = window[0]
        names = tuple(self.classifier.outputs)
        arrays = []
        for name in names:
            if name == SPIKES:
                values = volume.spike_counts()
            elif name == MEMBRANES:
                values = volume.membranes()
            else:
                assert name == FIRST_SPIKES
                values = volume.first_spikes_us()
                values = np.where(values < 0.0, -1.0, values - start_us)
            array = values.astype(np.float32)
            array.flags.writeable = False
            arrays.append(array)
        rows, columns = 1, 1
        shape = arrays[0].shape
        if len(shape) == 3:
            _, rows, columns = shape
        whole = Box(0, 0, columns, rows)
        return Output(tuple(arrays), names, (whole,) * len(names), *window, complete, trigger)
