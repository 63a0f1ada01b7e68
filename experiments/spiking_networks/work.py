"""Synaptic operations: additions of a weight to a sum, at what goes on from an event or a spike."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from experiments.spiking_networks.graphs import Stage
from experiments.spiking_networks.simulators import Answer


class Operations:
    """Counts the synaptic operations of layers.

    A neuron with several spikes at once counts once, as does a cell of a pooling with several
    spikes: each weight is multiplied by their number and added once. Additions of poolings are not
    counted, as their weight is 1.

    Attributes
    ----------
    by_layer : name of a layer of neurons -> operations before it.
    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        self._stages = stages
        self._fan_out: dict[str, Tensor] = {}
        self.by_layer = {stage.name: 0 for stage in stages}

    def add(self, inputs: Tensor, answers: Sequence[Answer]) -> None:
        """Add the operations of some steps.

        inputs : (recordings, steps, 2, H, W).
        """
        passed_on = inputs
        for stage, answer in zip(self._stages, answers, strict=True):
            values = passed_on.flatten(0, 1).to(inputs.dtype)
            *others, weights = stage.linear
            for module in others:
                values = module(values)
            active = (values != 0).sum(0)
            if stage.name not in self._fan_out:
                self._fan_out[stage.name] = fan_out(weights, active.shape)
            self.by_layer[stage.name] += int((active * self._fan_out[stage.name]).sum())
            passed_on = answer.spikes


def fan_out(module: nn.Module, shape: Sequence[int]) -> Tensor:
    """How many weights of a convolution or dense layer each of its inputs is multiplied by."""
    weight = torch.ones_like(module.weight)  # type: ignore[arg-type]
    inputs = torch.zeros((1, *shape), dtype=weight.dtype, requires_grad=True)
    with torch.enable_grad():
        outputs = torch.func.functional_call(module, {"weight": weight}, (inputs,))
        (gradient,) = torch.autograd.grad(outputs.sum(), inputs)
    return gradient[0].round().to(torch.int64)
