"""The kernels that can be compiled ahead, and the types of the arguments that a stream gives them.

Each class that calls kernels from Python names them in its attributes `KERNELS`, `..._KERNELS`.
"""

from __future__ import annotations

from typing import Any

from numba import boolean, float32, float64, int64, types, uint32, uint64

from async_tnt.kernels.decisions.classify import absorb_and_decide, classify_cells, softmax
from async_tnt.kernels.decisions.objects import list_objects, locate_cells, locate_on_map
from async_tnt.kernels.decisions.trigger import schedule, until_due, why_due
from async_tnt.kernels.network.forward import forward, mix
from async_tnt.kernels.network.heatmap import centroid
from async_tnt.kernels.network.sync_input import set_input, sync_input
from async_tnt.kernels.volume.absorb import absorb, absorb_one, store_events
from async_tnt.kernels.volume.readout import cells_to_float32, empty_volume
from async_tnt.kernels.volume.records import (
    CHECK_TYPES,
    COLUMN_TYPES,
    LOAD_TYPES,
    check_columns,
    find_late,
    load_records,
)

Kernel = Any
"""A compiled function; Numba has no public type of it."""
Types = tuple[Any, ...]

# the buffer of a volume, its array, and a volume that is given as an array
_STATE = float64[::1]
_ARRAY = float32[:, :, ::1]
_VOLUME = types.Array(float32, 3, "C", readonly=True)
# the triggers of a stream
_TRIGGER = float64[::1]
# a network: program, weights, feature maps, records of changes
_WEIGHTS = types.Array(float32, 1, "C", readonly=True)
_NETWORK = (int64[::1], _WEIGHTS, float32[::1], uint32[::1])
# the arrays of an ObjectReader, and the arguments by which objects are tracked: tracks, time, and
# whether to keep the tracks
_OBJECTS = (int64[::1], float64[:, ::1], uint64[:, ::1], float64[:, ::1], float64[:, ::1])
_TRACKS = (float64[:, ::1], int64, boolean)
# several decisions: logits, probabilities, notes
_DECISIONS = (float32[:, ::1], float64[:, ::1], int64[:, ::1])

TYPES: dict[Kernel, Types] = {
    load_records: LOAD_TYPES,
    check_columns: CHECK_TYPES,
    find_late: (int64[::1], int64, boolean[::1]),
    empty_volume: (_STATE, _ARRAY, int64, int64, int64),
    absorb: (_STATE, *COLUMN_TYPES, int64, int64),
    absorb_one: (_STATE, int64, int64, int64, int64),
    store_events: (_STATE, *COLUMN_TYPES, int64, int64, *COLUMN_TYPES, int64),
    cells_to_float32: (_STATE, _ARRAY),
    schedule: (_TRIGGER, int64, int64),
    until_due: (_TRIGGER, int64, int64, int64),
    why_due: (_TRIGGER, int64, int64),
    softmax: (float32[::1], float64[::1]),
    set_input: (_VOLUME, int64[::1], float32[::1]),
    sync_input: (_STATE, int64[::1], float32[::1], uint32[::1]),
    mix: (int64[::1], int64, int64, *_NETWORK[1:], uint64[::1]),
    forward: _NETWORK,
    centroid: (float32[::1], int64, int64, int64),
    list_objects: (float32[::1], *_OBJECTS, *_TRACKS),
    locate_on_map: (float32[::1], *_OBJECTS, *_TRACKS),
    locate_cells: (_STATE, *_NETWORK, *_OBJECTS, *_TRACKS),
    classify_cells: (_STATE, *_NETWORK, float32[::1], float64[::1]),
    absorb_and_decide: (
        _STATE,
        *COLUMN_TYPES,
        int64,
        int64,
        _TRIGGER,
        *_NETWORK,
        *_DECISIONS,
    ),
}
"""Kernel -> types of its arguments, in the order of compilation: a kernel that calls others comes
after them."""

NETWORK_PARTS: tuple[Kernel, ...] = (mix, sync_input)
"""Kernels that `classify_cells` and `locate_cells` call, and that take long to compile. While one
process compiles them, another process can compile other kernels of networks."""
MAP_PARTS: tuple[Kernel, ...] = (list_objects,)
"""Kernels that only `locate_cells` calls, and that take long to compile."""
