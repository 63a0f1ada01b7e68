"""The network alone on volumes of random numbers, and which of several backends was fastest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt import EVENT_DTYPE, Model
from async_tnt.checking.backends import Network
from async_tnt.checking.bench_network import N_WARM
from async_tnt.checking.interleaved import Backend, call_by_call, in_blocks
from async_tnt.checking.moments import Moment

N_RANDOM = 8  # volumes of random numbers, used in rotation


class OnNoise:
    """A network on volumes of random numbers, none of them zero."""

    def __init__(self, network: Network, volumes: np.ndarray) -> None:
        self._network, self._volumes, self._k = network, volumes, 0

    def prepare(self, moment: Moment) -> None:
        self._k = (self._k + 1) % N_RANDOM

    def decide(self) -> np.ndarray:
        return self._network(self._volumes[self._k])


def bench_on_noise(model: Model, networks: Mapping[str, Network], *, blocks: int, size: int) -> dict[str, Any]:
    """The same on volumes of random numbers, where nothing is empty and there is nothing to be incremental about.
    Ratios are over `dense`, ours on the whole."""
    volumes = np.random.default_rng(0).standard_normal((N_RANDOM, *model.config.shape)).astype(np.float32)
    volumes.flags.writeable = False  # as a volume's own array is: else ours takes a copy
    moments = [Moment(0, np.empty(0, EVENT_DTYPE), 0)] * size

    def backends() -> dict[str, Backend]:
        return {name: OnNoise(network, volumes) for name, network in networks.items()}

    call_by_call(backends(), [moments[:N_WARM]])
    return {
        "call_by_call": call_by_call(backends(), [moments] * blocks).report(),
        "in_blocks": in_blocks(backends(), [moments] * blocks).report(),
    }


def fastest(names: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Of some networks the one that took least in blocks, over all rows together; None where none was timed."""
    total = {
        name: sum(row["in_blocks"]["us"][name]["median"] for row in results.values())
        for name in names
        if all(name in row["in_blocks"]["us"] for row in results.values())
    }
    return min(total, key=lambda name: total[name]) if total else None
