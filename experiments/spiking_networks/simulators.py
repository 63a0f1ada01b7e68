"""Neurons of sinabs, Norse and snnTorch, and networks of them that go through time step by step.

In a time step, what arrives goes through all layers. A layer's answer has the spikes and membranes
of all steps, and how far each membrane was from a threshold before its reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from experiments.speed.timing import is_installed
from experiments.spiking_networks.graphs import Stage

SINABS = "sinabs"
NORSE = "norse"
SNNTORCH = "snntorch"


@dataclass(frozen=True)
class Answer:
    """What the neurons of a layer did in some time steps.

    Parameters
    ----------
    spikes : (recordings, steps, *layer), how many spikes each neuron had.
    membranes : the same shape, after the resets; None if they were not recorded.
    margins : the same shape: distances of membranes, before their resets, from the nearest value at
        which the number of spikes changes; None if they were not recorded.
    """

    spikes: Tensor
    membranes: Tensor | None = None
    margins: Tensor | None = None


class Neurons(Protocol):
    """A layer of neurons of a simulator, which keeps its membranes."""

    def reset(self) -> None:
        """Put all neurons at rest."""

    def step(self, arriving: Tensor) -> Answer:
        """Let the steps of `arriving`, (recordings, steps, *layer), act one after the other."""


class SteppedNetwork:
    """A network of a simulator.

    Parameters
    ----------
    stages : linear layers and neurons, see `graphs.stages_of`.
    neurons : makes the simulator's neurons of a node.
    """

    def __init__(self, stages: Sequence[Stage], neurons: Callable[[Any], Neurons]) -> None:
        self.names = tuple(stage.name for stage in stages)
        self._linear = [stage.linear for stage in stages]
        self._neurons = [neurons(stage.neurons) for stage in stages]
        self.reset()

    def reset(self) -> None:
        """Put all neurons at rest."""
        for neurons in self._neurons:
            neurons.reset()

    @torch.no_grad()
    def step(self, inputs: Tensor) -> list[Answer]:
        """The answers of all layers to inputs (recordings, steps, 2, H, W)."""
        n_recordings, n_steps = inputs.shape[:2]
        answers = []
        passed_on = inputs
        for linear, neurons in zip(self._linear, self._neurons, strict=True):
            arriving = linear(passed_on.flatten(0, 1))
            answer = neurons.step(arriving.unflatten(0, (n_recordings, n_steps)))
            answers.append(answer)
            passed_on = answer.spikes.to(inputs.dtype)
        return answers


def one_event_a_step(events: np.ndarray, sensor: tuple[int, int], dtype: torch.dtype) -> Tensor:
    """Time steps with one event each: (1, events, 2, H, W). The first channel is that of OFF."""
    width, height = sensor
    steps = torch.zeros((1, len(events), 2, height, width), dtype=dtype)
    p, y, x = (events[name].astype(np.int64) for name in "pyx")
    steps[0, np.arange(len(events)), p, y, x] = 1
    return steps


def missing_simulators() -> dict[str, str]:
    """Simulator that is not installed -> the command that installs it."""
    commands = {
        # beside the versions of nir that it names, this package cannot be installed
        SINABS: "pip install --no-deps sinabs==3.1.3 pbr==7.1.3",
        NORSE: "pip install '.[spiking]'",
        SNNTORCH: "pip install '.[spiking]'",
    }
    return {name: f"not installed: {how}" for name, how in commands.items() if not _is_there(name)}


def _is_there(name: str) -> bool:
    return is_installed(*((name, "pbr") if name == SINABS else (name,)))


# -- neurons ---------------------------------------------------------------------------------------


class SinabsNeurons:
    """sinabs' integrating neurons, whose threshold is subtracted, as often as it is reached.

    Parameters
    ----------
    node : a `nir.IF`, with r = 1.
    lowest : the membranes' least value; None for none. `sinabs.from_nir` takes minus the threshold.
    records : whether answers have membranes and margins.
    """

    def __init__(
        self, node: Any, dtype: torch.dtype, *, lowest: float | None, records: bool
    ) -> None:
        from sinabs.layers import IAF

        if np.any(np.asarray(node.r) != 1):
            raise ValueError("sinabs' integrating neurons have no r, which must be 1")
        self._threshold = _plain(node.v_threshold, dtype)
        self._dtype = dtype
        floor = None if lowest is None else torch.tensor(lowest, dtype=dtype)
        self._layer = IAF(self._threshold, min_v_mem=floor, record_states=records)

    def reset(self) -> None:
        """See `Neurons`."""
        self._layer.reset_states()

    def step(self, arriving: Tensor) -> Answer:
        """See `Neurons`."""
        spikes = self._layer(arriving)
        if not self._layer.record_states:
            return Answer(spikes)
        membranes = self._layer.recordings["v_mem"]
        charged = membranes + spikes.to(self._dtype) * self._threshold
        nearest = self._threshold * (charged / self._threshold).round().clamp(min=1)
        return Answer(spikes, membranes, (charged - nearest).abs())


class NorseNeurons:
    """Norse's integrating neurons, which are reset to a value, and have one spike in a step.

    Parameters
    ----------
    node : a `nir.IF`.
    records : whether answers have membranes and margins.
    """

    def __init__(self, node: Any, dtype: torch.dtype, *, records: bool) -> None:
        from norse.torch.functional.iaf import (
            IAFFeedForwardState,
            IAFParameters,
            iaf_feed_forward_step,
        )

        self._r = _plain(node.r, dtype)
        self._threshold = _plain(node.v_threshold, dtype)
        self._parameters = IAFParameters(
            self._threshold, _plain(node.v_reset, dtype), method="heaviside"
        )
        self._step = iaf_feed_forward_step
        self._state = IAFFeedForwardState
        self._records = records
        self._at_rest = torch.zeros((), dtype=dtype)
        self._membrane = self._at_rest

    def reset(self) -> None:
        """See `Neurons`."""
        self._membrane = self._at_rest

    def step(self, arriving: Tensor) -> Answer:
        """See `Neurons`."""
        return _steps(self._one, arriving, self._threshold, self._records)

    def _one(self, arriving: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        before = self._membrane
        inputs = self._r * arriving
        spikes, state = self._step(inputs, self._state(before), self._parameters)
        self._membrane = state.v
        return spikes, state.v, before + inputs


class SnnTorchNeurons:
    """snnTorch's neurons, which leak by a factor in each step, and have one spike in a step.

    They are reset at once, which snnTorch does in the next step unless it is told so.

    Parameters
    ----------
    node : a `nir.IF` or `nir.LIF`, whose neurons rest at 0.
    step_s : time step in seconds.
    reset : "subtract" or "zero".
    records : whether answers have membranes and margins.
    """

    def __init__(
        self, node: Any, dtype: torch.dtype, *, step_s: float, reset: str, records: bool
    ) -> None:
        from snntorch import Leaky

        gain = np.asarray(node.r, np.float64)
        beta = np.ones(())
        if type(node).__name__ == "LIF":
            if np.any(node.v_leak):
                raise ValueError("snnTorch's neurons rest at 0")
            tau = np.asarray(node.tau, np.float64)
            gain = gain * step_s / tau
            beta = np.exp(-step_s / tau)
        self._gain = _plain(gain, dtype)
        self._beta = _plain(beta, dtype)
        self._threshold = _plain(node.v_threshold, dtype)
        self._cell = Leaky(self._beta, self._threshold, reset_mechanism=reset, reset_delay=False)
        self._records = records
        self._at_rest = torch.zeros((), dtype=dtype)
        self._membrane = self._at_rest

    def reset(self) -> None:
        """See `Neurons`."""
        self._membrane = self._at_rest

    def step(self, arriving: Tensor) -> Answer:
        """See `Neurons`."""
        return _steps(self._one, arriving, self._threshold, self._records)

    def _one(self, arriving: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        before = self._membrane.expand_as(arriving)
        inputs = self._gain * arriving
        spikes, self._membrane = self._cell(inputs, before)
        return spikes, self._membrane, self._beta * before + inputs


def _steps(
    one: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]],
    arriving: Tensor,
    threshold: Tensor,
    records: bool,
) -> Answer:
    """The answer of neurons with one spike in a step.

    one : lets a step act; returns spikes, membranes, and membranes before the reset.
    """
    steps = [one(step) for step in arriving.unbind(1)]
    spikes = torch.stack([step[0] for step in steps], 1)
    if not records:
        return Answer(spikes)
    membranes = torch.stack([step[1] for step in steps], 1)
    charged = torch.stack([step[2] for step in steps], 1)
    return Answer(spikes, membranes, (charged - threshold).abs())


def _plain(values: Any, dtype: torch.dtype) -> Tensor:
    """Values of a node as a tensor; one number if all are alike, which makes simulators faster."""
    array = np.asarray(values, np.float64)
    if array.size and np.all(array == array.flat[0]):
        array = array.flat[0:1].reshape(())
    return torch.tensor(array, dtype=dtype)
