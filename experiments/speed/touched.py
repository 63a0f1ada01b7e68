"""What a decision has to compute.

These are the cells of the volume that new events change, and the places of each layer that these
cells reach.

Reached places are computed; where their bits stay the same, nothing follows: the transform drops
many events, and a change ends where every filter's ReLU stays at zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Model
from experiments.speed.moments import NEW_EVENTS, Moments
from experiments.speed.networks import Feed
from experiments.speed.work import work_of


def bench_touched(model: Model, windows: list[np.ndarray], *, moments: int) -> dict[str, Any]:
    """Count what a decision computes, in the mean over many moments.

    For each number of new events there are `cells` of the volume that change, the places of
    each layer that are computed, and `multiplications`. `whole` has the same counts for the
    whole network.
    """
    network = CompiledClassifier(model)
    network(np.zeros(model.config.shape))
    result: dict[str, Any] = {
        "whole": {"cells": int(np.prod(model.config.shape)), **_counted(network)}
    }
    for n_new in NEW_EVENTS:
        of_these = Moments(windows, model.config.window_us, n_new)
        counts = [
            found
            for block in of_these.blocks(max(1, moments // 20), 20)
            for found in _count(model, block)
        ]
        result[str(n_new)] = {
            name: float(np.mean([found[name] for found in counts])) for name in counts[0]
        }
    return result


def _count(model: Model, block: list[Any]) -> list[dict[str, int]]:
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
    """Places computed by the last call, by layer, and multiplications.

    Of a layer in parts, those of its first.
    """
    places: dict[str, int] = {}
    work = work_of(network)
    for step, n in work:
        places.setdefault(step.layer, n)
    return {**places, "multiplications": sum(n * step.products for step, n in work)}
