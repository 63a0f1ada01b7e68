"""What stands where on the sensor, read from a map of logits (classes and nothing, rows,
columns)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from async_tnt.kernels.decisions import objects as K
from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.volume.config import TNTConfig

REACH = 4
"""Places that an object may move from one decision to the next, and be the same one."""


LOGITS = "(1, n_classes), or a map (1, n_classes + 1, R, C)"


class Places(NamedTuple):
    """Where the places of a map lie: (x, y) = (x0 + dx column, y0 + dy row), in sensor pixels."""

    x0: float
    dx: float
    y0: float
    dy: float


def even_places(shape: Shape, sensor: tuple[int, int]) -> Places:
    """Where places lie that divide the sensor evenly."""
    dy, dx = sensor[1] / shape[1], sensor[0] / shape[2]
    return Places((dx - 1) / 2, dx, (dy - 1) / 2, dy)


class _Axis(NamedTuple):
    """Rows or columns of a map: the middle of what the first one depends on, the distance of the
    middles, in grid pixels, and how many there are."""

    first: float
    distance: float
    n: int


def places_of(layers: Sequence[Layer], config: TNTConfig) -> Places:
    """Where the places of a network's last map lie: in the middle of the pixels that a place
    depends on.

    Of several inputs the first one counts.
    """
    axes = {VOLUME: [_Axis(0.0, 1.0, config.grid[1]), _Axis(0.0, 1.0, config.grid[0])]}
    for layer in layers:
        source = axes[layer["inputs"][0]]
        axes[layer["name"]] = [_through(layer, k, axis) for k, axis in enumerate(source)]
    rows, columns = axes[layers[-1]["name"]]
    across, down = ((s - 1) / (g - 1) for s, g in zip(config.sensor, config.grid, strict=True))
    return Places(
        across * columns.first, across * columns.distance, down * rows.first, down * rows.distance
    )


def _through(layer: Layer, k: int, axis: _Axis) -> _Axis:
    if "kernel" in layer:
        reach = (layer["kernel"][k] - 1) * layer.get("dilation", (1, 1))[k]
        before, after = layer["padding"][k], layer["padding"][2 + k]
        stride = layer["stride"][k]
        n = (axis.n + before + after - reach - 1) // stride + 1
        return _Axis(axis.first + axis.distance * (reach / 2 - before), axis.distance * stride, n)
    if layer["op"] in ("adaptive_average_pool", "global_average_pool"):
        n = layer.get("size", (1, 1))[k]
        return _Axis(
            axis.first + axis.distance * (axis.n / n - 1) / 2, axis.distance * axis.n / n, n
        )
    if layer["op"] == "depth_to_space":
        block = layer["block"]
        return _Axis(
            axis.first + axis.distance * (1 / block - 1) / 2, axis.distance / block, axis.n * block
        )
    return axis


def logits_shape(shape: tuple[int, ...]) -> tuple[int, ...] | None:
    """How an answer of this shape is read: as logits (n,), or as a map (n_classes + 1, R, C); None:
    as neither.

    Examples
    --------
    >>> logits_shape((1, 10)), logits_shape((1, 10, 1, 1)), logits_shape((1, 11, 8, 9)), logits_shape((2, 10))
    ((10,), (10,), (11, 8, 9), None)
    """
    n = math.prod(shape)
    if n == 0:
        return None
    if n == max(shape, default=1):
        return (n,)
    is_map = len(shape) in (3, 4) and shape[-3] > 1 and shape[:-3] in ((), (1,))
    return shape[-3:] if is_map else None


class ObjectReader:
    """Finds the objects on maps of logits, see `kernels.objects`.

    Parameters
    ----------
    shape : (K + 1, R, C) of the maps: a channel for each class, then nothing.
    layout : of an incremental network: where the map begins, numbers from one row, column and
        channel to the next.
    sources : of an incremental network: where in its program the records of the map's changes
        begin.

    Attributes
    ----------
    found, probabilities : of the objects found last, see `kernels.objects`.
    """

    def __init__(
        self,
        shape: Shape,
        layout: tuple[int, int, int, int] | None = None,
        sources: Sequence[int] = (),
    ) -> None:
        self.shape = channels, rows, columns = shape
        about = np.zeros(K.ABOUT_SIZE + len(sources), np.int64)
        about[[K.FIRST, K.DY, K.DX, K.DK]] = layout or (0, columns, 1, rows * columns)
        about[[K.ROWS, K.COLUMNS, K.CHANNELS, K.N_SOURCES]] = rows, columns, channels, len(sources)
        about[K.ABOUT_SIZE :] = sources
        self.found = np.empty((most_objects(rows, columns), K.FOUND_SIZE))
        self.probabilities = np.empty((len(self.found), channels))
        # of zeros
        scores, peaks = np.zeros((rows, columns)), np.zeros((rows, -(-columns // 64)), np.uint64)
        self.arrays = about, scores, peaks, self.probabilities, self.found

    def read(self, logits: np.ndarray, tracks: np.ndarray, time_us: int, keep: bool) -> int:
        """How many objects a map has, float32 of this shape; -1 if a logit is not finite."""
        n: int = K.locate_on_map(
            np.ascontiguousarray(logits).reshape(-1), *self.arrays, tracks, time_us, keep
        )
        return n


def most_objects(rows: int, columns: int) -> int:
    """No two peaks are nearer than `NEAR`."""
    return math.prod(-(-side // (K.NEAR + 1)) for side in (rows, columns))


def new_tracks(places: Places, shape: Shape, memory_us: int) -> np.ndarray:
    """Where objects stand, and that none is known yet: `tracks` of `kernels.objects`.

    memory_us : how long an object that is not found is remembered.
    """
    tracks = np.zeros((K.KNOWN + 2 * min(K.MOST_TRACKED, most_objects(*shape[1:])), 4))
    tracks[0, K.MEMORY_US] = memory_us
    tracks[1, [K.X0, K.DX_PX, K.Y0, K.DY_PX]] = places
    tracks[2, [K.REACH_X, K.REACH_Y]] = REACH * places.dx, REACH * places.dy
    return tracks
