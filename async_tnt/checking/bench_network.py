"""The network alone, at batch 1, some events after the decision before: ours by what has changed, others whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt import EVENT_DTYPE, CompiledClassifier, Model, TNTVolume
from async_tnt.checking.backends import Network
from async_tnt.checking.interleaved import Contender, call_by_call, in_blocks
from async_tnt.checking.moments import Moment, Moments

N_RANDOM = 8  # volumes of random numbers, in turns
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


class OnNoise:
    """A network on volumes of random numbers, none of them zero."""

    def __init__(self, network: Network, volumes: np.ndarray) -> None:
        self._network, self._volumes, self._k = network, volumes, 0

    def prepare(self, moment: Moment) -> None:
        self._k = (self._k + 1) % N_RANDOM

    def decide(self) -> np.ndarray:
        return self._network(self._volumes[self._k])


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

    def contenders(one_feed: bool) -> dict[str, Contender]:
        feed = Feed(model)
        made: dict[str, Contender] = {"incremental": Incremental(model, feed)}
        for name, network in networks.items():
            made[name] = Dense(network, feed if one_feed else Feed(model))
        return made

    call_by_call(contenders(True), moments.blocks(1, N_WARM))  # warms up, and compares before any timing
    return {
        "call_by_call": call_by_call(contenders(True), moments.blocks(blocks, size)).report(),
        "in_blocks": in_blocks(contenders(False), moments.blocks(blocks, size)).report(),
    }


def bench_on_noise(model: Model, networks: Mapping[str, Network], *, blocks: int, size: int) -> dict[str, Any]:
    """The same on volumes of random numbers, where nothing is empty and there is nothing to be incremental about.
    Ratios are over `dense`, ours on the whole."""
    volumes = np.random.default_rng(0).standard_normal((N_RANDOM, *model.config.shape)).astype(np.float32)
    volumes.flags.writeable = False  # as a volume's own array is: else ours takes a copy
    moments = [Moment(0, np.empty(0, EVENT_DTYPE), 0)] * size

    def contenders() -> dict[str, Contender]:
        return {name: OnNoise(network, volumes) for name, network in networks.items()}

    call_by_call(contenders(), [moments[:N_WARM]])
    return {
        "call_by_call": call_by_call(contenders(), [moments] * blocks).report(),
        "in_blocks": in_blocks(contenders(), [moments] * blocks).report(),
    }


def fastest(names: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Of some networks the one that took least in blocks, over all rows together; None where none was timed."""
    total = {
        name: sum(row["in_blocks"]["us"][name]["median"] for row in results.values())
        for name in names
        if all(name in row["in_blocks"]["us"] for row in results.values())
    }
    return min(total, key=lambda name: total[name]) if total else None
