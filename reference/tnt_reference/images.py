"""Event images: counts of events per pixel and polarity, times of newest events, mean times."""

from __future__ import annotations

import torch

from .coordinates import to_grid, window_fraction
from .window import Column, check_polarity, check_size, signs, whole_pixels, window_events

WEIGHT_TOLERANCE = 1e-9
"""A smaller weight comes from the rounding of an event's place, and counts as 0."""


def count_image(
    t: Column, x: Column, y: Column, p: Column, *, sensor: tuple[int, int]
) -> torch.Tensor:
    """How many events each pixel has, by polarity.

        I[c, y, x] = #{i : x_i = x, y_i = y, p_i = 1 - c}        c = 0: ON, c = 1: OFF

    Parameters
    ----------
    t, x, y, p : columns of N events, in any order: microseconds (ignored); whole sensor pixels;
        bool, 0/1 or -1/+1.
    sensor : (width, height).

    Returns
    -------
    int64 tensor (2, H, W). Its sum is N.

    Raises
    ------
    ValueError, TypeError : an argument is wrong. The message has its name, the rule and the value.

    References
    ----------
    Maqueda et al. 2018, arXiv:1804.01310; Zhu et al. 2018, arXiv:1802.06898.

    Example
    -------
    >>> count_image(t=[10, 20, 30], x=[0, 2, 2], y=[1, 0, 0], p=[1, 0, 0], sensor=(3, 2)).tolist()
    [[[0, 0, 0], [1, 0, 0]], [[0, 0, 2], [0, 0, 0]]]
    """
    # times are ignored, so any window will do
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
    """The four channels of EV-FlowNet: counts of ON and OFF events, times of their newest events.

        I[c, y, x]     = #{i : x_i = x, y_i = y, p_i = 1 - c}          c = 0: ON, c = 1: OFF
        I[2 + c, y, x] = max {f_i : x_i = x, y_i = y, p_i = 1 - c}
        f_i            = (t_i - start_us) / window_us

    over the events with 0 <= f_i < 1. Here, as an exception, the window is half-open, like the
    windows of a stream. The time of a pixel without events is 0.

    Parameters
    ----------
    t, x, y, p, start_us, window_us, sensor, dtype : see `event_volume`.

    Returns
    -------
    Tensor (4, H, W) of `dtype`. All arithmetic is float64; the cast is the last step.

    References
    ----------
    Zhu et al. 2018, arXiv:1802.06898.

    Example
    -------
    >>> settings = dict(start_us=10, window_us=40, sensor=(3, 2))
    >>> image = count_timestamp_image([10, 20, 30], [0, 2, 2], [1, 0, 0], [1, 0, 0], **settings)
    >>> image[3].tolist()
    [[0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]
    """
    channel, row, column, f = events_at(
        t, x, y, p, start_us=start_us, window_us=window_us, sensor=sensor
    )
    inside = (f >= 0) & (f < 1)
    channel = channel[inside]  # (M,)
    row = row[inside]  # (M,)
    column = column[inside]  # (M,)
    f = f[inside]  # (M,)
    image = torch.zeros(4, sensor[1], sensor[0], dtype=torch.float64)
    image.index_put_((channel, row, column), torch.ones_like(f), accumulate=True)
    # (M,), indices in the flat image
    pixel = ((2 + channel) * sensor[1] + row) * sensor[0] + column
    image.view(-1).scatter_reduce_(0, pixel, f, "amax")
    return image.to(dtype)


