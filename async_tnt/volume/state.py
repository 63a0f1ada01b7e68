"""A volume's flat buffer, which the kernels work on: how it is made and scaled to a duration."""

from __future__ import annotations

import itertools
import math

import numpy as np

from async_tnt.kernels.volume import state as S
from async_tnt.volume.config import MAX_LAST_EVENTS, TNTConfig, second_bin

MAX_EVENTS = 1 << 53
"""More events than a volume ever gets: 28 years at 10 million events a second. Sums of so many
pixels stay far below the end of int64."""

COMBINE_OF_IMAGE = {
    "count_time": S.COMBINE_NEWEST,
    "mean_time": S.COMBINE_MEAN,
    "time_surface": S.COMBINE_SURFACE,
}
"""Representation -> how an event changes a cell. With all other representations, the event is added
to the cell."""

_epochs = itertools.count(1)


def next_epoch() -> int:
    """A number for a window's EPOCH, unique in this process."""
    return next(_epochs)


def new_state(config: TNTConfig) -> np.ndarray:
    """A new buffer with the volume's parameters and no open window; see `kernels.volume.state`."""
    sensor_w, sensor_h = config.sensor
    width, height = config.grid
    plane = (width + 1) * (height + 1)
    n_cells = (config.channels + second_bin(config)) * plane
    log_size = _power_of_two(max(S.BLOCK, n_cells // S.CELLS_PER_LOGGED))
    ring_size = (config.last_events or MAX_LAST_EVENTS) if config.slides else 0
    buffer = np.zeros(S.CELLS + n_cells + log_size + 2 * ring_size)
    ints = buffer.view(np.int64)

    # how an event is placed
    ints[S.MODE] = _mode(config)
    set_duration(buffer, config, config.window_us)
    if config.transform == "tnt":
        buffer[S.CENTER_X] = (width - 1) / 2
        buffer[S.CENTER_Y] = (height - 1) / 2
    # the grid's centre, in sensor pixels
    buffer[S.FIXED_X] = (sensor_w - 1) / 2
    buffer[S.FIXED_Y] = (sensor_h - 1) / 2
    buffer[S.MAX_U] = width - 1
    buffer[S.MAX_V] = height - 1
    ints[S.SENSOR_W] = sensor_w
    ints[S.SENSOR_H] = sensor_h

    # How an event changes a cell: by a sum or in another way.
    ints[S.COMBINE] = COMBINE_OF_IMAGE.get(config.representation, S.COMBINE_SUM)
    buffer[S.SIGN_ON] = 1.0
    buffer[S.SIGN_OFF] = -1.0 if config.polarity == "signed" else 1.0

    # where the cells and the log lie
    ints[S.ROW] = width + 1
    ints[S.PLANE] = plane
    ints[S.SECOND] = plane * second_bin(config)
    ints[S.OFF_SHIFT] = plane * config.bins if config.polarity == "split" else 0
    ints[S.LOG] = S.CELLS + n_cells
    ints[S.LOG_SIZE] = log_size
    if config.slides:
        ints[S.RING] = ints[S.LOG] + log_size
        ints[S.RING_SIZE] = ring_size
        ints[S.SPAN_US] = config.last_us or 0
        ints[S.SLICE_US] = config.slice_us or 0
    ints[S.INTERVAL_LO] = S.NO_INTERVAL
    ints[S.INTERVAL_HI] = -1
    return buffer


def _mode(config: TNTConfig) -> int:
    """The MODE_ number that says how an event's coordinates are made."""
    if config.transform == "none":
        return S.MODE_RAW
    if config.remove_flow:
        return S.MODE_LINE_FLOW_REMOVED
    if config.landmark == "line":
        return S.MODE_LINE
    if config.landmark == "running":
        return S.MODE_RUNNING
    return S.MODE_FIXED


def _power_of_two(n: int) -> int:
    """The smallest power of two that is at least `n`."""
    return 1 << (n - 1).bit_length()


def set_duration(buffer: np.ndarray, config: TNTConfig, window_us: int) -> None:
    """Set the scales of time in the buffer. The window's duration determines them."""
    gain_x, gain_y = config.to_grid(1.0, 1.0)
    per_tau_us = 1.0 if config.transform == "none" else window_us / config.t_max
    last_bin = config.bins - 1
    bins_per_us = last_bin / window_us if config.representation == "volume" else 0.0
    # if the scale was rounded up, an event at the window's end would be beyond the last bin
    if window_us * bins_per_us > last_bin:
        bins_per_us = math.nextafter(bins_per_us, 0.0)
    buffer[S.WINDOW_US] = window_us
    buffer[S.BIN_SCALE] = bins_per_us
    buffer[S.SCALE_X] = gain_x * per_tau_us
    buffer[S.SCALE_Y] = gain_y * per_tau_us
