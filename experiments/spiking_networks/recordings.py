"""Recordings of digits, and what our engine says of them, event by event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from async_tnt.base.progress import progress
from async_tnt.networks.models.spiking_network import SpikingNetwork
from async_tnt.networks.models.spiking_volume import SpikingVolume
from async_tnt.sources.files.labelled_recordings import find_recordings
from async_tnt.sources.files.nmnist import read_nmnist
from experiments.speed.timing import spread, work_clock

WINDOW_US = 1_000_000
"""Length of a window, which holds a whole recording of N-MNIST. Its neurons are never reset."""


@dataclass(frozen=True)
class Recording:
    """The events of a recording, and the digit that it shows."""

    events: np.ndarray
    digit: int


def read_recordings(folder: Path, per_digit: int | None = None) -> list[Recording]:
    """The recordings `<digit>/<name>.bin` of a folder.

    per_digit : only as many of each digit, the first by name; None for all.
    """
    return [
        Recording(read_nmnist(recording.path), int(digit))
        for digit, recordings in find_recordings(folder).items()
        for recording in recordings[:per_digit]
    ]


def volume_after(network: SpikingNetwork, events: np.ndarray) -> SpikingVolume:
    """The window after all events of a recording.

    Raises
    ------
    ValueError : the recording is longer than a window.
    """
    volume = SpikingVolume(network)
    if volume.update(events):
        raise ValueError(f"a recording is longer than {WINDOW_US:,} us")
    return volume


def decided(counts: np.ndarray, membranes: np.ndarray) -> np.ndarray:
    """The class with most spikes; of several, that with the largest membrane.

    counts, membranes : (..., classes).
    """
    most = counts == counts.max(axis=-1, keepdims=True)
    return np.where(most, membranes, -np.inf).argmax(axis=-1)


def accuracy_event_by_event(
    network: SpikingNetwork, recordings: Sequence[Recording]
) -> dict[str, Any]:
    """How many recordings are right after their last event, and the work and time of an event."""
    volume_after(network, recordings[0].events)
    n_right = 0
    us = []
    spikes = dict.fromkeys(network.layers, 0)
    operations = dict.fromkeys(network.layers, 0)
    with progress(len(recordings), "event by event") as bar:
        for recording in recordings:
            started = work_clock()
            volume = volume_after(network, recording.events)
            us.append(1e6 * (work_clock() - started) / len(recording.events))
            n_right += int(decided(volume.spike_counts(), volume.membranes()) == recording.digit)
            for name in spikes:
                spikes[name] += volume.spikes(name)
                operations[name] += volume.additions(name)
            bar.update()
    n_events = sum(len(recording.events) for recording in recordings)
    return {
        "recordings": len(recordings),
        "right": n_right,
        "accuracy": n_right / len(recordings),
        "events": n_events,
        "event_us": spread(np.array(us)),
        "spikes_an_event": {name: n / n_events for name, n in spikes.items()},
        "operations_an_event": {name: n / n_events for name, n in operations.items()},
    }
