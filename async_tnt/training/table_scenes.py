"""Scenes of recordings whose tables say what stands where: whole windows of the sensor.

A scene is the window of a recording that ends at a moment of its table. The boxes of that moment
are its objects. So a model learns the real background, too, and how a camera moves past it.

    start     The window ends at the moment of the boxes. Where augmentation ends a window early, it
              begins later instead: what a stream shows soon after a window's start.
    boxes     Boxes move with the events. What reaches beyond the sensor is cut off. An object
              counts while the middle of its whole box is on the sensor.
    events    An object counts if its box has more events than noise would leave there, by
              `FEWEST_A_PX` for each pixel of the box's border. So what stands still before a
              camera that stands still is no object.
    nothing   Augmentation makes some windows show nothing. They have no objects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from async_tnt.kernels.training.window_batches import SHOWN
from async_tnt.training.augment import Draws
from async_tnt.training.batches import BatchVolumes
from async_tnt.training.scenes import (
    FEWEST_A_PX,
    EventsOfCells,
    SceneMaker,
    Scenes,
    check_volume,
)
from async_tnt.training.windows import Windows
from async_tnt.volume.config import TNTConfig

AT_ONCE = 16
"""Number of windows that are scored at a time. They are of the whole sensor."""
BLOCK = 8
"""Side of a block of cells whose mean tells how much noise there is, in cells."""
QUIET = 25
"""Percentile of the blocks of a window that stands for its noise. It is low, because much of what a
moving camera sees is background, which has events of its own."""


def maker_of(
    config: TNTConfig, scenes: TNTConfig | None, windows: Windows
) -> SceneMaker | TableScenes:
    """What makes scenes of windows: of several objects, or of a whole window with its boxes.

    Parameters
    ----------
    config, scenes : see `SceneMaker`.
    windows : windows of the recordings to make scenes of. There may be none.

    Raises
    ------
    ValueError : as `check_volume`.
    """
    if windows.recordings.boxes is None:
        return SceneMaker(config, scenes)
    return TableScenes(config)


class TableScenes:
    """Makes a scene of each window whose boxes are known.

    Parameters
    ----------
    config : how events become volumes.

    Attributes
    ----------
    config, crops : how events become volumes.
    n_windows : number of windows that a scene is made of.
    at_once : number of windows that are made to scenes at a time when a model is scored.

    Raises
    ------
    ValueError : as `check_volume`.
    """

    n_windows = 1.0
    at_once = AT_ONCE

    def __init__(self, config: TNTConfig) -> None:
        check_volume(config)
        self.config = config
        self.crops = config
        self._volumes = BatchVolumes(config)
        self._events_of_cells = EventsOfCells(config)

    def __call__(self, windows: Windows, draws: Draws, rng: np.random.Generator) -> Scenes:
        """The scenes of all `windows`, one for each, augmented by `draws`. `rng` is not used."""
        # the window ends where its recording does, whatever its start was drawn to be
        starts_us = self.config.window_us - draws.until_us
        windows = Windows(windows.recordings, windows.recording, np.zeros(len(windows), np.int64))
        started = replace(draws, start_us=starts_us)
        volumes = self._volumes(windows, started).copy()
        scene, label, low, high = self._boxes(windows, draws)

        middle = (low + high) / 2
        is_on_sensor = ((middle >= 0) & (middle < self.config.sensor)).all(axis=1)
        low = np.maximum(low, 0)
        high = np.minimum(high, self.config.sensor)
        counts = is_on_sensor & (draws.content == SHOWN)[scene]
        scene = scene[counts]
        label = label[counts]
        low = low[counts]
        high = high[counts]

        cells = np.array(self.config.to_grid(1, 1))
        events = self._events_of_cells(volumes, windows, started)
        more = more_than_noise(events, scene, low * cells, high * cells)
        stands_out = more >= fewest_events(high - low)
        position = (low + high) / 2
        size = high - low
        return Scenes(
            volumes, scene[stands_out], label[stands_out], position[stands_out], size[stands_out]
        )

    def _boxes(
        self, windows: Windows, draws: Draws
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The boxes of windows, moved as their events are.

        Returns the number of each box's window and its label, int64, (K,), and its upper left and
        lower right corner in sensor pixels, float64, (K, 2).
        """
        scene, boxes = windows.recordings.boxes_of(windows.recording)
        matrix = draws.matrix[scene]
        # augmented events are on a sensor that is `fine` times finer
        fine = 1.0
        if draws.sensor != self.config.sensor:
            fine = (draws.sensor[0] - 1) / (self.config.sensor[0] - 1)
        # A box covers pixels from their edges on, and events are moved as the pixels' centres are.
        middle = boxes["middle"] - 0.5
        middle = np.einsum("nij,nj->ni", matrix[:, :, :2], middle) + matrix[:, :, 2]
        # if a box is turned, the box around it counts
        size = np.einsum("nij,nj->ni", np.abs(matrix[:, :, :2]), boxes["size"])
        low = (middle - size / 2) / fine + 0.5
        high = (middle + size / 2) / fine + 0.5
        return scene, boxes["label"], low, high


def fewest_events(size: np.ndarray) -> np.ndarray:
    """How many more events an object's box must have than noise would leave there: float64, (K,).

    size : float64, (K, 2), the width and height of the boxes, in sensor pixels.
    """
    fewest: np.ndarray = FEWEST_A_PX * 2 * size.sum(axis=1)
    return fewest


def more_than_noise(
    events: np.ndarray, scene: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """How many more events boxes have than the noise of their windows leaves there: float64, (K,).

    The noise of a window is the mean of a quiet block of its cells, see `QUIET`.

    Parameters
    ----------
    events : (N, H, W), the number of events of each cell of N windows.
    scene : int64, (K,), the window of each box.
    low, high : float64, (K, 2), two corners (x, y) of each box, in cells.
    """
    n, height, width = events.shape
    rows = max(1, height // BLOCK)
    columns = max(1, width // BLOCK)
    side = min(BLOCK, height), min(BLOCK, width)
    in_blocks = events[:, : rows * side[0], : columns * side[1]]
    in_blocks = in_blocks.reshape(n, rows, side[0], columns, side[1])
    noise = np.percentile(in_blocks.mean(axis=(2, 4)).reshape(n, -1), QUIET, axis=1)

    end = np.array([width, height])
    first = np.clip(np.floor(low), 0, end).astype(int)
    last = np.clip(np.ceil(high), 0, end).astype(int)
    inside = np.array(
        [
            events[k, y0:y1, x0:x1].sum()
            for k, (x0, y0), (x1, y1) in zip(scene, first, last, strict=True)
        ],
        np.float64,
    )
    area = np.maximum(last - first, 0).prod(axis=1)
    more: np.ndarray = inside - noise[scene] * area
    return more
