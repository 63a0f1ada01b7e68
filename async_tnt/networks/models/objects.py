"""The objects on the sensor and their places, read from a map of logits.

The map has the shape (n_classes + 1, rows, columns). Its last channel means "no object here". With
two channels more it also says how large objects are, and with four also where their middles are,
see `kernels.decisions.objects`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from async_tnt.kernels.decisions import objects as K
from async_tnt.networks.layers.graph import VOLUME
from async_tnt.networks.layers.layer import Layer, Shape
from async_tnt.networks.layers.operations import OPERATIONS
from async_tnt.networks.layers.places import Axis, axis_through_window
from async_tnt.volume.config import TNTConfig

REACH = 4
"""How many places an object may move between two decisions and still be the same object."""

LOGITS_SHAPES = "(1, n_classes), or a map (1, n_classes + n, R, C) with n of 1, 3 or 5"
"""The shapes of a network's answer, for messages."""

OF_BOXES = (2, 4)
"""How many channels of a map may say what boxes objects have, behind the channel for nothing."""


class Places(NamedTuple):
    """Where the places of a map lie: (x, y) = (x0 + dx column, y0 + dy row), in sensor pixels."""

    x0: float
    dx: float
    y0: float
    dy: float


def even_places(shape: Shape, sensor: tuple[int, int]) -> Places:
    """The places of a map of this shape, (K + 1, R, C), if they divide the sensor evenly."""
    width, height = sensor
    _, rows, columns = shape
    dx = width / columns
    dy = height / rows
    # the first place lies in the middle of the pixels from 0 to dx - 1
    return Places((dx - 1) / 2, dx, (dy - 1) / 2, dy)


def places_of(layers: Sequence[Layer], config: TNTConfig) -> Places:
    """Where on the sensor the places of a network's last map lie.

    A place lies in the middle of the pixels that it depends on. For a layer with several inputs,
    only the first input is followed.
    """
    width, height = config.grid
    axes = {VOLUME: (Axis(0.0, 1.0, height), Axis(0.0, 1.0, width))}
    for layer in layers:
        operation = OPERATIONS.get(layer["op"])  # None in a file of a later release
        places_rule = axis_through_window if operation is None else operation.places
        rows, columns = axes[layer["inputs"][0]]
        axes[layer["name"]] = (places_rule(layer, 0, rows), places_rule(layer, 1, columns))

    rows, columns = axes[layers[-1]["name"]]
    # how many sensor pixels lie between two neighbouring grid pixels
    across, down = (
        1.0 if side == sensor_side else (sensor_side - 1) / (side - 1)
        for side, sensor_side in zip(config.grid, config.sensor, strict=True)
    )
    return Places(
        across * columns.first, across * columns.distance, down * rows.first, down * rows.distance
    )


def n_of_boxes(channels: int, n_classes: int) -> int:
    """How many of a map's channels say what boxes objects have: one of `OF_BOXES`, or 0.

    Examples
    --------
    >>> n_of_boxes(11, 10), n_of_boxes(13, 10), n_of_boxes(15, 10)
    (0, 2, 4)
    """
    n = channels - n_classes - 1
    return n if n in OF_BOXES else 0


def logits_shape(shape: tuple[int, ...]) -> tuple[int, ...] | None:
    """The shape in which an answer of this shape is read; None if it cannot be read.

    An answer is read as logits (n,), or as a map (n_classes + 1, R, C).

    Examples
    --------
    >>> logits_shape((1, 10)), logits_shape((1, 10, 1, 1))
    ((10,), (10,))
    >>> logits_shape((1, 11, 8, 9)), logits_shape((2, 10))
    ((11, 8, 9), None)
    """
    n = math.prod(shape)
    if n == 0:
        return None
    if n == max(shape, default=1):  # all other sides are 1
        return (n,)
    is_one_map = len(shape) == 3 or (len(shape) == 4 and shape[0] == 1)
    if is_one_map and shape[-3] > 1:
        return shape[-3:]
    return None


