"""SpikingVolume: a window whose events go through a spiking network."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.absorb import absorb_one_spike, absorb_spikes
from async_tnt.kernels.spiking.answer import answer_spikes
from async_tnt.kernels.spiking.decide import absorb_spikes_and_decide
from async_tnt.kernels.volume.absorb import REFUSED
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.spiking.program import StageMemory, width_of
from async_tnt.volume.events import Columns, Late
from async_tnt.volume.volume import TNTVolume


class SpikingVolume(TNTVolume):
    """A TNTVolume whose events also go through a spiking network, each at its own time.

    Neurons are at rest when a window opens. `array` holds the numbers of events, as a TNTVolume of
    the same configuration.

    Parameters
    ----------
    network : a SpikingNetwork, or a spiking model. Volumes may share a network.
    late : see `TNTVolume`. An event older than the newest one acts at the time of the newest.
    keep_neurons : whether neurons go on from window to window. By default they are at rest when a
        window opens. Spikes are counted for each window in any case.

    Raises
    ------
    ValueError : the model is no spiking model.

    Examples
    --------
    >>> from async_tnt import Model, TNTConfig
    >>> ones = np.ones((2, 2 * 4 * 4), np.float32)
    >>> layers = [
    ...     {"op": "flatten", "name": "flat", "inputs": ["volume"]},
    ...     {"op": "dense", "name": "fc", "inputs": ["flat"], "weights": {"weight": "w"}},
    ...     {
    ...         "op": "if",
    ...         "name": "out",
    ...         "inputs": ["fc"],
    ...         "reset": "subtract",
    ...         "weights": {"r": "r", "v_threshold": "h"},
    ...     },
    ... ]
    >>> weights = {"w": ones, "r": ones[0, :2], "h": np.array([1.5, 9.0])}
    >>> config = TNTConfig(sensor=(4, 4), grid=(4, 4), representation="count")
    >>> volume = SpikingVolume(Model(config, weights, ["a", "b"], network={"spiking": layers}))
    >>> volume.update(([10, 20], [3, 0], [2, 1], [1, 0]))
    0
    >>> volume.spike_counts(), volume.membranes()
    (array([1., 0.]), array([0.5, 2. ]))
    """

    def __init__(
        self,
        network: SpikingNetwork | Model,
        *,
        late: Late = "accept",
        keep_neurons: bool = False,
    ) -> None:
        prepare(absorb_spikes, absorb_one_spike, answer_spikes)
        self._keep_neurons = keep_neurons
        self.network = SpikingNetwork(network) if isinstance(network, Model) else network
        self._state = self.network.program.empty.copy()
        super().__init__(self.network.config, late=late)
        # single events of `update_one` must not pass by the network
        self._is_plain = False

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        prepare(absorb_spikes, absorb_one_spike, answer_spikes)  # perhaps in another process

    def _empty(self, start_us: int, limit_us: int) -> None:
        super()._empty(start_us, limit_us)
        program = self.network.program
        if self._keep_neurons:
            self._state[program.counted] = program.empty[program.counted]
        else:
            self._state[:] = program.empty

    def reset(self) -> None:
        """Return to the state after construction: see `TNTVolume.reset`."""
        super().reset()
        self._state[:] = self.network.program.empty

    def absorb_one(self, t: int, x: int, y: int, p: int) -> int:
        """See `TNTVolume.absorb_one`."""
        try:
            is_plain = type(t) is type(x) is type(y) is type(p * 1) is int
            if is_plain and self._decoder.late == "accept":
                answer: int = absorb_one_spike.call(
                    self._buffer, t, x, y, p * 1, *self.network.program[:3], self._state
                )
                return answer
        except (TypeError, OverflowError):
            pass  # the decoder names the mistake
        return REFUSED

    def absorb(self, columns: Columns, first: int, last: int) -> int:
        """See `TNTVolume.absorb`."""
        absorbed: int = absorb_spikes.call(
            self._buffer, *columns[:4], first, last, *self.network.program[:3], self._state
        )
        return absorbed

    def answer(self) -> tuple[int, np.ndarray, np.ndarray]:
        """The class, logits and probabilities of the open window, for a network with classes.

        Returns
        -------
        The class, or -1 if a logit is not finite; the logits, float32; the probabilities, float64;
        both of the shape (n_classes,).
        """
        network = self.network
        logits = np.empty(network.n_classes, np.float32)
        probabilities = np.empty(network.n_classes)
        program = network.program
        index = answer_spikes.call(
            self._buffer,
            program.program,
            program.params,
            self._state,
            network.output_stage,
            logits,
            probabilities,
        )
        return index, logits, probabilities

    def decide_stretch(
        self, columns: Columns, first: int, last: int, trigger: np.ndarray, *answers: np.ndarray
    ) -> tuple[int, int, int]:
        """Absorb events and decide, in one compiled call.

        See `kernels.spiking.decide.absorb_spikes_and_decide`. `answers` are its arrays for logits,
        probabilities and notes.
        """
        program = self.network.program
        result: tuple[int, int, int]
        result = absorb_spikes_and_decide.call(
            self._buffer,
            *columns[:4],
            first,
            last,
            trigger,
            *program[:3],
            self._state,
            self.network.output_stage,
            *answers,
        )
        return result

    # -- what the neurons did ----------------------------------------------------------------------

    def spikes(self, layer: str | None = None) -> int:
        """How many spikes a layer has had in the window, by default the output."""
        memory = self._memory(layer)
        return int(self._state.view(np.int64)[memory.n_spikes])

    def additions(self, layer: str | None = None) -> int:
        """How many weights spikes have added to a layer in the window, by default to the output.

        These are the synaptic operations of convolutions and dense layers.
        """
        memory = self._memory(layer)
        return int(self._state.view(np.int64)[memory.n_added])

    def spike_counts(self) -> np.ndarray:
        """How many spikes each neuron of the output has had in the window: float64."""
        memory = self._memory(None)
        return self._as_layer(memory, memory.counts)

    def first_spikes_us(self) -> np.ndarray:
        """The time of the first spike of each neuron of the output, or -1: float64."""
        memory = self._memory(None)
        return self._as_layer(memory, memory.first_us)

    def membranes(self, layer: str | None = None) -> np.ndarray:
        """The membranes of a layer, by default the output, at the newest event's time: float64."""
        memory = self._memory(layer)
        program = self.network.program.program
        params = self.network.program.params
        record = program[memory.stage : memory.stage + L.STAGE_SIZE]
        membranes = self._as_layer(memory, memory.membranes)
        if record[L.NEURONS] not in (L.LEAKY, L.CURRENT_BASED):
            return membranes
        _, rows, columns = memory.map_shape
        first = int(record[L.TIMES])
        times = self._state[first : first + rows * columns].reshape(rows, columns)
        _, time_us, _ = self.moment()
        passed_us = np.maximum(0.0, time_us - times)
        of_neurons = _params_of(params, record, memory.map_shape)
        stored = membranes.reshape(memory.map_shape)
        rest = of_neurons[L.LEAK]
        rate = of_neurons[L.RATE]
        leaked = rest + (stored - rest) * np.exp(-passed_us * rate)
        if record[L.NEURONS] == L.CURRENT_BASED:
            currents = self._as_layer(memory, int(record[L.CURRENTS])).reshape(stored.shape)
            added = _added_by_current(passed_us, rate, of_neurons[L.CURRENT_RATE])
            leaked = leaked + of_neurons[L.RESISTANCE] * currents * added
        now: np.ndarray = np.where(passed_us > 0.0, leaked, stored)
        return now.reshape(memory.shape)

    def _memory(self, layer: str | None) -> StageMemory:
        """Where the numbers of a layer of neurons lie."""
        name = self.network.layers[-1] if layer is None else layer
        if name not in self.network.layers:
            rule = f"must be one of {', '.join(self.network.layers)}"
            raise ParameterValueError("layer", rule, short(name))
        return self.network.program.stages[name]

    def _as_layer(self, memory: StageMemory, first: int) -> np.ndarray:
        """Numbers of a stage, in the layer's own shape: float64, a copy."""
        n_channels, rows, columns = memory.map_shape
        width = width_of(n_channels)
        stored = self._state[first : first + rows * columns * width].reshape(rows, columns, width)
        own: np.ndarray = stored[..., :n_channels].transpose(2, 0, 1).reshape(memory.shape).copy()
        return own


def _params_of(params: np.ndarray, record: np.ndarray, map_shape: tuple[int, ...]) -> np.ndarray:
    """The parameters of a stage's neurons: float64, (N_PARAMS, C, H, W)."""
    n_channels, rows, columns = map_shape
    width = width_of(n_channels)
    first = int(record[L.PARAMS])
    size = int(record[L.PARAMS_SIZE])
    values = params[first : first + L.N_PARAMS * size]
    sides = (rows, columns) if size > width else (1, 1)
    by_place = values.reshape(L.N_PARAMS, *sides, width)[..., :n_channels]
    return np.broadcast_to(by_place.transpose(0, 3, 1, 2), (L.N_PARAMS, *map_shape))


def _added_by_current(
    passed_us: np.ndarray, rate: np.ndarray, current_rate: np.ndarray
) -> np.ndarray:
    """How much currents of 1 add to membranes of the resistance 1 while these times pass.

    This is `added_by_current` of `kernels.spiking.fire`, for arrays.
    """
    x = passed_us * np.abs(rate - current_rate)
    share = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
    slower_leak = np.exp(-passed_us * np.minimum(rate, current_rate))
    added: np.ndarray = passed_us * rate * slower_leak * share
    return added
