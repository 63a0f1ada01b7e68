"""The comparison of a spiking network with its batch reference, on one recording.

(e) However the stream was cut into packets, all membranes and counts have the same bits.
(f) At prefixes of each window, all layers have had the reference's number of spikes, and the last
    layer the reference's spikes and first times. The reference computes each neuron at each event.
(g) Membranes equal the reference's to 1e-9, or without leaks to the bit.
"""

from __future__ import annotations

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

    from async_tnt.checking.reference import reference_windows

    network = SpikingNetwork(model)
    # the time constants of a membrane
    leaks = any({"tau", "tau_mem"} & layer.get("weights", {}).keys() for layer in model.layers)
    packets = Comparison("states that depend on packets", "the model", 0.0)
    spikes = Comparison("spikes against reference", "the model", 0.0)
    membranes = Comparison("membranes against reference", "the model", LEAK_BOUND if leaks else 0.0)
    for window_start_us, window in reference_windows(events, model.config, start_us):
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
