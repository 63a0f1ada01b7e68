"""Snapshots: what a stream remembers, as named arrays and as bytes.

Parameters of a volume are not in it: they follow from the configuration, and a damaged file must not change where
compiled code writes. Cells are kept where they are not zero, and the events of a replay instead of cells.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from safetensors import SafetensorError

from async_tnt.checked_tensors import checksum, read_tensors, tensor_bytes
from async_tnt.config import TNTConfig
from async_tnt.kernels import state as S
from async_tnt.kernels.records import MAX_TIME_US
from async_tnt.messages import one_line
from async_tnt.new_state import next_epoch

FORMAT = "async_tnt stream 2"
Arrays = dict[str, np.ndarray]
DERIVED = 0  # a slot that follows from the others, and is not believed
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
MAX_EVENTS = 1 << 53  # a century of a busy camera; sums of counts stay far from the end of int64


def buffer_arrays(buffer: np.ndarray, with_cells: bool) -> Arrays:
    """The open window of a volume's `kernels.state`, and its counts; all numbers by their bits."""
    ints = buffer.view(np.int64)
    places = np.flatnonzero(ints[S.CELLS : ints[S.LOG]]) if with_cells else np.empty(0, np.int64)
    return {"slots": ints[list(SLOTS.values())], "places": places, "cells": buffer[S.CELLS + places]}


def restore_counts(buffer: np.ndarray, arrays: Arrays) -> None:
    """What became of the events, into the buffer of an empty volume."""
    slots = _slots(arrays)
    received, *parts = (slots[name] for name in ("received", "kept", "late", "tau_zero", "decided"))
    if min(parts) < 0 or not sum(parts) <= received <= MAX_EVENTS:
        raise ValueError(f"its counts {parts} are not parts of {received} events")
    _set(buffer, slots, "received", "kept", "late", "tau_zero", "decided")


def restore_window(buffer: np.ndarray, arrays: Arrays, config: TNTConfig) -> None:
    """An open window, into the buffer of an empty volume of the same configuration, whose counts are back.

    Every number that the kernels index or divide with is what a stream can have left there: whoever has written the
    state, they stay within the buffer. The log of touched cells is not kept: readers find that they have missed more
    than it holds, and read all.
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
    places = taken(arrays, "places", np.int64, places.shape)
    cells = taken(arrays, "cells", np.float64, (places.size,))
    n_cells = 0 if config.needs_replay else int(ints[S.LOG]) - S.CELLS
    if np.any((places < 0) | (places >= n_cells)) or not np.all(np.abs(cells) <= 1.001 * n):
        raise ValueError("its cells are not those of such a window")
    _set(buffer, slots, "start_us", "n", "sum_x", "sum_y", "sum_t", "newest_us", "c_xf", "c_yf", "c_ff")
    ints[S.LIMIT_US] = start_us + window_us
    buffer[S.CELLS + places] = cells
    ints[S.EPOCH] = next_epoch()
    ints[S.N_LOG] = ints[S.LOG_SIZE] + 1
    ints[S.N_READ] = S.UNREAD
    ints[S.BIN_LO], ints[S.BIN_HI] = 0, config.bins - 1


def taken(arrays: Arrays, name: str, dtype: Any, shape: tuple[int, ...]) -> np.ndarray:
    """One array of a snapshot.

    Raises
    ------
    ValueError : it is missing, or of another type or shape.
    """
    array = arrays.get(name)
    if array is None or array.dtype != dtype or array.shape != shape:
        got = "none" if array is None else f"{array.dtype} {array.shape}"
        raise ValueError(f"its `{name}` must be {np.dtype(dtype)} {shape}, got {got}")
    return array


def _slots(arrays: Arrays) -> dict[str, int]:
    return dict(zip(SLOTS, taken(arrays, "slots", np.int64, (len(SLOTS),)).tolist(), strict=True))


def _set(buffer: np.ndarray, slots: dict[str, int], *names: str) -> None:
    for name in names:
        buffer.view(np.int64)[SLOTS[name]] = slots[name]


def under(prefix: str, arrays: Arrays) -> Arrays:
    """Names with a prefix."""
    return {f"{prefix}.{name}": array for name, array in arrays.items()}


def part(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays whose names have a prefix, without it."""
    return {name[len(prefix) + 1 :]: array for name, array in arrays.items() if name.startswith(prefix + ".")}


def to_bytes(arrays: Arrays, about: dict[str, Any]) -> bytes:
    """Arrays, and what JSON can say, as the content of a .safetensors file with a checksum."""
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    text = json.dumps(about, sort_keys=True)
    return tensor_bytes(arrays, {"format": FORMAT, "about": text, "sha256": checksum(arrays, text)})


def from_bytes(content: bytes) -> tuple[Arrays, dict[str, Any]]:
    """The inverse.

    Raises
    ------
    ValueError : it is something else, or damaged.
    """
    try:
        arrays, metadata = read_tensors(io.BytesIO(bytes(content)), (FORMAT,))
    except (SafetensorError, TypeError, ValueError) as error:
        raise ValueError(f"`state` must be what `save_state` returned, got something else: {one_line(error)}") from None
    text = metadata.get("about", "")
    if metadata.get("sha256") != checksum(arrays, text):
        raise ValueError("`state` is damaged: its checksum differs")
    try:
        return arrays, json.loads(text)
    except (ValueError, RecursionError) as error:  # the latter: nested too deep
        raise ValueError(f"`state` is damaged: {one_line(error)}") from None
