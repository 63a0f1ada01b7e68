"""A model's classifier as the flat arrays that the kernels work on (see `kernels.plan`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from async_tnt.kernels import layout as P
from async_tnt.kernels.conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2
from async_tnt.kernels.dense import UNITS
from async_tnt.kernels.registers import LANES
from async_tnt.networks.model import Model


class Network(NamedTuple):
    """Arrays in the order in which the kernels take them."""

    plan: np.ndarray
    weights: np.ndarray
    maps: np.ndarray
    dirty: np.ndarray


def new_network(model: Model) -> Network:
    """The classifier of a model; its input is zero, and everything is to be computed."""
    channels, height, width = model.config.shape
    w = model.weights
    plan = np.zeros(P.SIZE + channels + 1, np.int64)
    plan[P.CHANNELS], plan[P.HEIGHT], plan[P.WIDTH] = channels, height, width
    f_used, g_used, u_used, n_classes = (len(w[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1", "fc2"))
    f, g, u, k = _up(f_used, FILTERS_1), _up(g_used, FILTERS_2), _up(u_used, UNITS), _up(n_classes, LANES)
    plan[[P.F, P.F_USED, P.G, P.G_USED, P.U, P.U_USED, P.K]] = f, f_used, g, g_used, u, u_used, k
    rows_1, columns_1 = height // 2, width // 2
    rows_2, columns_2 = rows_1 // 2, columns_1 // 2
    plan[[P.ROWS_1, P.COLUMNS_1, P.ROWS_2, P.COLUMNS_2]] = rows_1, columns_1, rows_2, columns_2

    beyond = 4 * (CELLS_1 + CELLS_2) * max(channels, f)  # a tile wider than its map reads so far past the end
    n_maps = _lay_out(
        plan,
        {
            P.INPUT: (height + 2) * channels * (width + 2),
            P.POOLED_1: (rows_1 + 2) * (columns_1 + 2) * f,
            P.POOLED_2: rows_2 * columns_2 * g,
            P.PARTIAL: rows_2 * columns_2 * u,
            P.ROW_SUMS: rows_2 * u,
            P.HIDDEN: u,
            P.LOGITS: k,
            P.TILE: max(width + 2, CELLS_1 * FILTERS_1, CELLS_2 * FILTERS_2) + beyond,
        },
    )
    n_dirty = _lay_out(
        plan,
        {
            P.DIRTY_1: rows_1 * (1 + columns_1),
            P.DIRTY_2: rows_2 * (1 + columns_2),
            P.DIRTY_3: rows_2 * (1 + columns_2),
        },
    )

    conv1 = _padded(w["conv1.weight"], f).reshape(-1, FILTERS_1, channels, 9).transpose(0, 2, 3, 1)
    conv2 = _padded(w["conv2.weight"], g).reshape(-1, FILTERS_2, f_used, 9).transpose(0, 3, 2, 1)
    dense1 = _padded(w["fc1.weight"], u).reshape(-1, UNITS, g_used, rows_2 * columns_2).transpose(3, 0, 2, 1)
    parts = {
        P.CONV_1: conv1,  # (block, channel, tap, filter of the block)
        P.BIAS_1: _padded(w["conv1.bias"], f),
        P.CONV_2: conv2,  # (block, tap, channel, filter of the block)
        P.BIAS_2: _padded(w["conv2.bias"], g),
        P.DENSE_1: dense1,  # (place, block, filter, unit of the block)
        P.BIAS_3: _padded(w["fc1.bias"], u),
        P.DENSE_2: _padded(w["fc2.weight"], k).T,  # (unit, class)
        P.BIAS_4: _padded(w["fc2.bias"], k),
    }
    _lay_out(plan, {slot: part.size for slot, part in parts.items()})
    weights = np.concatenate([np.ascontiguousarray(part).reshape(-1) for part in parts.values()])
    return Network(plan, weights, np.zeros(n_maps, np.float32), np.ones(n_dirty, np.uint8))


def _lay_out(plan: np.ndarray, sizes: dict[int, int]) -> int:
    """Place parts one behind the other; returns where they end."""
    end = 0
    for slot, size in sizes.items():
        plan[slot] = end
        end += size
    return end


def _padded(array: np.ndarray, n: int) -> np.ndarray:
    """With zeros behind the last, so that there are n."""
    return np.concatenate([array, np.zeros((n - len(array), *array.shape[1:]), np.float32)])


def _up(n: int, step: int) -> int:
    return -(-n // step) * step
