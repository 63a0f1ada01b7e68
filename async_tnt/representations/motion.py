"""The motion model: what constant optical flow does to events.

L_v shears space-time: it moves an event at window fraction f by v f pixels. The L_v form a group: L_v L_w = L_(v + w),
L_0 is the identity, and L_-v is the inverse of L_v. Convolutions are not equivariant to it; the Temporal Normalization
Transform turns it into a translation (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from async_tnt.checks import checked_time, plain_array
from async_tnt.config import TNTConfig
from async_tnt.kernels.records import MAX_TIME_US


def move_by_flow(
    t: Any, x: Any, y: Any, flow: Sequence[float], *, start_us: int, window_us: int
) -> tuple[np.ndarray, np.ndarray]:
    """Move events by constant optical flow.

        L_v (x, y, t) = (x + v_x f, y + v_y f, t)        f = (t - start_us) / window_us

    Events outside the window move, too, with f < 0 or f >= 1. Moved events lie between pixels and may lie outside the
    sensor: `tnt_reference` accepts them, volumes and processors do not.

    The group's laws hold exactly if all products and sums are exact in float64 (such as whole flows, whole pixels and
    a window of 2**k microseconds), and otherwise up to rounding: some 1e-13 px on a sensor of a thousand pixels. L_0
    is always the identity.

    Parameters
    ----------
    t : (N,) integer microseconds.
    x, y : (N,) coordinates in pixels, not necessarily whole.
    flow : v = (v_x, v_y), in pixels per window. From pixels per second: v = v_s * window_us * 1e-6.
    start_us, window_us : f is 0 at `start_us`, and 1 `window_us` later.

    Returns
    -------
    x, y : (N,) float64 in pixels. Times stay as they are.

    Raises
    ------
    ValueError, TypeError : an invalid argument; the message names it and its rule.

    References
    ----------
    Wang 2019, arXiv:1911.12801, the optical-flow group action on events.

    Examples
    --------
    >>> x, y = move_by_flow([0, 50, 100], [7, 7, 7], [3, 3, 3], flow=(8.0, -2.0), start_us=0, window_us=100)
    >>> x.tolist(), y.tolist()
    ([7.0, 11.0, 15.0], [3.0, 2.0, 1.0])
    """
    x, y, dx, dy = _displacements(t, x, y, flow, start_us, window_us)
    return x + dx, y + dy


def undo_flow(
    t: Any, x: Any, y: Any, flow: Sequence[float], *, start_us: int, window_us: int
) -> tuple[np.ndarray, np.ndarray]:
    """Remove constant optical flow from events: L_v^-1 = L_-v, the inverse of `move_by_flow`.

    Events of an object that moves by `flow` return to where the object was at the window's start (motion
    compensation). Parameters, result and errors are those of `move_by_flow`.

    Examples
    --------
    >>> x, y = undo_flow([0, 50, 100], [7, 11, 15], [3, 2, 1], flow=(8.0, -2.0), start_us=0, window_us=100)
    >>> x.tolist(), y.tolist()
    ([7.0, 7.0, 7.0], [3.0, 3.0, 3.0])
    """
    x, y, dx, dy = _displacements(t, x, y, flow, start_us, window_us)
    return x - dx, y - dy


def _displacements(
    t: Any, x: Any, y: Any, flow: Sequence[float], start_us: int, window_us: int
) -> tuple[np.ndarray, ...]:
    """x, y and v f, checked; each (N,) float64."""
    config = TNTConfig(window_us=window_us)  # checks it
    start_us = checked_time("start_us", start_us)
    times, x, y = _column("t", t), _column("x", x).astype(np.float64), _column("y", y).astype(np.float64)
    if times.dtype.kind not in "iu":
        raise TypeError(f"`t` must be integer microseconds, got {times.dtype}")
    if times.size and not 0 <= times.min() <= times.max() < MAX_TIME_US:
        raise ValueError(f"`t` must be in [0, 2**62) microseconds, got {times.min()} to {times.max()}")
    if not times.size == x.size == y.size:
        raise ValueError(f"t, x and y must have equal lengths, got {times.size}, {x.size}, {y.size}")
    v = plain_array("flow", flow)
    if v.shape != (2,) or v.dtype.kind not in "iuf" or not np.isfinite(v).all():
        raise ValueError(f"`flow` must be two finite numbers (v_x, v_y) in pixels per window, got {flow!r}")
    # the difference in int64: uint64 minus int would be float64, which loses microseconds
    f = (times.astype(np.int64) - start_us) / config.window_us
    return x, y, float(v[0]) * f, float(v[1]) * f


def _column(name: str, values: Any) -> np.ndarray:
    column = plain_array(name, values)
    if column.ndim != 1:
        raise ValueError(f"`{name}` must have one dimension, got shape {column.shape}")
    if column.size == 0:
        return column.astype(np.int64)  # [] is float64 to NumPy
    if column.dtype.kind not in "iuf":
        raise TypeError(f"`{name}` must be numbers, got {column.dtype}")
    if not np.isfinite(column).all():
        i = int(np.argmin(np.isfinite(column)))
        raise ValueError(f"`{name}` must be finite, got {column[i]} at event {i}")
    return column
