"""A volume's flat buffer (`kernels.state`): created for a configuration, saved, restored.

Parameters are not saved: they follow from the configuration, and damaged ones could change where compiled code
writes. Only cells that are not zero are saved.
"""

from __future__ import annotations

import itertools

import numpy as np

from async_tnt.checked_tensors import Arrays, checked_array
from async_tnt.config import TIME_IMAGES, TNTConfig
from async_tnt.kernels import state as S
from async_tnt.kernels.records import MAX_TIME_US

DERIVED = 0  # follows from other slots; not restored
SLOTS = {
    "start_us": S.START_US,
    "limit_us": DERIVED,
    "n": S.N,
    "sum_x": S.SUM_X,
    "sum_y": S.SUM_Y,
    "sum_t": S.SUM_T,
    "newest_us": S.NEWEST_US,
    "received": S.RECEIVED,
    "kept": S.KEPT,
    "late": S.LATE,
    "tau_zero": S.TAU_ZERO,
    "decided_us": DERIVED,
    "decided": S.DECIDED,
    "c_xf": S.C_XF,
    "c_yf": S.C_YF,
    "c_ff": S.C_FF,
    "fixed_x": DERIVED,
    "fixed_y": DERIVED,
}
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
    buffer = np.zeros(S.CELLS + n_cells + log_size + config.remembered)
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
    combine["hats"] = S.COMBINE_HISTOGRAM
    ints[S.COMBINE] = combine.get(config.representation, S.COMBINE_SUM)
    ints[S.HOP_US] = config.window_us
    ints[S.SENSOR_W], ints[S.SENSOR_H] = sensor_w, sensor_h
    ints[S.ROW] = 2 * (width + 1)
    ints[S.PLANE] = plane
    ints[S.OFF_SHIFT] = plane * config.bins if config.polarity == "split" else 0
    ints[S.LOG] = S.CELLS + n_cells
    ints[S.BIN_LO], ints[S.BIN_HI] = S.NO_BIN, -1
    ints[S.LOG_SIZE] = log_size
    ints[S.MEMORY] = S.CELLS + n_cells + log_size if config.remembered else 0
    return buffer


def set_duration(buffer: np.ndarray, config: TNTConfig, window_us: int) -> None:
    """Set what the window's duration determines: the scales of time."""
    gain_x, gain_y = config.to_grid(1.0, 1.0)
    per_tau_us = 1.0 if config.transform == "none" else window_us / config.t_max
    buffer[S.WINDOW_US] = window_us
    buffer[S.BIN_SCALE] = (config.bins - 1) / window_us if config.representation == "volume" else 0.0
    buffer[S.SCALE_X] = gain_x * per_tau_us
    buffer[S.SCALE_Y] = gain_y * per_tau_us


def save_window(buffer: np.ndarray, with_cells: bool) -> Arrays:
    """The open window of a volume and its counts, all numbers by their bits."""
    ints = buffer.view(np.int64)
    places = np.flatnonzero(ints[S.CELLS : ints[S.LOG]]) if with_cells else np.empty(0, np.int64)
    arrays = {"slots": ints[list(SLOTS.values())], "places": places, "cells": buffer[S.CELLS + places]}
    return arrays | ({"memory": buffer[ints[S.MEMORY] :].copy()} if with_cells and ints[S.MEMORY] else {})


def restore_counts(buffer: np.ndarray, arrays: Arrays) -> None:
    """Restore what became of the events into the buffer of an empty volume."""
    slots = _slots(arrays)
    received, *parts = (slots[name] for name in ("received", "kept", "late", "tau_zero", "decided"))
    if min(parts) < 0 or not sum(parts) <= received <= MAX_EVENTS:
        raise ValueError(f"its counts {parts} are not parts of {received} events")
    _set(buffer, slots, "received", "kept", "late", "tau_zero", "decided")


def restore_window(buffer: np.ndarray, arrays: Arrays, config: TNTConfig) -> None:
    """Restore an open window into the buffer of an empty volume of the same configuration, after its counts.

    Every number that the kernels index or divide with is checked to be one that a stream can have left there, as a
    state may be forged. The log of changed cells is not saved: readers find that they have missed more than it holds,
    and read everything.
    """
    ints = buffer.view(np.int64)
    slots = _slots(arrays)
    n, start_us, newest_us = slots["n"], slots["start_us"], slots["newest_us"]
    n_most = slots["received"] - slots["late"] - slots["decided"]
    if not (0 <= start_us < MAX_TIME_US and 0 <= n <= n_most):
        raise ValueError(f"its window from {start_us} us on cannot hold {n} of {n_most} events")
    first_us, last_us = (start_us, start_us + config.window_us - 1) if n else (-1, -1)
    if not first_us <= newest_us <= last_us:
        raise ValueError(f"its newest event at {newest_us} us is not in the window from {start_us} us on")
    (width, height), window_us = config.sensor, config.window_us
    for name, largest in (("sum_x", width - 1), ("sum_y", height - 1), ("sum_t", window_us - 1)):
        if not 0 <= slots[name] <= min(n * largest, 1 << 62):
            raise ValueError(f"its `{name}` must be in [0, {n * largest}], got {slots[name]}")
    lines = np.array([slots[name] for name in ("c_xf", "c_yf", "c_ff")]).view(np.float64)
    if not (np.all(np.abs(lines) <= n * np.array((width, height, 1))) and lines[2] >= 0):  # False for nan
        raise ValueError(f"its running line has the sums {lines.tolist()}, which {n} events cannot have")
    places = arrays.get("places", np.empty(0))
    places = checked_array(arrays, "places", np.int64, places.shape)
    cells = checked_array(arrays, "cells", np.float64, (places.size,))
    n_cells = 0 if config.needs_replay else int(ints[S.LOG]) - S.CELLS
    if np.any((places < 0) | (places >= n_cells)) or not np.all(np.abs(cells) <= 1.001 * n):
        raise ValueError("its cells are not those of such a window")
    if config.representation in TIME_IMAGES:
        pairs = np.zeros(n_cells)
        pairs[places] = cells
        of_time = 1 if config.representation == "count_time" else 0
        times, counts = pairs[of_time::2], pairs[1 - of_time :: 2]
        if np.any((counts < 0) | (times < 0) | (times > 1) | ((counts == 0) & (times != 0))):
            raise ValueError("its cells are not counts and times of such a window")
    if config.representation == "hats" and not config.needs_replay:
        memory = checked_array(arrays, "memory", np.float64, (config.remembered,))
        if not (np.all(memory >= 0) and np.all(memory <= float(n) ** 2) and np.all(memory % 1 == 0)):
            raise ValueError("its memory is not that of histograms of such a window")
        buffer[ints[S.MEMORY] :] = memory
    _set(buffer, slots, "start_us", "n", "sum_x", "sum_y", "sum_t", "newest_us", "c_xf", "c_yf", "c_ff")
    ints[S.LIMIT_US] = start_us + window_us
    buffer[S.CELLS + places] = cells
    ints[S.EPOCH] = next_epoch()
    ints[S.N_LOG] = ints[S.LOG_SIZE] + 1
    ints[S.N_READ] = S.UNREAD
    ints[S.BIN_LO], ints[S.BIN_HI] = 0, config.bins - 1


def _slots(arrays: Arrays) -> dict[str, int]:
    return dict(zip(SLOTS, checked_array(arrays, "slots", np.int64, (len(SLOTS),)).tolist(), strict=True))


def _set(buffer: np.ndarray, slots: dict[str, int], *names: str) -> None:
    for name in names:
        buffer.view(np.int64)[SLOTS[name]] = slots[name]
