"""The Temporal Normalization Transform (TNT) of a window's events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch

from . import landmarks
from .coordinates import image_centre, tnt_time, to_grid, window_fraction
from .window import Column, check_size, window_events

BORDER_TOLERANCE = 1e-9
"""How many pixels beyond the border an event may lie and still count as on the border."""


class TNTCoordinates(NamedTuple):
    """Where the transform puts N events."""

    u: torch.Tensor
    """float64, (N,): column in the transformed grid."""
    v: torch.Tensor
    """float64, (N,): row in the transformed grid."""
    kept: torch.Tensor
    """bool, (N,): whether the event is on the grid."""


def tnt_coordinates(
    t: Column,
    x: Column,
    y: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
    t_max: float = 8.0,
    landmark: str | Sequence[float] | torch.Tensor = "running",
    remove_flow: bool = False,
) -> TNTCoordinates:
    """Transformed position of each event, and whether the event is kept.

        u_i = (x_i - l_x) / tau_i + c_x                    v_i in the same way with y
        u_i = ((x_i - l_x) - m_x f_i) / tau_i + c_x        with remove_flow

        kept  iff  tau_i > 0  and  0 <= u_i <= W - 1  and  0 <= v_i <= H - 1

    "Kept" is decided up to BORDER_TOLERANCE. If an event lies exactly on the border in exact
    arithmetic, the rounding of one order of operations or another must not drop it. Such events are
    put on the border.

    Parameters
    ----------
    t, x, y : columns of N events, in arrival order: microseconds, sensor pixels. Float64 columns
        that require a gradient get one.
    start_us, window_us : the window, `start_us <= t <= start_us + window_us`. Other events are
        ignored.
    sensor, grid : (width, height).
    t_max : tau at the window's end. The thesis has B - 1.
    landmark : "center", "running", "line" or "window"; or (x, y); or a tensor (N, 2). Grid pixels.
    remove_flow : also subtract the flow that `line` fitted; with no other landmark.

    Returns
    -------
    TNTCoordinates(u, v, kept), each (N,). Where tau is 0, or the event is outside the window, it is
    not kept, and its u and v are finite but meaningless.

    Raises
    ------
    ValueError, TypeError : an argument is wrong. The message has its name, the rule and the value.

    References
    ----------
    Wang 2019, arXiv:1911.12801, the Temporal Normalization Transform. There t_max = B - 1 and the
    window is [t_1, t_N]. Removing the flow and counting what is dropped are ours.
    """
    if not (math.isfinite(t_max) and t_max > 0):
        raise ValueError(f"`t_max` must be positive and finite, got {t_max!r}")
    if remove_flow and not (isinstance(landmark, str) and landmark == "line"):
        raise ValueError(
            f"`remove_flow` needs the flow fitted by landmark 'line', got landmark {landmark!r}"
        )
    check_size("sensor", sensor, smallest=2)
    grid = check_size("grid", grid, smallest=2)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    n_events = len(events.dt)
    device = events.dt.device

    if isinstance(landmark, str):
        centres = landmarks.landmark(
            landmark, t, x, y, start_us=start_us, window_us=window_us, sensor=sensor, grid=grid
        )  # (N, 2)
    else:
        centres = landmarks.given_landmark(landmark, n_events)  # (N, 2)
    offset = to_grid(events.pixels, sensor, grid) - centres  # (N, 2)
    if remove_flow:
        flow = landmarks.fitted_flow(
            t, x, y, start_us=start_us, window_us=window_us, sensor=sensor, grid=grid
        )  # (N, 2)
        offset = offset - flow * window_fraction(events.dt, window_us)[:, None]

    tau = tnt_time(events.dt, window_us, t_max)  # (N,)
    is_defined = events.inside & (tau > 0)
    # Divide by 1 where the quotient is not wanted. To divide by 0 and mask the result afterwards
    # would still put NaN into the gradients (0 times infinity).
    uv = offset / torch.where(is_defined, tau, 1.0)[:, None] + image_centre(grid, device)  # (N, 2)
    last_pixel = torch.tensor(grid, dtype=torch.float64, device=device) - 1  # (2,)
    on_grid = uv.clamp(torch.zeros_like(last_pixel), last_pixel)  # (N, 2)
    kept = is_defined & ((uv - on_grid).abs() <= BORDER_TOLERANCE).all(dim=1)
    uv = torch.where(kept[:, None], on_grid, uv)
    return TNTCoordinates(uv[:, 0], uv[:, 1], kept)
