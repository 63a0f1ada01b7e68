"""Event images: counts of events per pixel and polarity, and the time of the newest."""

from __future__ import annotations

import torch

from .coordinates import window_fraction
from .window import Column, check_size, signs, window_events


def count_image(t: Column, x: Column, y: Column, p: Column, *, sensor: tuple[int, int]) -> torch.Tensor:
    """I[c, y, x] = #{i : x_i = x, y_i = y, p_i = 1 - c}        c = 0: ON, c = 1: OFF

    Parameters
    ----------
    t, x, y, p : columns of N events, in any order: microseconds (ignored); whole sensor pixels; bool,
        0/1 or -1/+1.
    sensor : (width, height).

    Returns
    -------
    int64 tensor (2, H, W). Its sum is N.

    Raises
    ------
    ValueError, TypeError : the argument's name, the rule and what came.

    References
    ----------
    Maqueda et al. 2018, arXiv:1804.01310.

    Example
    -------
    >>> count_image(t=[10, 20, 30], x=[0, 2, 2], y=[1, 0, 0], p=[1, 0, 0], sensor=(3, 2)).tolist()
    [[[0, 0, 0], [1, 0, 0]], [[0, 0, 2], [0, 0, 0]]]
    """
    channel, row, column, _ = events_at(t, x, y, p, start_us=0, window_us=1, sensor=sensor)
    image = torch.zeros(2, sensor[1], sensor[0], dtype=torch.int64)
    image.index_put_((channel, row, column), torch.ones_like(row), accumulate=True)
    return image


def count_timestamp_image(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    dtype: torch.dtype = torch.float32,
) -> torch.Tensor:
    """The four channels of EV-FlowNet: counts ON and OFF, time of the newest event ON and OFF.

        I[c, y, x]     = #{i : x_i = x, y_i = y, p_i = 1 - c}          c = 0: ON, c = 1: OFF
        I[2 + c, y, x] = max {f_i : x_i = x, y_i = y, p_i = 1 - c}     f_i = (t_i - start_us) / window_us

    over the events with 0 <= f_i < 1: here, as an exception, the window is half-open, as a stream's is. The time
    of a pixel without events is 0.

    Returns
    -------
    Tensor (4, H, W) of `dtype`. All arithmetic is float64; the cast is the last step.

    References
    ----------
    Zhu et al. 2018, arXiv:1802.06898.

    Example
    -------
    >>> at = dict(start_us=10, window_us=40, sensor=(3, 2))
    >>> count_timestamp_image(t=[10, 20, 30], x=[0, 2, 2], y=[1, 0, 0], p=[1, 0, 0], **at)[3].tolist()
    [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]
    """
    channel, row, column, f = events_at(t, x, y, p, start_us=start_us, window_us=window_us, sensor=sensor)
    inside = (f >= 0) & (f < 1)
    channel, row, column, f = channel[inside], row[inside], column[inside], f[inside]
    image = torch.zeros(4, sensor[1], sensor[0], dtype=torch.float64)
    image.index_put_((channel, row, column), torch.ones_like(f), accumulate=True)
    pixel = ((2 + channel) * sensor[1] + row) * sensor[0] + column  # (M,)
    image.view(-1).scatter_reduce_(0, pixel, f, "amax")
    return image.to(dtype)


def events_at(
    t: Column, x: Column, y: Column, p: Column, *, start_us: int, window_us: int, sensor: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Channel, row, column (int64) and window fraction (float64) of all N events, checked; four of (N,)."""
    check_size("sensor", sensor)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    if events.pixels.is_floating_point():
        raise TypeError("`x` and `y` must be whole pixels: an image counts events per pixel, and does not splat them")
    channel = (signs(p, len(events.dt)) < 0).long()  # (N,)
    return channel, events.pixels[:, 1], events.pixels[:, 0], window_fraction(events.dt, window_us)
