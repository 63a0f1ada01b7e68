"""The layers of a model's networks, as its file lists them.

    {"classifier": [layer, ...], "regressor": [layer, ...]}      the regressor where the configuration needs one

A layer is an object with `name`, `op`, `inputs` and the parameters of its op. Inputs are names of earlier layers or
"volume", the network's input (C, H, W); a layer may have several, as a sum or a concatenation has. The last layer is
the network's output. `weights` maps each role to the name of a tensor in the file; a convolution without a bias has
only `weight`. Sides are [y, x], paddings [top, left, bottom, right].

    op                 parameters
    conv               weights, kernel, stride, padding, dilation, groups
    relu
    average_pool       kernel, stride, padding
    flatten            to (C * H * W,), in C order
    dense              weights
    heatmap_centroid   to (x, y) in grid pixels: the mean place under a softmax over all places

Every parameter is written, so readers need no defaults. Networks of other ops or parameters can be written in the same
format: a release that cannot run them refuses the file. This one runs one graph for each configuration, the one that
`layer_graph` returns.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any

from async_tnt.config import TNTConfig

Layer = dict[str, Any]
Step = tuple[str, str, Layer]  # name, op, parameters


def layer_graph(config: TNTConfig) -> dict[str, list[Layer]]:
    """The graph of the networks that this release runs for a configuration."""
    pool = {"kernel": [2, 2], "stride": [2, 2], "padding": [0, 0, 0, 0]}
    halves = [s for k in (1, 2) for s in (_conv(f"conv{k}"), _relu(k), (f"pool{k}", "average_pool", pool))]
    dense = [("flatten", "flatten", {}), _dense("fc1"), _relu(3), _dense("fc2")]
    graph = {"classifier": _chain(*halves, *dense)}
    if config.needs_regressor:
        steps = [s for k in (1, 2, 3) for s in (_conv(f"conv{k}", "regressor."), _relu(k))]
        heatmap = _conv("heatmap", "regressor.", side=1, roles=("weight",))
        graph["regressor"] = _chain(*steps, heatmap, ("landmark", "heatmap_centroid", {}))
    return graph


def check_layer_graph(graph: Any, config: TNTConfig) -> None:
    """Refuse a graph other than `layer_graph(config)`.

    Raises
    ------
    NotImplementedError : names the first thing that this release cannot run.
    ValueError : it is not a graph.
    """
    known = layer_graph(config)
    if not isinstance(graph, dict) or not all(isinstance(layers, list) for layers in graph.values()):
        raise ValueError(f"`network` must map names to lists of layers, got {reprlib.repr(graph)}")
    if set(graph) != set(known):
        raise NotImplementedError(f"its networks are {', '.join(graph) or 'none'}, expected {', '.join(known)}")
    for network, layers in known.items():
        pairs: Iterator[tuple[Any, Layer]] = zip_longest(graph[network], layers, fillvalue={})
        for k, (layer, expected) in enumerate(pairs):
            found = layer if isinstance(layer, dict) else {"op": layer}
            for key in {"op": None, **expected, **found}:
                if key not in found or key not in expected or found[key] != expected[key]:
                    raise NotImplementedError(
                        f"layer {k} of its {network} has {key} {_shown(found, key)}, expected {_shown(expected, key)}"
                    )


def _chain(*steps: Step) -> list[Layer]:
    names = ["volume", *(name for name, _, _ in steps)]
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


def _shown(layer: Mapping[str, Any], key: str) -> str:
    return reprlib.repr(layer[key]) if key in layer else "nothing"
