"""The flat buffer that a volume's numbers live in, filled in for a configuration."""

from __future__ import annotations

import itertools

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.kernels import state as S

_epochs = itertools.count(1)


def next_epoch() -> int:
    """A number for a window's EPOCH that no other one in this process has."""
    return next(_epochs)


def new_state(config: TNTConfig) -> np.ndarray:
    """The buffer of a volume, its parameters set, no window open (see `kernels.state`)."""
    (sensor_w, sensor_h), (width, height) = config.sensor, config.grid
    plane = 2 * (width + 1) * (height + 1)
    n_cells = config.channels * plane
    log_size = 1 << (max(S.BLOCK, n_cells // S.NUMBERS_PER_LOGGED) - 1).bit_length()
    buffer = np.zeros(S.CELLS + n_cells + log_size)
    ints = buffer.view(np.int64)
    gain_x, gain_y = config.to_grid(1.0, 1.0)
    raw = config.transform == "none"
    buffer[S.WINDOW_US] = config.window_us
    buffer[S.BIN_SCALE] = (config.bins - 1) / config.window_us
    buffer[S.SCALE_X] = gain_x * (1.0 if raw else config.window_us / config.t_max)
    buffer[S.SCALE_Y] = gain_y * (1.0 if raw else config.window_us / config.t_max)
    buffer[S.CENTER_X] = 0.0 if raw else (width - 1) / 2
    buffer[S.CENTER_Y] = 0.0 if raw else (height - 1) / 2
    buffer[S.MAX_U] = width - 1
    buffer[S.MAX_V] = height - 1
    buffer[S.SIGN_ON] = 1.0
    buffer[S.SIGN_OFF] = -1.0 if config.polarity == "signed" else 1.0
    buffer[S.FIXED_X] = (sensor_w - 1) / 2  # the grid's centre
    buffer[S.FIXED_Y] = (sensor_h - 1) / 2
    modes = {"running": S.MODE_RUNNING, "line": S.MODE_LINE}
    mode = S.MODE_LINE_FLOW_REMOVED if config.remove_flow else modes.get(config.landmark, S.MODE_FIXED)
    ints[S.MODE] = S.MODE_RAW if raw else mode
    ints[S.HOP_US] = config.window_us
    ints[S.SENSOR_W], ints[S.SENSOR_H] = sensor_w, sensor_h
    ints[S.ROW] = 2 * (width + 1)
    ints[S.PLANE] = plane
    ints[S.OFF_SHIFT] = plane * config.bins if config.polarity == "split" else 0
    ints[S.LOG] = S.CELLS + n_cells
    ints[S.BIN_LO], ints[S.BIN_HI] = S.NO_BIN, -1
    ints[S.LOG_SIZE] = log_size
    return buffer
