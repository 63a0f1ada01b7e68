"""The comparison of a spiking network with its batch reference, on one recording.

(e) However the stream was cut into packets, all membranes and counts have the same bits.
(f) At prefixes of each window, all layers have had the reference's number of spikes, and the last
    layer the reference's spikes and first times. The reference computes each neuron at each event.
(g) Membranes equal the reference's to 1e-9, or without leaks to the bit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from async_tnt.checking.comparison import PACKET_SIZES, Comparison
from async_tnt.networks.layers.graph import SPIKING
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.spiking_volume import SpikingVolume

LEAK_BOUND = 1e-9
"""Largest difference of two membranes that leak, as a share of the largest one."""


def check_spikes(
    events: np.ndarray, model: Model, *, prefixes: int | None, start_us: int | None
) -> list[Comparison]:
    """The comparisons of all promises on one recording.

    The parameters are those of `check_recording`.
    """
    from tnt_reference.spiking import SpikingNetwork as Reference

    network = SpikingNetwork(model)
    leaks = any("tau" in layer.get("weights", {}) for layer in model.network[SPIKING])
    packets = Comparison("states that depend on packets", "the model", 0.0)
    spikes = Comparison("spikes against reference", "the model", 0.0)
    membranes = Comparison("membranes against reference", "the model", LEAK_BOUND if leaks else 0.0)
    for window_start_us, window in _windows(events, model, start_us):
        states = [_state_after(network, window, window_start_us, size) for size in PACKET_SIZES]
        for state in states[1:]:
            packets.add(float(state != states[0]))

        reference = Reference(model.network[SPIKING], model.weights, model.config.shape)
        volume = SpikingVolume(network)
        volume.open(window_start_us)
        n_compared = len(window) if prefixes is None else prefixes
        ends = set(np.linspace(1, len(window), n_compared).astype(int).tolist())
        newest_us = window_start_us
        for n, (t, x, y, p) in enumerate(window.tolist(), 1):
            volume.update_one(t, x, y, p)
            newest_us = max(newest_us, t)
            reference.step(newest_us, x, y, p == 1)
            if n not in ends:
                continue
            for layer in network.layers:
                expected = reference.membranes[layer].numpy().reshape(-1)
                own = volume.membranes(layer).reshape(-1)
                largest = max(1.0, float(np.abs(expected).max()))
                membranes.add(float(np.abs(own - expected).max()) / largest)
                spikes.add(abs(volume.spikes(layer) - reference.spikes.get(layer, 0.0)))
            for own, wanted in (
                (volume.spike_counts(), reference.counts),
                (volume.first_spikes_us(), reference.first_us),
            ):
                spikes.add(float(np.abs(own.reshape(-1) - wanted.numpy().reshape(-1)).max()))
    return [packets, spikes, membranes]


def _windows(
    events: np.ndarray, model: Model, start_us: int | None
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the start and the events of each window that has events."""
    first_us = int(events["t"][0]) if start_us is None else start_us
    numbers = (events["t"].astype(np.int64) - first_us) // model.config.window_us
    newest = np.maximum.accumulate(numbers)
    for number in np.unique(newest):
        # an event of an earlier window is late, and left out
        is_inside = (newest == number) & (numbers == number)
        yield first_us + int(number) * model.config.window_us, events[is_inside]


def _state_after(
    network: SpikingNetwork, window: np.ndarray, start_us: int, packet_size: int
) -> tuple[bytes, ...]:
    """All membranes, counts and first times after a window, as bytes."""
    volume = SpikingVolume(network)
    volume.open(start_us)
    size = packet_size or len(window)
    for first in range(0, len(window), size):
        volume.update(window[first : first + size])
    layers = tuple(volume.membranes(layer).tobytes() for layer in network.layers)
    return *layers, volume.spike_counts().tobytes(), volume.first_spikes_us().tobytes()
