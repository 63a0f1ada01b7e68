"""The network alone on volumes of random numbers, and which of several backends was fastest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from async_tnt import EVENT_DTYPE, Model
from experiments.bench_backends import Network
from experiments.bench_interleaved import Backend, compare
from experiments.bench_moments import Moment

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
    """Time networks as `bench_network` does, on volumes of random numbers: nothing is empty, nothing can be reused.
    Ratios are over `dense`, our full forward pass."""
    volumes = np.random.default_rng(0).standard_normal((N_RANDOM, *model.config.shape)).astype(np.float32)
    volumes.flags.writeable = False  # as a volume's own array is: else ours takes a copy
    moments = [Moment(0, np.empty(0, EVENT_DTYPE), 0)] * size

    def backends(alternating: bool) -> dict[str, Backend]:
        return {name: OnNoise(network, volumes) for name, network in networks.items()}

    return compare(backends, lambda n, n_calls: [moments[:n_calls]] * n, blocks, size)


def fastest(names: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str | None:
    """The network that took the least time in blocks, over all rows together; None if none was timed."""
    total = {
        name: sum(row["in_blocks"]["us"][name]["median"] for row in results.values())
        for name in names
        if all(name in row["in_blocks"]["us"] for row in results.values())
    }
    return min(total, key=lambda name: total[name]) if total else None
