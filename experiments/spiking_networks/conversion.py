"""The accuracy of a network of ReLUs, and of the spiking networks that are made of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt import Model, Processor, volumes
from async_tnt.base.progress import progress
from async_tnt.networks import spiking_from_rates
from experiments.spiking_networks.recordings import Recording

SPIKES = (4, 8, 16, 32)
"""How many spikes a neuron has in a window if its ReLU is at the percentile."""


def conversion_accuracy(
    model: Model, calibration: Sequence[Recording], recordings: Sequence[Recording]
) -> dict[str, Any]:
    """How many recordings and windows are right.

    Parameters
    ----------
    model : the network of ReLUs.
    calibration : recordings whose windows say how large its activations are.
    recordings : those that are decided on.
    """
    windows = [
        window.volume
        for recording in calibration
        for window in volumes([recording.events], model.config)
    ]
    rows = {"ReLUs": _count_right(model, recordings, "ReLUs")}
    for spikes in SPIKES:
        name = f"{spikes} spikes"
        converted = spiking_from_rates(model, windows, spikes=spikes)
        rows[name] = _count_right(converted, recordings, name)
    return {"rows": rows, "calibration_windows": len(windows)}


def _count_right(model: Model, recordings: Sequence[Recording], words: str) -> dict[str, int]:
    """The numbers of windows and of recordings, and how many are right.

    A recording's class is that of the largest sum of its windows' outputs: of logits, or of spikes.
    """
    counts = dict.fromkeys(("windows", "windows_right", "recordings", "recordings_right"), 0)
    processor = Processor(model)
    with progress(len(recordings), words) as bar:
        for recording in recordings:
            processor.reset()
            decisions = processor.push(recording.events) + processor.finish()
            outputs = np.sum([decision.logits for decision in decisions], axis=0)
            counts["windows"] += len(decisions)
            counts["windows_right"] += sum(d.index == recording.digit for d in decisions)
            counts["recordings"] += 1
            counts["recordings_right"] += int(outputs.argmax() == recording.digit)
            bar.update()
    return counts
