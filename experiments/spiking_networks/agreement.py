"""Our engine beside a simulator, spike for spike: one event in each of the simulator's time steps.

After each event are compared: the number of spikes of each layer, that of each output neuron, and
the membrane of each neuron. A neuron that fires once more or less has another membrane, so equal
membranes mean equal spikes, neuron for neuron.

Graphs of NIR fire above the threshold, and sinabs at it. Sums of many weights are rounded in
another order by each program. So a membrane within NEAR of a threshold may fire in one program
only. A difference that begins there is counted apart. The rest of its recording cannot be compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from async_tnt.base.progress import progress
from async_tnt.networks.models.model import Model
from async_tnt.networks.models.spiking_volume import SpikingVolume
from experiments.spiking_networks.graphs import Stage
from experiments.spiking_networks.simulators import Answer, SteppedNetwork, one_event_a_step
from experiments.spiking_networks.work import Operations

NEAR = 1e-5
"""Distance of a membrane from a threshold below which programs may differ."""

SAME = 1e-6
"""Largest difference of membranes that have had the same spikes, where thresholds are about 1."""

CHUNK = 400
"""Number of time steps that a simulator takes at once."""


@dataclass
class Agreement:
    """What was compared, and where programs differed first in a recording."""

    recordings: int = 0
    events: int = 0
    spikes: dict[str, int] = field(default_factory=dict)
    """Layer -> its spikes."""
    deviations_near: int = 0
    """Recordings with a difference that began at a membrane near a threshold."""
    deviations: int = 0
    """Recordings with another difference."""
    first: list[dict[str, Any]] = field(default_factory=list)
    """Recording, event, layer and neurons of each difference."""
    largest_difference: float = 0.0
    """The largest difference of membranes, where spikes are the same."""
    nearest: float = np.inf
    """The least distance of a membrane from a threshold."""
    operations: dict[str, int] = field(default_factory=dict)
    """Layer -> synaptic operations of the simulator's spikes, see `Operations`."""
    our_operations: dict[str, int] = field(default_factory=dict)
    """The same of our engine, by its own count, in recordings without a difference."""


def compare(
    model: Model,
    network: SteppedNetwork,
    recordings: Sequence[np.ndarray],
    stages: Sequence[Stage],
) -> dict[str, Any]:
    """The `Agreement` on recordings, as a dict.

    Parameters
    ----------
    model : our model of the graph.
    network : the simulator's, in float64, with recorded membranes.
    recordings : their events.
    stages : those of the network.
    """
    nothing = dict.fromkeys(network.names, 0)
    found = Agreement(spikes={**nothing}, our_operations={**nothing})
    operations = Operations(stages)
    with progress(len(recordings), "spike for spike") as bar:
        for k, events in enumerate(recordings):
            _compare_recording(model, network, events, k, found, operations)
            found.recordings += 1
            bar.update()
    found.operations = operations.by_layer
    return dict(vars(found))


def _compare_recording(
    model: Model,
    network: SteppedNetwork,
    events: np.ndarray,
    number: int,
    found: Agreement,
    operations: Operations,
) -> None:
    """Add a recording to what was found, up to its first difference."""
    volume = SpikingVolume(model)
    network.reset()
    for first in range(0, len(events), CHUNK):
        chunk = events[first : first + CHUNK]
        inputs = one_event_a_step(chunk, model.config.sensor, torch.float64)
        theirs = network.step(inputs)
        ours = _our_answers(volume, chunk, network.names)
        event = _compare_answers(network.names, ours, theirs, number, first, found)
        if event is not None:
            found.events += event
            return
        found.events += len(chunk)
        for name, answer in zip(network.names, theirs, strict=True):
            found.spikes[name] += int(answer.spikes.sum())
        operations.add(inputs, theirs)
    for name in network.names:
        found.our_operations[name] += volume.additions(name)


@dataclass(frozen=True)
class _Ours:
    """What a layer of our engine did, event by event."""

    n_spikes: np.ndarray
    """(events,), of the layer at each event."""
    membranes: np.ndarray
    """(events, *layer)."""
    counts: np.ndarray | None
    """(events, *layer): spikes of each neuron of the output at each event."""


def _our_answers(volume: SpikingVolume, events: np.ndarray, names: Sequence[str]) -> list[_Ours]:
    """What each layer does at each event."""
    totals = np.array([[volume.spikes(name) for name in names]])
    counts = [volume.spike_counts()]
    membranes: list[list[np.ndarray]] = [[] for _ in names]
    for k in range(len(events)):
        volume.update(events[k : k + 1])
        totals = np.append(totals, [[volume.spikes(name) for name in names]], axis=0)
        counts.append(volume.spike_counts())
        for of_layer, name in zip(membranes, names, strict=True):
            of_layer.append(volume.membranes(name))
    n_spikes = np.diff(totals, axis=0)
    outputs = np.diff(np.stack(counts), axis=0)
    return [
        _Ours(n_spikes[:, k], np.stack(membranes[k]), outputs if k == len(names) - 1 else None)
        for k in range(len(names))
    ]


def _compare_answers(
    names: Sequence[str],
    ours: Sequence[_Ours],
    theirs: Sequence[Answer],
    recording: int,
    first: int,
    found: Agreement,
) -> int | None:
    """Add some events to what was found. Returns the first one that differs, or None."""
    n = len(ours[0].n_spikes)
    differs = np.zeros((len(names), n), bool)
    distances = []
    for k, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
        assert other.membranes is not None and other.margins is not None
        spikes = other.spikes[0].numpy()
        distance = np.abs(mine.membranes - other.membranes[0].numpy())
        distances.append(distance)
        differs[k] = distance.reshape(n, -1).max(axis=1) > SAME
        differs[k] |= mine.n_spikes != spikes.reshape(n, -1).sum(axis=1)
        if mine.counts is not None:
            differs[k] |= (mine.counts != spikes).reshape(n, -1).any(axis=1)
    events = np.flatnonzero(differs.any(axis=0))
    n_same = int(events[0]) if len(events) else n
    for distance, other in zip(distances, theirs, strict=True):
        if n_same:
            largest = float(distance[:n_same].max())
            nearest = float(other.margins[0, :n_same].min())  # type: ignore[index]
            found.largest_difference = max(found.largest_difference, largest)
            found.nearest = min(found.nearest, nearest)
    if not len(events):
        return None
    k = int(differs[:, n_same].argmax())
    neurons = distances[k][n_same] > SAME
    margins = theirs[k].margins[0, n_same].numpy()[neurons]  # type: ignore[index]
    is_near = len(margins) > 0 and bool(margins.max() <= NEAR)
    found.deviations_near += is_near
    found.deviations += not is_near
    found.first.append(
        {
            "recording": recording,
            "event": first + n_same,
            "layer": names[k],
            "neurons": int(neurons.sum()),
            "margin": float(margins.max()) if len(margins) else None,
        }
    )
    return n_same
