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

from .checked_tensors import checksum, read_tensors, tensor_bytes
from .kernels import state as S
from .messages import one_line
from .new_state import next_epoch

FORMAT = "async_tnt stream 2"
Arrays = dict[str, np.ndarray]
SLOTS = (
    S.START_US, S.LIMIT_US, S.N, S.SUM_X, S.SUM_Y, S.SUM_T, S.NEWEST_US, S.RECEIVED, S.KEPT, S.LATE, S.TAU_ZERO,
    S.DECIDED_US, S.DECIDED, S.C_XF, S.C_YF, S.C_FF, S.FIXED_X, S.FIXED_Y,
)  # fmt: skip


def buffer_arrays(buffer: np.ndarray, with_cells: bool) -> Arrays:
    """The open window of a volume's `kernels.state`, and its counts; all numbers by their bits."""
    ints = buffer.view(np.int64)
    places = np.flatnonzero(ints[S.CELLS : ints[S.LOG]]) if with_cells else np.empty(0, np.int64)
    return {"slots": ints[list(SLOTS)], "places": places, "cells": buffer[S.CELLS + places]}


def restore_buffer(buffer: np.ndarray, arrays: Arrays, n_intervals: int) -> None:
    """The inverse, into the buffer of an empty volume of the same configuration.

    The log of touched cells is not kept: readers find that they have missed more than it holds, and read all.
    """
    ints = buffer.view(np.int64)
    slots, places, cells = arrays["slots"], arrays["places"], arrays["cells"]
    n_cells = int(ints[S.LOG]) - S.CELLS
    if slots.shape != (len(SLOTS),) or places.shape != cells.shape or np.any((places < 0) | (places >= n_cells)):
        raise ValueError("its volume does not fit the configuration")
    ints[list(SLOTS)] = slots
    buffer[S.CELLS + places] = cells
    ints[S.EPOCH] = next_epoch()
    ints[S.N_LOG] = ints[S.LOG_SIZE] + 1
    ints[S.N_READ] = S.UNREAD
    ints[S.BIN_LO], ints[S.BIN_HI] = 0, n_intervals - 1


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
