"""The network alone, at batch 1, some events after the decision before: ours by what has changed, others whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Model, TNTVolume
from async_tnt.checking.backends import Network
from async_tnt.checking.interleaved import Backend, call_by_call, in_blocks
from async_tnt.checking.moments import Moment, Moments

N_WARM = 20  # decisions that are only compared


class Feed:
    """A volume that is brought to a moment, which is not timed."""

    def __init__(self, model: Model) -> None:
        self.volume = TNTVolume(model.config)
        self._start_us, self._n = -1, 0

    def go(self, moment: Moment) -> None:
        if moment.start_us != self._start_us:
            self.volume.open(moment.start_us)
            self._start_us, self._n = moment.start_us, 0
        self.volume.update(moment.events[self._n :])
        self._n = len(moment.events)


class Incremental:
    """Ours, where it knows the volume from the decision before."""

    def __init__(self, model: Model, feed: Feed) -> None:
        self._feed, self._network = feed, CompiledClassifier(model)

    def prepare(self, moment: Moment) -> None:
        self._feed.go(moment)

    def decide(self) -> np.ndarray:
        return self._network.refresh(self._feed.volume)


class Dense:
    """A network that takes the volume as an array, which is read for it."""

    def __init__(self, network: Network, feed: Feed) -> None:
        self._network, self._feed = network, feed

    def prepare(self, moment: Moment) -> None:
        self._feed.go(moment)
        self._array = self._feed.volume.array

    def decide(self) -> np.ndarray:
        return self._network(self._array)


def bench_network(
    model: Model, networks: Mapping[str, Network], windows: list[np.ndarray], n_new: int, *, blocks: int, size: int
) -> dict[str, Any]:
    """Time networks from a finished volume to its logits, `n_new` events after the decision before.

    Parameters
    ----------
    networks : as `dense_networks` makes them.
    windows : see `Moments`.
    blocks, size : so many blocks of so many decisions each.

    Returns
    -------
    dict : both ways of taking turns -> `Timed.report`. Ratios are over `incremental`, which is ours.

    Raises
    ------
    WorkDiffers : networks do not agree.
    ValueError : no window has so many events.
    """
    moments = Moments(windows, model.config.window_us, n_new)

    def backends(one_feed: bool) -> dict[str, Backend]:
        feed = Feed(model)
        made: dict[str, Backend] = {"incremental": Incremental(model, feed)}
        for name, network in networks.items():
            made[name] = Dense(network, feed if one_feed else Feed(model))
        return made

    call_by_call(backends(True), moments.blocks(1, N_WARM))  # warms up, and compares before any timing
    return {
        "call_by_call": call_by_call(backends(True), moments.blocks(blocks, size)).report(),
        "in_blocks": in_blocks(backends(False), moments.blocks(blocks, size)).report(),
    }