class ObjectReader:
    """Finds the objects on maps of logits, see `kernels.decisions.objects`.

    Parameters
    ----------
    shape : (K + 1, R, C) of the maps: a channel for each class, then one for "no object here"; or
        (K + 3, R, C), with two more for the sizes of objects; or (K + 5, R, C), with two more for
        their middles.
    n_classes : K; None: maps have no sizes.
    layout : only for an incremental network: where its map begins, and the strides of the map's
        rows, columns and channels, in numbers.
    sources : only for an incremental network: where in its program the records of the map's changes
        begin.

    Attributes
    ----------
    found, probabilities : the objects found last, see `kernels.decisions.objects`.
    n_classes : K.
    has_sizes : whether maps say how large objects are.
    """

    def __init__(
        self,
        shape: Shape,
        n_classes: int | None = None,
        layout: tuple[int, int, int, int] | None = None,
        sources: Sequence[int] = (),
    ) -> None:
        self.shape = shape
        self.n_classes = shape[0] - 1 if n_classes is None else n_classes
        of_boxes = n_of_boxes(shape[0], self.n_classes)
        self.has_sizes = of_boxes > 0
        channels = self.n_classes + 1
        _, rows, columns = shape
        about = np.zeros(K.ABOUT_SIZE + len(sources), np.int64)
        about[[K.FIRST, K.DY, K.DX, K.DK]] = layout or (0, columns, 1, rows * columns)
        about[[K.ROWS, K.COLUMNS, K.CHANNELS, K.N_SOURCES]] = rows, columns, channels, len(sources)
        about[K.N_OF_BOXES] = of_boxes
        about[K.ABOUT_SIZE :] = sources
        self.found = np.empty((most_objects(rows, columns), K.FOUND_SIZE))
        self.probabilities = np.empty((len(self.found), channels))
        # the scores and peaks of a map of zeros
        scores = np.zeros((rows, columns))
        n_words = -(-columns // 64)  # rounded up: a bit for each column
        peaks = np.zeros((rows, n_words), np.uint64)
        self.arrays = (about, scores, peaks, self.probabilities, self.found)

    def read(self, logits: np.ndarray, tracks: np.ndarray, time_us: int, keep: bool) -> int:
        """Find the objects on a map; returns their number, or -1 if a logit is not finite.

        Parameters
        ----------
        logits : the map, float32 of the shape `shape`.
        tracks, time_us, keep : see `kernels.decisions.objects.locate_on_map`.
        """
        n: int = K.locate_on_map.call(
            np.ascontiguousarray(logits).reshape(-1), *self.arrays, tracks, time_us, keep
        )
        return n


def most_objects(rows: int, columns: int) -> int:
    """The largest number of objects on a map.

    It is limited because two peaks are more than `NEAR` places apart, in y or in x. So a block of
    (NEAR + 1) x (NEAR + 1) places has at most one peak.
    """
    # rounded up
    rows_of_blocks = -(-rows // (K.NEAR + 1))
    columns_of_blocks = -(-columns // (K.NEAR + 1))
    return rows_of_blocks * columns_of_blocks


def new_tracks(places: Places, shape: Shape, memory_us: int) -> np.ndarray:
    """New `tracks` for `kernels.decisions.objects`: they hold no known object yet.

    Parameters
    ----------
    shape : (K + 1, R, C) of the maps.
    memory_us : how long an object that is not found is remembered.
    """
    _, rows, columns = shape
    n_tracked = min(K.MOST_TRACKED, most_objects(rows, columns))
    tracks = np.zeros((K.KNOWN + 2 * n_tracked, K.TRACK_SIZE))
    tracks[K.HEAD, K.MEMORY_US] = memory_us
    tracks[K.ON_SENSOR, [K.X0, K.DX_PX, K.Y0, K.DY_PX]] = places
    tracks[K.REACH, [K.REACH_X, K.REACH_Y]] = REACH * places.dx, REACH * places.dy
    return tracks
