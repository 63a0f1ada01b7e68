"""What a decision has to compute: cells of each layer that new events change, and those that they can reach.

A pixel of a map reaches the cells of the next one whose 2x2 places lie within one pixel of it (the 3x3 taps). Reached
cells are computed; if they do not change, the next layer is unaffected: the transform drops many events, and a change
ends where every filter's ReLU stays at zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt import CompiledClassifier, Model
from async_tnt.checking.bench_network import Feed
from async_tnt.checking.moments import NEW_EVENTS, Moments
from async_tnt.kernels import layout as L

LAYERS = ("input", "pooled_1", "pooled_2", "partial")


def bench_touched(model: Model, windows: list[np.ndarray], *, moments: int) -> dict[str, Any]:
    """Count over many moments: new events -> layer -> mean `changed` cells, and mean `reached` ones.

    `input` counts cells of the volume, the others places of a map, all filters of a place together. `multiplications`
    and `weight_bytes` follow from the reached ones, without what empty time bins spare and tiles that are wider than
    a place add; `whole` is the same for the whole network.
    """
    places = _places(model)
    result: dict[str, Any] = {"whole": {"changed": places, "reached": places, **_work(model, places)}}
    for n_new in NEW_EVENTS:
        try:
            of_these = Moments(windows, model.config.window_us, n_new)
        except ValueError:
            continue
        counts = [_count(model, block) for block in of_these.blocks(max(1, moments // 20), 20)]
        means = {
            kind: {layer: float(np.mean([c[kind][layer] for block in counts for c in block])) for layer in LAYERS}
            for kind in ("changed", "reached")
        }
        result[str(n_new)] = {**means, **_work(model, means["reached"])}
    return result


def _count(model: Model, block: list[Any]) -> list[dict[str, dict[str, float]]]:
    network, feed = CompiledClassifier(model), Feed(model)
    counts = []
    for moment in block:
        if not moment.follows:
            feed.go(moment.before)
            network.refresh(feed.volume)
        before = _maps(network)
        feed.go(moment)
        network.refresh(feed.volume)
        differ = {layer: now != before[layer] for layer, now in _maps(network).items()}
        pixels = differ["input"].any(axis=1)
        places = {layer: differ[layer].any(axis=2) for layer in LAYERS[1:]}
        reached_1 = _reached(pixels, places["pooled_1"].shape)
        reached_2 = _reached(places["pooled_1"], places["pooled_2"].shape)
        counts.append(
            {
                "changed": {"input": float(differ["input"].sum()), **{k: float(v.sum()) for k, v in places.items()}},
                "reached": {
                    "input": float(8 * moment.n_new),
                    "pooled_1": float(reached_1.sum()),
                    "pooled_2": float(reached_2.sum()),
                    "partial": float(places["pooled_2"].sum()),
                },
            }
        )
    return counts


def _maps(network: CompiledClassifier) -> dict[str, np.ndarray]:
    """Copies: input (H, C, W), the others (rows, columns, filters or units)."""
    layout, maps = network.network.layout, network.network.maps
    channels, height, width = (int(layout[k]) for k in (L.CHANNELS, L.HEIGHT, L.WIDTH))
    rows_1, columns_1, rows_2, columns_2 = (int(layout[k]) for k in (L.ROWS_1, L.COLUMNS_1, L.ROWS_2, L.COLUMNS_2))

    def part(place: int, *shape: int) -> np.ndarray:
        first = int(layout[place])
        return maps[first : first + int(np.prod(shape))].reshape(shape).copy()

    return {
        "input": part(L.INPUT, height + 2, channels, width + 2)[1:-1, :, 1:-1],
        "pooled_1": part(L.POOLED_1, rows_1 + 2, columns_1 + 2, int(layout[L.F]))[1:-1, 1:-1],
        "pooled_2": part(L.POOLED_2, rows_2, columns_2, int(layout[L.G])),
        "partial": part(L.PARTIAL, rows_2, columns_2, int(layout[L.U])),
    }


def _reached(changed: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The cells of the next map that these can reach: bool (rows, columns) of `shape`."""
    rows, columns = shape[:2]
    framed = np.zeros((2 * rows + 2, 2 * columns + 2), bool)
    part = changed[: 2 * rows + 1, : 2 * columns + 1]  # an odd last row reaches the last cells too, through the taps
    framed[1 : 1 + part.shape[0], 1 : 1 + part.shape[1]] = part
    reached = np.zeros((rows, columns), bool)
    for i in range(4):
        for j in range(4):
            reached |= framed[i : i + 2 * rows : 2, j : j + 2 * columns : 2]
    return reached


def _places(model: Model) -> dict[str, float]:
    channels, height, width = model.config.shape
    places_2 = (height // 4) * (width // 4)
    return {
        "input": channels * height * width,
        "pooled_1": (height // 2) * (width // 2),
        "pooled_2": places_2,
        "partial": places_2,
    }


def _work(model: Model, reached: dict[str, float]) -> dict[str, float]:
    """Multiplications, and bytes of the weights that they read, for a number of places of each layer."""
    w = model.weights
    sizes = {name: w[f"{name}.weight"].size for name in ("conv1", "conv2", "fc1", "fc2")}
    _, height, width = model.config.shape
    a_place = sizes["fc1"] / ((height // 4) * (width // 4))
    partial = reached["partial"] * a_place
    return {
        "multiplications": 4 * reached["pooled_1"] * sizes["conv1"]
        + 4 * reached["pooled_2"] * sizes["conv2"]
        + partial
        + sizes["fc2"],
        "weight_bytes": 4.0
        * (
            (reached["pooled_1"] > 0) * sizes["conv1"]
            + (reached["pooled_2"] > 0) * sizes["conv2"]
            + partial
            + sizes["fc2"]
        ),
    }
