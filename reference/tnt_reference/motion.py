"""The motion model: constant optical flow as a group that acts on events."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .coordinates import window_fraction
from .window import Column, as_column, check_same_length, whole_number


def move_by_flow(
    t: Column,
    x: Column,
    y: Column,
    flow: Sequence[float] | torch.Tensor,
    *,
    start_us: int,
    window_us: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The pixels x and y of events that a constant flow has moved.

    L_v (x, y, t) = (x + v_x f, y + v_y f, t)        f = (t - start_us) / window_us

    Parameters
    ----------
    t : (N,) integer microseconds, or float64.
    x, y : (N,) pixels, whole or not.
    flow : v = (v_x, v_y) in pixels per window; a tensor that requires a gradient gets one, as do t,
        x and y.
    start_us, window_us : f is 0 at the time `start_us`, and 1 at `start_us + window_us`.

    Returns
    -------
    x, y : (N,) float64. `L_-v` is the inverse.

    References
    ----------
    Wang 2019, arXiv:1911.12801.

    Example
    -------
    >>> t = [0, 50, 100]
    >>> flow = (8.0, -2.0)
    >>> x, y = move_by_flow(t, [7, 7, 7], [3, 3, 3], flow, start_us=0, window_us=100)
    >>> x.tolist(), y.tolist()
    ([7.0, 11.0, 15.0], [3.0, 2.0, 1.0])
    """
    if whole_number("window_us", window_us) <= 0:
        raise ValueError(f"`window_us` must be positive, got {window_us}")
    times = as_column("t", t)
    xs = as_column("x", x)
    ys = as_column("y", y)
    check_same_length(t=times, x=xs, y=ys)
    v = torch.as_tensor(flow, dtype=torch.float64)
    if v.shape != (2,):
        raise ValueError(f"`flow` must be (v_x, v_y), got shape {tuple(v.shape)}")
    f = window_fraction((times - whole_number("start_us", start_us)).double(), window_us)  # (N,)
    return xs.double() + v[0] * f, ys.double() + v[1] * f
