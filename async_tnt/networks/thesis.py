"""The thesis' two networks as layers: what a model has whose network is not given.

The classifier: two convolutions with ReLU, each followed by average pooling, then two dense layers. The landmark
regressor: three convolutions with ReLU, then one 1x1, and the heatmap's centroid (Wang 2019; widths are the weights').
"""

from __future__ import annotations

from typing import Any

from async_tnt.config import TNTConfig
from async_tnt.networks.graph import CLASSIFIER, REGRESSOR, VOLUME

Step = tuple[str, str, dict[str, Any]]  # name, op, parameters


def thesis_network(config: TNTConfig) -> dict[str, list[dict[str, Any]]]:
    """Its layers, of the regressor where the configuration needs one."""
    pool = {"kernel": [2, 2], "stride": [2, 2], "padding": [0, 0, 0, 0]}
    halves = [s for k in (1, 2) for s in (_conv(f"conv{k}"), _relu(k), (f"pool{k}", "average_pool", pool))]
    dense = [("flatten", "flatten", {}), _dense("fc1"), _relu(3), _dense("fc2")]
    network = {CLASSIFIER: _chain(*halves, *dense)}
    if config.needs_regressor:
        steps = [s for k in (1, 2, 3) for s in (_conv(f"conv{k}", "regressor."), _relu(k))]
        heatmap = _conv("heatmap", "regressor.", side=1, roles=("weight",))  # a bias would not move the centroid
        network[REGRESSOR] = _chain(*steps, heatmap, ("landmark", "heatmap_centroid", {}))
    return network


def _chain(*steps: Step) -> list[dict[str, Any]]:
    names = [VOLUME, *(name for name, _, _ in steps)]
    return [
        {"op": op, "name": name, "inputs": [before], **parameters}
        for before, (name, op, parameters) in zip(names, steps, strict=False)
    ]


def _conv(name: str, prefix: str = "", side: int = 3, roles: tuple[str, ...] = ("weight", "bias")) -> Step:
    """A convolution that keeps the size."""
    weights = {role: f"{prefix}{name}.{role}" for role in roles}
    sides = {"kernel": [side, side], "stride": [1, 1], "padding": [side // 2] * 4, "dilation": [1, 1]}
    return name, "conv", {"weights": weights, **sides, "groups": 1}


def _relu(k: int) -> Step:
    return f"relu{k}", "relu", {}


def _dense(name: str) -> Step:
    return name, "dense", {"weights": {role: f"{name}.{role}" for role in ("weight", "bias")}}
