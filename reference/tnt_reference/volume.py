"""Event volumes (others call them voxel grids), shape (B, H, W), indexed [bin, y, x]."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import torch

from .coordinates import bin_position, to_grid
from .transform import tnt_coordinates
from .window import Column, check_polarity, check_size, signs, whole_number, window_events


def event_volume(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
    bins: int = 9,
    polarity: str = "signed",
    dtype: torch.dtype = torch.float32,
) -> torch.Tensor:
    """The raw event volume of one window: every event at its own place, nothing transformed.

        V[b, y, x] = sum_i s_i k(b - b_i) k(y - y_i) k(x - x_i),     k(a) = max(0, 1 - |a|)

    with x_i, y_i in grid pixels and b_i = (B - 1)(t_i - start_us) / window_us.

    Parameters
    ----------
    t, x, y, p : columns of N events in arrival order: integer microseconds; sensor pixels; bool,
        0/1 or -1/+1. Each is a torch tensor, or anything that `torch.as_tensor` takes, and is never
        modified. Float64 t, x, y that require a gradient get one.
    start_us, window_us : the window, `start_us <= t <= start_us + window_us`. Other events are
        ignored. The window's right end lies exactly at bin B - 1.
    sensor, grid : (width, height). Sensor pixels map onto the grid corner to corner.
    bins : B.
    polarity : "signed" (s = -1 or +1, the thesis), "unsigned" (s = 1), "split" (ON bins, then OFF
        bins, s = 1).
    dtype : the result's type. All arithmetic and all sums are float64; the cast is the last step.

    Returns
    -------
    Tensor (B, H, W), or (2B, H, W) for "split". Its sum is the sum of the s_i.

    Raises
    ------
    ValueError, TypeError : an argument is wrong. The message has its name, the rule and the value.

    References
    ----------
    Zhu et al. 2018, arXiv:1812.08156, the event volume; Wang 2019, arXiv:1911.12801, with B = 9.

    Example
    -------
    >>> settings = dict(start_us=0, window_us=10, sensor=(3, 2), grid=(3, 2), bins=2)
    >>> event_volume(t=[0, 5], x=[0, 2], y=[0, 1], p=[1, 0], **settings).tolist()
    [[[1.0, 0.0, 0.0], [0.0, 0.0, -0.5]], [[0.0, 0.0, 0.0], [0.0, 0.0, -0.5]]]
    """
    grid = check_size("grid", grid)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    sign = signs(p, len(events.dt))
    b = bin_position(events.dt, window_us, check_bins(bins))  # (N,)
    u, v = to_grid(events.pixels, sensor, grid).unbind(1)  # (N,), (N,)
    shape = (bins, grid[1], grid[0])
    return volume_of(b, v, u, sign, events.inside, shape, polarity, dtype)


def tnt_volume(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
    bins: int = 9,
    t_max: float = 8.0,
    polarity: str = "signed",
    landmark: str | Sequence[float] | torch.Tensor = "running",
    remove_flow: bool = False,
    dtype: torch.dtype = torch.float32,
) -> torch.Tensor:
    """The event volume after the Temporal Normalization Transform.

        V[b, y, x] = sum_i s_i k(b - b_i) k(y - v_i) k(x - u_i)      over the kept events

    with (u_i, v_i) and "kept" as `tnt_coordinates` defines them. A landmark that requires a
    gradient gets one.

    Parameters
    ----------
    t, x, y, p, start_us, window_us, sensor, grid, bins, polarity, dtype : see `event_volume`,
        whose errors are the same.
    t_max, landmark, remove_flow : see `tnt_coordinates`.

    Returns
    -------
    Tensor (B, H, W), or (2B, H, W) for "split". Its sum is the sum of the kept events' s_i.
    """
    grid = check_size("grid", grid)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    sign = signs(p, len(events.dt))
    b = bin_position(events.dt, window_us, check_bins(bins))  # (N,)
    u, v, kept = tnt_coordinates(
        t,
        x,
        y,
        start_us=start_us,
        window_us=window_us,
        sensor=sensor,
        grid=grid,
        t_max=t_max,
        landmark=landmark,
        remove_flow=remove_flow,
    )
    return volume_of(b, v, u, sign, kept, (bins, grid[1], grid[0]), polarity, dtype)


def volume_of(
    b: torch.Tensor,
    v: torch.Tensor,
    u: torch.Tensor,
    sign: torch.Tensor,
    kept: torch.Tensor,
    shape: tuple[int, int, int],
    polarity: str,
    dtype: torch.dtype,
) -> torch.Tensor:
    """The volume of the kept events, with the weights that `polarity` asks for.

    Parameters
    ----------
    b, v, u, sign, kept : (N,) each.
    shape : (B, H, W), of one polarity.
    """
    check_polarity(polarity)
    if not dtype.is_floating_point:
        raise TypeError(f"`dtype` must be a floating-point type, got {dtype}")
    b = b[kept]  # (M,)
    v = v[kept]  # (M,)
    u = u[kept]  # (M,)
    sign = sign[kept]  # (M,)
    if polarity == "signed":
        volume = splat(b, v, u, sign, shape)
    elif polarity == "unsigned":
        volume = splat(b, v, u, torch.ones_like(sign), shape)
    else:
        on = (sign > 0).double()
        off = (sign < 0).double()
        volume = torch.cat([splat(b, v, u, on, shape), splat(b, v, u, off, shape)])  # (2B, H, W)
    return volume.to(dtype)


def splat(
    b: torch.Tensor, v: torch.Tensor, u: torch.Tensor, s: torch.Tensor, shape: tuple[int, int, int]
) -> torch.Tensor:
    """The volume of M events, each added to the eight cells around it.

        V[b, y, x] = sum_i s_i k(b - b_i) k(y - v_i) k(x - u_i)

    Parameters
    ----------
    b, v, u, s : (M,) float64, with 0 <= b <= B - 1, 0 <= v <= H - 1, 0 <= u <= W - 1.
    shape : (B, H, W).
    """
    points = torch.stack([b, v, u], dim=1)  # (M, 3)
    lower = points.detach().floor()  # (M, 3)
    k_upper = points - lower  # (M, 3), k of the upper neighbour
    # It is written as a difference, so that the two derivatives sum to 0 also at whole numbers.
    k_lower = 1 - k_upper  # (M, 3)
    # Each axis has one cell more: the last pixel, too, has an upper neighbour, with the weight 0.
    volume = torch.zeros([n + 1 for n in shape], dtype=torch.float64, device=points.device)
    for corner in product((0, 1), repeat=3):
        upper = torch.tensor(corner, device=points.device)  # (3,)
        k_b, k_v, k_u = torch.where(upper == 1, k_upper, k_lower).unbind(1)  # (M,) each
        cell = (lower.long() + upper).unbind(1)  # three of (M,)
        volume.index_put_(cell, s * k_b * k_v * k_u, accumulate=True)
    return volume[: shape[0], : shape[1], : shape[2]].contiguous()


def check_bins(bins: int) -> int:
    """The number of bins, if it is a whole number of at least 1."""
    if whole_number("bins", bins) < 1:
        raise ValueError(f"`bins` must be at least 1, got {bins}")
    return bins
