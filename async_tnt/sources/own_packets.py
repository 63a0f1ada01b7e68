"""Packets in memory of their own, and how many events they hold."""

from __future__ import annotations

from typing import Any

import numpy as np

from async_tnt.event_forms import named_columns


def n_events_of(packet: Any) -> int:
    """Events in a packet of any form that `async_tnt.event_forms` lists; 0 for what is no packet of events."""
    if isinstance(packet, np.ndarray) and packet.dtype.names is not None and packet.ndim == 1:
        return len(packet)
    try:
        columns = named_columns(packet)
    except (TypeError, ValueError):  # who reads the packet says what is wrong with it
        return 0
    return 0 if columns is None else columns[0].size


def own_packet(packet: Any) -> tuple[Any, int]:
    """A packet that nobody else writes to, and how many events it holds.

    A structured array and a tuple of four columns keep their form, in fresh memory. Another object that holds events
    becomes a tuple of four columns (t, x, y, p). What holds no array (None, four plain numbers) or is no packet of
    events is handed on as it is.
    """
    if isinstance(packet, np.ndarray):
        return _copied(packet), n_events_of(packet)
    if packet is None or (isinstance(packet, tuple) and all(type(value) is int for value in packet)):
        return packet, n_events_of(packet)
    try:
        columns = named_columns(packet)
    except (TypeError, ValueError):
        return packet, 0
    if columns is None:
        return None, 0
    return tuple(column.copy() for column in columns), columns[0].size


def _copied(packet: np.ndarray) -> np.ndarray:
    if type(packet) is not np.ndarray or not packet.flags.c_contiguous or packet.ndim != 1 or packet.dtype.hasobject:
        return packet.copy()
    own = np.empty(packet.shape, packet.dtype)
    own.view(np.uint8)[:] = packet.view(np.uint8)  # as plain bytes: NumPy copies records field by field, 5x slower
    return own
