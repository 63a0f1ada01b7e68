"""The landmark: the point that the transform normalises each event about.

`running` and `line` use, for event i, events 1..i of the window only (in arrival order, i
included), which is what a stream knows at that moment. Each prefix is computed from its definition,
by sums over the prefix.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .coordinates import image_centre, to_grid, window_fraction
from .window import Column, check_size, window_events

LANDMARKS = ("center", "running", "line", "window")

# The most numbers in an array of `prefix_lines`, which has a row for each prefix and a column for
# each event. So many float64 numbers take 512 KiB, which fit in caches.
_CHUNK_CELLS = 1 << 16


def landmark(
    name: str,
    t: Column,
    x: Column,
    y: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
) -> torch.Tensor:
    """The landmark on which each event is centred, in grid pixels.

        center   l_i = c
        running  l_i = mean of x_1..x_i
        line     l_i = mean_x - m_i mean_f over events 1..i, with the slope m_i of `fitted_flow`
        window   l_i = mean of all the window's x

    Parameters
    ----------
    name : one of "center", "running", "line", "window".
    t, x, y : columns of N events, in arrival order: microseconds, sensor pixels.
    start_us, window_us : the window, `start_us <= t <= start_us + window_us`.
    sensor, grid : (width, height).

    Returns
    -------
    float64 tensor (N, 2), (x, y) in grid pixels. Rows of events outside the window hold the image
    centre and are never read; those events do not affect any other row.

    Raises
    ------
    ValueError, TypeError : the name is unknown, or the columns are not events of this sensor.

    References
    ----------
    Wang 2019, arXiv:1911.12801, the landmark of the Temporal Normalization Transform. `center` is
    the thesis' row "TNT"; the other three are ours.

    Example
    -------
    >>> settings = dict(start_us=0, window_us=10, sensor=(9, 9), grid=(9, 9))
    >>> landmark("running", t=[1, 2, 3], x=[0, 2, 7], y=[4, 4, 4], **settings).tolist()
    [[0.0, 4.0], [1.0, 4.0], [3.0, 4.0]]
    """
    if name == "regressor":
        raise ValueError(
            "landmark 'regressor' needs a network: use Pipeline, or pass the (x, y) it found"
        )
    if name not in LANDMARKS:
        raise ValueError(
            f"`landmark` must be one of {', '.join(LANDMARKS)}, or (x, y), or a tensor (N, 2); got "
            f"{name!r}"
        )
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    pixels = events.pixels[events.inside]  # (M, 2), the events that take part
    f = window_fraction(events.dt[events.inside], window_us)  # (M,)

    centre = image_centre(check_size("grid", grid, smallest=2), f.device)
    rows = centre.repeat(len(events.dt), 1)  # (N, 2)
    if name == "running":
        rows[events.inside] = to_grid(prefix_means(pixels), sensor, grid)
    elif name == "line":
        intercepts, _ = prefix_lines(pixels, f)
        rows[events.inside] = to_grid(intercepts, sensor, grid)
    elif name == "window" and len(pixels):
        rows[events.inside] = to_grid(pixels.sum(0).double() / len(pixels), sensor, grid)
    return rows


def fitted_flow(
    t: Column,
    x: Column,
    y: Column,
    *,
    start_us: int,
    window_us: int,
    sensor: tuple[int, int],
    grid: tuple[int, int],
) -> torch.Tensor:
    """The slope m_i that goes with landmark `line`: the flow fitted to events 1..i.

        m_i  = C_xf / (C_ff + 1)
        C_xf = sum_j (x_j - mean_x) (f_j - mean_f)
        C_ff = sum_j (f_j - mean_f)^2

    with all sums over j = 1..i. f_j is the time of event j since the window's start, as a fraction
    of the window. y is fitted in the same way.

    The 1, in units of squared windows, is a ridge. With few events, for which the plain fit would
    be ill-posed, the slope goes to 0 and the intercept goes to the running centroid.

    Parameters
    ----------
    t, x, y, start_us, window_us, sensor, grid : see `landmark`.

    Returns
    -------
    float64 tensor (N, 2): (x, y) in grid pixels per window. 0 for events outside the window.
    """
    check_size("grid", grid, smallest=2)
    events = window_events(t, x, y, start_us=start_us, window_us=window_us, sensor=sensor)
    f = window_fraction(events.dt[events.inside], window_us)
    _, slopes = prefix_lines(events.pixels[events.inside], f)
    rows = torch.zeros(len(events.dt), 2, dtype=torch.float64, device=f.device)
    rows[events.inside] = to_grid(slopes, sensor, grid)
    return rows


def prefix_means(pixels: torch.Tensor) -> torch.Tensor:
    """Row i: the mean of rows 0..i. (M, 2) -> (M, 2). Integer pixels are summed exactly."""
    n = torch.arange(1, len(pixels) + 1, dtype=torch.float64, device=pixels.device)  # (M,)
    return pixels.cumsum(0).double() / n[:, None]


def prefix_lines(pixels: torch.Tensor, f: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Row i: intercept and slope of the ridge line through rows 0..i.

    Parameters
    ----------
    pixels, f : (M, 2) and (M,).

    Returns
    -------
    intercepts, slopes : (M, 2) each.
    """
    means = prefix_means(pixels)  # (M, 2)
    mean_fs = prefix_means(f[:, None])  # (M, 1)
    # The lists begin with an empty part, so that the results for no events have the shape (0, 2).
    intercepts = [means[:0]]
    slopes = [means[:0]]

    # R prefixes at a time, because an array of all of them would be M x M
    n_rows = max(1, _CHUNK_CELLS // max(1, len(f)))
    for first in range(0, len(f), n_rows):
        last = min(first + n_rows, len(f))
        mean_xy = means[first:last]  # (R, 2)
        mean_f = mean_fs[first:last]  # (R, 1)
        df = f[:last] - mean_f  # (R, K)
        df[:, first:].tril_()  # 0 for events after the prefix
        c_ff = (df * df).sum(1)  # (R,)
        # A row of df adds up to 0, so the same point may be subtracted from all pixels. A point
        # near them avoids cancellation.
        c_xf = df @ (pixels[:last] - means[last - 1])  # (R, 2)
        m = c_xf / (c_ff + 1)[:, None]  # (R, 2)
        slopes.append(m)
        intercepts.append(mean_xy - m * mean_f)
    return torch.cat(intercepts), torch.cat(slopes)


def given_landmark(point: Sequence[float] | torch.Tensor, n_events: int) -> torch.Tensor:
    """A caller's own landmark, (x, y) or (N, 2) in grid pixels, as (N, 2) float64."""
    rows = point if isinstance(point, torch.Tensor) else torch.tensor(point, dtype=torch.float64)
    if tuple(rows.shape) not in ((2,), (n_events, 2)):
        raise ValueError(
            f"`landmark` must have shape (2,) or ({n_events}, 2), one row an event, got "
            f"{tuple(rows.shape)}"
        )
    if not rows.isfinite().all():
        raise ValueError("`landmark` must be finite, got NaN or infinity")
    return rows.double().expand(n_events, 2)
