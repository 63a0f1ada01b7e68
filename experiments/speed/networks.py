"""The time of the network alone, at batch 1, some events after the previous decision.

Our incremental network computes what has changed. The other networks compute everything.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Model, TNTVolume
from experiments.speed.backends import Network
from experiments.speed.interleaved import Backend, compare
from experiments.speed.moments import Moment, Moments


class Feed:
    """A volume that follows the moments; its updates are not timed."""

    def __init__(self, model: Model) -> None:
        self.volume = TNTVolume(model.config)
        self._start_us = -1
        self._n = 0

    def go(self, moment: Moment) -> None:
        """Bring the volume up to a moment."""
        if moment.start_us != self._start_us:
            self.volume.open(moment.start_us)
            self._start_us = moment.start_us
            self._n = 0
        self.volume.update(moment.events[self._n :])
        self._n = len(moment.events)


class Incremental:
    """Our network, which computes what has changed since the previous decision."""

    def __init__(self, model: Model, feed: Feed) -> None:
        self._feed = feed
        self._network = CompiledClassifier(model)

    def prepare(self, moment: Moment) -> None:
        self._feed.go(moment)

    def decide(self) -> np.ndarray:
        return self._network.refresh(self._feed.volume)


class Dense:
    """A network called with the volume as an array."""

    def __init__(self, network: Network, feed: Feed) -> None:
        self._network = network
        self._feed = feed

    def prepare(self, moment: Moment) -> None:
        self._feed.go(moment)
        self._array = self._feed.volume.array

    def decide(self) -> np.ndarray:
        return self._network(self._array)


def bench_network(
    model: Model,
    networks: Mapping[str, Network],
    windows: list[np.ndarray],
    n_new: int,
    *,
    blocks: int,
    size: int,
) -> dict[str, Any]:
    """Times of networks from a finished volume to its logits.

    The volume has `n_new` events more than at the previous decision. `compare` tells what is
    returned and raised. Our incremental network is named `incremental`; ratios are to its time.

    Parameters
    ----------
    networks : other networks, as `dense_networks` makes them.
    windows : see `Moments`.
    blocks, size : number of blocks, and of decisions in each block.

    Raises
    ------
    ValueError : no window has more than `n_new` events.
    """

    def backends(one_feed: bool) -> dict[str, Backend]:
        # Call by call, all networks are at the same moment, so one volume is enough.
        feed = Feed(model)
        new_backends: dict[str, Backend] = {"incremental": Incremental(model, feed)}
        for name, network in networks.items():
            new_backends[name] = Dense(network, feed if one_feed else Feed(model))
        return new_backends

    return compare(backends, Moments(windows, model.config.window_us, n_new).blocks, blocks, size)


def fastest(names: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str | None:
    """The name of the network that took the least time in blocks, over all rows together.

    It is None if no network was timed in all rows.
    """
    total = {
        name: sum(row["in_blocks"]["us"][name]["median"] for row in results.values())
        for name in names
        if all(name in row["in_blocks"]["us"] for row in results.values())
    }
    return min(total, key=lambda name: total[name]) if total else None
