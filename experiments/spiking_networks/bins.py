"""The accuracy of a simulated network whose time steps are bins of events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from async_tnt.base.progress import progress
from experiments.spiking_networks.recordings import Recording, decided
from experiments.spiking_networks.simulators import SteppedNetwork

BATCH = 40
"""Number of recordings that are simulated at once."""

STEPS = 25
"""Number of time steps that are simulated at once."""

N_CLASSES = 10


def step_of_events(events: np.ndarray, width_us: int | None) -> np.ndarray:
    """The time step of each event.

    width_us : width of a bin in microseconds; None: each event has a step of its own.
    """
    if width_us is None:
        return np.arange(len(events))
    return events["t"].astype(np.int64) // width_us


def binned_accuracy(
    network: SteppedNetwork,
    recordings: Sequence[Recording],
    width_us: int | None,
    sensor: tuple[int, int],
) -> dict[str, Any]:
    """How many recordings are right after the last step.

    network : its membranes are recorded, see `Answer`. Its last layer decides as our engine does.
    width_us : see `step_of_events`.
    """
    n_right = 0
    n_steps = 0
    words = "an event a step" if width_us is None else f"bins of {width_us:,} us"
    # recordings of about the same number of steps are simulated together
    steps_of = [step_of_events(recording.events, width_us) for recording in recordings]
    order = np.argsort([steps[-1] for steps in steps_of], kind="stable")
    with progress(len(recordings), words) as bar:
        for first in range(0, len(order), BATCH):
            batch = order[first : first + BATCH]
            steps = [steps_of[k] for k in batch]
            events = [recordings[k].events for k in batch]
            n_steps += sum(int(of_recording[-1]) + 1 for of_recording in steps)
            classes = _classes(network, events, steps, sensor)
            n_right += sum(
                int(answer == recordings[k].digit) for answer, k in zip(classes, batch, strict=True)
            )
            bar.update(len(batch))
    return {
        "recordings": len(recordings),
        "right": n_right,
        "accuracy": n_right / len(recordings),
        "steps_a_recording": n_steps / len(recordings),
    }


def _classes(
    network: SteppedNetwork,
    events: Sequence[np.ndarray],
    steps: Sequence[np.ndarray],
    sensor: tuple[int, int],
) -> np.ndarray:
    """The class of each recording of a batch."""
    network.reset()
    counts = np.zeros((len(events), N_CLASSES))
    membranes = counts
    last = max(int(of_recording[-1]) for of_recording in steps)
    for first in range(0, last + 1, STEPS):
        n = min(STEPS, last + 1 - first)
        answer = network.step(_inputs(events, steps, first, n, sensor))[-1]
        assert answer.membranes is not None
        counts += answer.spikes.sum(1).numpy()
        membranes = answer.membranes[:, -1].numpy()
    return decided(counts, membranes)


def _inputs(
    events: Sequence[np.ndarray],
    steps: Sequence[np.ndarray],
    first: int,
    n: int,
    sensor: tuple[int, int],
) -> Tensor:
    """Numbers of events in n time steps: float32, (recordings, n, 2, H, W), OFF first."""
    width, height = sensor
    inputs = np.zeros((len(events), n, 2, height, width), np.float32)
    for counts, packet, of_packet in zip(inputs, events, steps, strict=True):
        low, high = np.searchsorted(of_packet, [first, first + n])
        p, y, x = (packet[name][low:high].astype(np.int64) for name in "pyx")
        np.add.at(counts, (of_packet[low:high] - first, p, y, x), 1)
    return torch.from_numpy(inputs)
