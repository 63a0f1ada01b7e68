"""HATS: histograms of averaged time surfaces."""

from __future__ import annotations

import torch

from .window import Column, check_polarity, check_size, signs, whole_pixels, window_events

RADIUS = 3
"""How many pixels a histogram reaches from its event in each direction."""


def hats(
    t: Column,
    x: Column,
    y: Column,
    p: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
    polarity: str = "split",
    dtype: torch.dtype = torch.float32,
) -> torch.Tensor:
    """The mean histogram of the events of each cell of a grid.

    The histogram of an event counts, at each place around it, the earlier events of its cell.

        T_i(z)  = #{j < i : x_j = x_i + z, p_j = p_i, j and i in the same cell}    z in {-3..3}^2
        h(z, p) = 1 / |C| sum_{i in C, p_i = p} T_i(z)
        |C|     = number of events in the cell, of both polarities

    Parameters
    ----------
    t, x, y, p, start_us, window_us, sensor, dtype : see `event_volume`. j < i is the order of
        the columns.
    grid : (width, height) in cells; pixel x lies in column floor(x width / sensor width).
    polarity : "unsigned": p_j and p_i do not matter; "split": the bins of the ON events, then those
        of the OFF events.

    Returns
    -------
    Tensor (49 or 98, H, W) of `dtype`, indexed [7 (z_y + 3) + z_x + 3, y, x].

    References
    ----------
    Sironi et al. 2018, arXiv:1803.07913, equations 5 to 8, without the decay exp(-(t_i - t_j) /
    tau). In the paper, tau is as long as ten thousand windows.

    Example
    -------
    >>> settings = dict(start_us=0, window_us=8, sensor=(4, 4), grid=(2, 2), polarity="unsigned")
    >>> h = hats([0, 1, 2], [0, 1, 1], [0, 0, 0], [1, 1, 1], **settings)
    >>> used = h[:, 0, 0].nonzero()[:, 0].tolist()
    >>> [(z // 7 - 3, z % 7 - 3, round(float(h[z, 0, 0]), 3)) for z in used]
    [(0, -1, 0.667), (0, 0, 0.333)]
    """
    check_polarity(polarity)
    if polarity == "signed":
        raise ValueError(
            "`polarity` must be 'split' or 'unsigned': histograms have no sign, got 'signed'"
        )
    check_size("sensor", sensor)
    columns, rows = check_size("grid", grid)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    n_polarities = 1 if polarity == "unsigned" else 2
    # 0 or 1: the part of the histogram that an event belongs to
    part = (signs(p, len(events.dt)) < 0).long() * (n_polarities - 1)
    side = 2 * RADIUS + 1
    total = torch.zeros(n_polarities, side, side, rows, columns, dtype=torch.float64)
    n_events = torch.zeros(rows, columns, dtype=torch.float64)
    earlier: list[tuple[int, int, int]] = []
    pixels = whole_pixels(events).tolist()
    for inside, (u, v), q in zip(events.inside.tolist(), pixels, part.tolist(), strict=True):
        if not inside:
            continue
        cell = v * rows // sensor[1], u * columns // sensor[0]
        for other_u, other_v, other_q in earlier:
            dx = other_u - u
            dy = other_v - v
            is_same_cell = (other_v * rows // sensor[1], other_u * columns // sensor[0]) == cell
            if is_same_cell and other_q == q and max(abs(dx), abs(dy)) <= RADIUS:
                total[(q, dy + RADIUS, dx + RADIUS, *cell)] += 1
        n_events[cell] += 1
        earlier.append((u, v, q))
    mean = total / torch.where(n_events > 0, n_events, 1.0)
    return mean.reshape(n_polarities * side * side, rows, columns).to(dtype)
