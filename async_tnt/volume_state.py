"""A volume's flat buffer (`kernels.state`), made for a configuration."""

from __future__ import annotations

import itertools

import numpy as np

from async_tnt.config import TNTConfig
from async_tnt.kernels import state as S

MAX_EVENTS = 1 << 53  # 28 years at 10 million events a second; sums stay far from the end of int64
_epochs = itertools.count(1)


def next_epoch() -> int:
    """A number for a window's EPOCH, unique in this process."""
    return next(_epochs)


def new_state(config: TNTConfig) -> np.ndarray:
    """The buffer of a volume, its parameters set, no window open (see `kernels.state`)."""
    (sensor_w, sensor_h), (width, height) = config.sensor, config.grid
    plane = 2 * (width + 1) * (height + 1)
    n_cells = config.channels * plane
    log_size = 1 << (max(S.BLOCK, n_cells // S.NUMBERS_PER_LOGGED) - 1).bit_length()
    buffer = np.zeros(S.CELLS + n_cells + log_size)
    ints = buffer.view(np.int64)
    raw = config.transform == "none"
    set_duration(buffer, config, config.window_us)
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
    combine = {"count_time": S.COMBINE_NEWEST, "mean_time": S.COMBINE_MEAN, "time_surface": S.COMBINE_SURFACE}
    ints[S.COMBINE] = combine.get(config.representation, S.COMBINE_SUM)
    ints[S.SENSOR_W], ints[S.SENSOR_H] = sensor_w, sensor_h
    ints[S.ROW] = 2 * (width + 1)
    ints[S.PLANE] = plane
    ints[S.OFF_SHIFT] = plane * config.bins if config.polarity == "split" else 0
    ints[S.LOG] = S.CELLS + n_cells
    ints[S.INTERVAL_LO], ints[S.INTERVAL_HI] = S.NO_INTERVAL, -1
    ints[S.LOG_SIZE] = log_size
    return buffer


def set_duration(buffer: np.ndarray, config: TNTConfig, window_us: int) -> None:
    """Set what the window's duration determines: the scales of time."""
    gain_x, gain_y = config.to_grid(1.0, 1.0)
    per_tau_us = 1.0 if config.transform == "none" else window_us / config.t_max
    buffer[S.WINDOW_US] = window_us
    buffer[S.BIN_SCALE] = (config.bins - 1) / window_us if config.representation == "volume" else 0.0
    buffer[S.SCALE_X] = gain_x * per_tau_us
    buffer[S.SCALE_Y] = gain_y * per_tau_us
