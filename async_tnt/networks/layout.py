"""A model's weights and feature maps as the arrays that the kernels work on, and volumes as they take them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from async_tnt.checks import plain_array
from async_tnt.kernels import layout as L
from async_tnt.kernels.conv import FILTERS, PLACES
from async_tnt.kernels.conv_pool import CELLS_1, CELLS_2, FILTERS_1, FILTERS_2
from async_tnt.kernels.dense import UNITS
from async_tnt.kernels.simd import LANES
from async_tnt.networks.model import HEATMAP, REGRESSOR_LAYERS, Model


class ClassifierArrays(NamedTuple):
    """What `kernels.layout` describes, in the order in which the kernels take it."""

    layout: np.ndarray
    weights: np.ndarray
    maps: np.ndarray
    dirty: np.ndarray


def classifier_arrays(model: Model) -> ClassifierArrays:
    """The classifier of a model; its input is zero, and everything is dirty."""
    channels, height, width = model.config.shape
    w = model.weights
    layout = np.zeros(L.ACTIVE + channels + 1, np.int64)
    layout[[L.CHANNELS, L.HEIGHT, L.WIDTH]] = channels, height, width
    f_used, g_used, u_used, n_classes = (len(w[f"{layer}.bias"]) for layer in ("conv1", "conv2", "fc1", "fc2"))
    f, g, u, k = _up(f_used, FILTERS_1), _up(g_used, FILTERS_2), _up(u_used, UNITS), _up(n_classes, LANES)
    layout[[L.F, L.F_USED, L.G, L.G_USED, L.U, L.U_USED, L.K]] = f, f_used, g, g_used, u, u_used, k
    rows_1, columns_1 = height // 2, width // 2
    rows_2, columns_2 = rows_1 // 2, columns_1 // 2
    layout[[L.ROWS_1, L.COLUMNS_1, L.ROWS_2, L.COLUMNS_2]] = rows_1, columns_1, rows_2, columns_2

    beyond = 4 * (CELLS_1 + CELLS_2) * max(channels, f)  # a tile wider than its map reads this far past the end
    n_maps = _place_parts(
        layout,
        {
            L.INPUT: (height + 2) * channels * (width + 2),
            L.POOLED_1: (rows_1 + 2) * (columns_1 + 2) * f,
            L.POOLED_2: rows_2 * columns_2 * g,
            L.PARTIAL: rows_2 * columns_2 * u,
            L.ROW_SUMS: rows_2 * u,
            L.HIDDEN: u,
            L.LOGITS: k,
            L.TILE: max(width + 2, CELLS_1 * FILTERS_1, CELLS_2 * FILTERS_2) + beyond,
        },
    )
    n_dirty = _place_parts(
        layout,
        {
            L.DIRTY_1: rows_1 * (1 + columns_1),
            L.DIRTY_2: rows_2 * (1 + columns_2),
            L.DIRTY_3: rows_2 * (1 + columns_2),
        },
    )
    parts = {
        L.CONV_1: _blocks(w["conv1.weight"], FILTERS_1).transpose(0, 2, 3, 1),  # (block, channel, tap, filter)
        L.BIAS_1: _blocks(w["conv1.bias"], FILTERS_1),
        L.CONV_2: _blocks(w["conv2.weight"], FILTERS_2).transpose(0, 3, 2, 1),  # (block, tap, channel, filter)
        L.BIAS_2: _blocks(w["conv2.bias"], FILTERS_2),
        L.DENSE_1: _blocks(w["fc1.weight"].reshape(u_used, g_used, -1), UNITS).transpose(3, 0, 2, 1),
        L.BIAS_3: _blocks(w["fc1.bias"], UNITS),  # above: (place, block, filter, unit)
        L.DENSE_2: _blocks(w["fc2.weight"], k)[0].T,  # (unit, class)
        L.BIAS_4: _blocks(w["fc2.bias"], k),
    }
    _place_parts(layout, {slot: part.size for slot, part in parts.items()})
    weights = np.concatenate([np.ascontiguousarray(part).reshape(-1) for part in parts.values()])
    return ClassifierArrays(layout, weights, np.zeros(n_maps, np.float32), np.ones(n_dirty, np.uint8))


def regressor_arrays(model: Model) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """The landmark network of a model: `layers` and `maps` of `kernels.heatmap.find_landmark`."""
    w = model.weights
    channels, height, width = model.config.shape
    layers = [array for layer in REGRESSOR_LAYERS for array in _conv_arrays(w, layer)]
    f_1, f_2, f_3 = (len(w[f"{layer}.bias"]) for layer in REGRESSOR_LAYERS)
    n_places = _up(height * (width + 2), PLACES)
    framed = n_places + 2 * (width + 2) + 2  # with the frame, and what the last places read beyond it
    shapes = (channels, framed), (f_1, framed), (f_2, framed), (_up(max(f_1, f_2, f_3), FILTERS), n_places), n_places
    return (*layers, w[HEATMAP].flatten()), tuple(np.zeros(shape, np.float32) for shape in shapes)


def _conv_arrays(weights: Mapping[str, np.ndarray], layer: str) -> tuple[np.ndarray, np.ndarray]:
    """Filters (blocks, C, 9, 8) and biases (blocks, 8) as `kernels.conv.convolve` takes them."""
    filters = _blocks(weights[f"{layer}.weight"], FILTERS).transpose(0, 2, 3, 1)
    return np.ascontiguousarray(filters), _blocks(weights[f"{layer}.bias"], FILTERS)


def _blocks(array: np.ndarray, size: int) -> np.ndarray:
    """Rows in blocks of this size, padded with zeros: (N, ...) -> (blocks, size, ...); of filters, taps flattened."""
    if array.ndim == 4:
        array = array.reshape(*array.shape[:2], 9)
    padding = np.zeros((_up(len(array), size) - len(array), *array.shape[1:]), np.float32)
    return np.concatenate([array, padding]).reshape(-1, size, *array.shape[1:])


def _place_parts(layout: np.ndarray, sizes: dict[int, int]) -> int:
    """Place parts one after the other; returns where the last one ends."""
    ends = np.cumsum(list(sizes.values()))
    layout[list(sizes)] = ends - list(sizes.values())
    return int(ends[-1])


def _up(n: int, step: int) -> int:
    return -(-n // step) * step


class VolumeInput:
    """Passes volumes to a kernel in one form, that of `TNTVolume.array`, so that it is compiled only once."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.shape = shape
        self._copy = np.zeros(shape, np.float32)

    def __call__(self, volume: np.ndarray) -> np.ndarray:
        """float32, contiguous, read-only: the volume itself where it is so, else a copy, valid until the next call.

        Raises
        ------
        ValueError : another shape.
        """
        volume = plain_array("volume", volume)
        if volume.shape != self.shape:
            raise ValueError(f"`volume` must have shape {self.shape}, got {volume.shape}")
        if volume.dtype == np.float32 and volume.flags.c_contiguous and not volume.flags.writeable:
            return volume
        np.copyto(self._copy, volume)
        view = self._copy.view()
        view.flags.writeable = False
        return view