def time_image(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
    representation: str,
    polarity: str = "split",
    dtype: torch.dtype = torch.float32,
) -> torch.Tensor:
    """The times of events on a grid of any size, as images.

    As in the event volume, each event is shared by the cells around it. With its weight in a cell,

        w_i = k(y - y_i) k(x - x_i)         k(a) = max(0, 1 - |a|), places in grid pixels

    the images are

        N[y, x] = sum_i w_i
        T[y, x] = max {f_i : w_i > 0}
        M[y, x] = sum_i w_i f_i / N[y, x]
        S[y, x] = max {exp(-(1 - f_i) window / tau) : w_i > 0}        tau = window / 2

    All images are 0 where there are no events. A weight below WEIGHT_TOLERANCE counts as 0.

    Parameters
    ----------
    t, x, y, p, start_us, window_us, sensor, grid, dtype : see `event_volume`.
    representation : "count_time": the channels N and T; "mean_time": the channel M; "time_surface":
        S, at the window's end.
    polarity : "unsigned", or "split": the channels of the ON events, then those of the OFF events.

    Returns
    -------
    Tensor (C, H, W) of `dtype`. All arithmetic is float64; the cast is the last step.

    References
    ----------
    Zhu et al. 2018, arXiv:1802.06898, for N and T; Mitrokhin et al. 2018, arXiv:1803.04523, for M;
    Lagorce et al. 2017, doi:10.1109/TPAMI.2016.2574707, for S.

    Example
    -------
    >>> settings = dict(start_us=0, window_us=8, sensor=(2, 2), grid=(2, 2), polarity="unsigned")
    >>> columns = [0, 2, 4], [1, 1, 0], [0, 0, 1], [1, 0, 1]
    >>> time_image(*columns, representation="mean_time", **settings).tolist()
    [[[0.0, 0.125], [0.5, 0.0]]]
    """
    if representation not in ("count_time", "mean_time", "time_surface"):
        raise ValueError(
            f"`representation` must be 'count_time', 'mean_time' or 'time_surface', got "
            f"{representation!r}"
        )
    check_polarity(polarity)
    if polarity == "signed":
        raise ValueError(
            "`polarity` must be 'split' or 'unsigned': times have no sign, got 'signed'"
        )
    grid = check_size("grid", grid)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    sign = signs(p, len(events.dt))
    places = to_grid(events.pixels, sensor, grid).double()  # (N, 2)
    f = window_fraction(events.dt, window_us)  # (N,)
    masks = [events.inside]  # each (N,)
    if polarity == "split":
        masks = [events.inside & (sign > 0), events.inside & (sign < 0)]
    channels = []
    for mask in masks:
        count, newest, mean = _time_sums(places[mask], f[mask], grid)
        if representation == "count_time":
            channels += [count, newest]
        elif representation == "mean_time":
            channels += [mean]
        else:
            surface = torch.exp(-2 * (1 - newest))  # 2 = window / tau
            channels += [torch.where(count > 0, surface, 0.0)]
    return torch.stack(channels).to(dtype)


def _time_sums(
    places: torch.Tensor, f: torch.Tensor, grid: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """N, T and M of `time_image` for M events: float64, (H, W) each."""
    count = torch.zeros(grid[1], grid[0], dtype=torch.float64)
    newest = torch.zeros_like(count)
    total = torch.zeros_like(count)
    for (u, v), time in zip(places.tolist(), f.tolist(), strict=True):
        for column in range(int(u), min(int(u) + 2, grid[0])):
            for row in range(int(v), min(int(v) + 2, grid[1])):
                weight = (1 - abs(u - column)) * (1 - abs(v - row))
                if weight >= WEIGHT_TOLERANCE:
                    count[row, column] += weight
                    newest[row, column] = max(newest[row, column], time)
                    total[row, column] += weight * time
    mean = torch.where(count > 0, total / torch.where(count > 0, count, 1.0), 0.0)
    return count, newest, mean


def events_at(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Channel, row, column (int64) and window fraction (float64) of all events, (N,) each.

    The columns are checked.
    """
    check_size("sensor", sensor)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    channel = (signs(p, len(events.dt)) < 0).long()  # (N,)
    column, row = whole_pixels(events).unbind(1)
    return channel, row, column, window_fraction(events.dt, window_us)
