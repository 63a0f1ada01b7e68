"""What a decision has to compute.

This module counts the cells of the volume that new events change, and the places of each layer that
are computed. A place is computed if its inputs have changed. If the computed numbers have the same
bits as before, the place has not changed, and places that depend on it need not be computed.

Two things make the number of computed places smaller than the number of places that depend on the
positions of the events. The transform drops many events. And a place does not change if the ReLU of
every filter stays at zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Model
from experiments.speed.moments import NEW_EVENTS, Moments
from experiments.speed.networks import Feed
from experiments.speed.work import work_of


def bench_touched(model: Model, windows: list[np.ndarray], *, moments: int) -> dict[str, Any]:
    """Counts of what a decision computes, as means over many moments.

    For each number of new events, there are the number of `cells` of the volume that change, the
    number of places of each layer that are computed, and the number of `multiplications`. `whole`
    has the same counts for the whole network.
    """
    network = CompiledClassifier(model)
    network(np.zeros(model.config.shape))
    result: dict[str, Any] = {
        "whole": {"cells": int(np.prod(model.config.shape)), **_counted(network)}
    }
    for n_new in NEW_EVENTS:
        blocks = Moments(windows, model.config.window_us, n_new).blocks(max(1, moments // 20), 20)
        counts: list[dict[str, int]] = []
        for block in blocks:
            counts += _count(model, block)
        result[str(n_new)] = {
            name: float(np.mean([moment_counts[name] for moment_counts in counts]))
            for name in counts[0]
        }
    return result


def _count(model: Model, block: list[Any]) -> list[dict[str, int]]:
    """The counts at each moment of a block."""
    network = CompiledClassifier(model)
    feed = Feed(model)
    counts = []
    for moment in block:
        if not moment.follows:
            feed.go(moment.before)
            network.refresh(feed.volume)
        before = feed.volume.array.copy()
        feed.go(moment)
        network.refresh(feed.volume)
        counts.append({"cells": int((feed.volume.array != before).sum()), **_counted(network)})
    return counts


def _counted(network: CompiledClassifier) -> dict[str, int]:
    """The number of places of each layer that the last call computed, and of multiplications.

    If a layer is computed in several steps, its places are those of the first step.
    """
    places: dict[str, int] = {}
    work = work_of(network)
    for step, n in work:
        places.setdefault(step.layer, n)
    return {**places, "multiplications": sum(n * step.products for step, n in work)}
