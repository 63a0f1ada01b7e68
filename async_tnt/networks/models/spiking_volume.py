"""SpikingVolume: a window whose events go through a spiking network."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.base.messages import short
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.spiking import layout as L
from async_tnt.kernels.spiking.absorb import absorb_one_spike, absorb_spikes
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

    def __init__(self, network: SpikingNetwork | Model, *, late: Late = "accept") -> None:
        prepare(absorb_spikes, absorb_one_spike)
        self.network = SpikingNetwork(network) if isinstance(network, Model) else network
        self._state = self.network.program.empty.copy()
        super().__init__(self.network.config, late=late)
        # single events of `update_one` must not pass by the network
        self._is_plain = False

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        prepare(absorb_spikes, absorb_one_spike)  # perhaps in another process

    def _empty(self, start_us: int, limit_us: int) -> None:
        super()._empty(start_us, limit_us)
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
        program, _, params, _, _ = self.network.program
        record = program[memory.stage : memory.stage + L.STAGE_SIZE]
        membranes = self._as_layer(memory, memory.membranes)
        if record[L.NEURONS] != L.LEAKY:
            return membranes
        n_channels, rows, columns = memory.map_shape
        first = int(record[L.TIMES])
        times = self._state[first : first + rows * columns].reshape(rows, columns)
        _, time_us, _ = self.moment()
        passed_us = np.maximum(0.0, time_us - times)
        size = int(record[L.PARAMS_SIZE])
        first = int(record[L.PARAMS])
        values = params[first : first + L.N_PARAMS * size].reshape(
            L.N_PARAMS, -1, width_of(n_channels)
        )
        shape = (L.N_PARAMS, rows, columns, width_of(n_channels))
        values = np.broadcast_to(
            values.reshape(L.N_PARAMS, *(shape[1:3] if values.shape[1] > 1 else (1, 1)), -1), shape
        )
        by_channel = values[..., :n_channels].transpose(0, 3, 1, 2)
        stored = membranes.reshape(memory.map_shape)
        rest = by_channel[L.LEAK]
        leaked = rest + (stored - rest) * np.exp(-passed_us * by_channel[L.RATE])
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
