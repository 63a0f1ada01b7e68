"""Which events a sliding window holds, from the definition."""

from __future__ import annotations

import torch

from .window import Column, as_column, whole_number


def last_events(t: Column, n: int) -> torch.Tensor:
    """Whether each event is one of the last n that have come.

    Parameters
    ----------
    t : column of N times, in the order in which the events came.
    n : positive.

    Returns
    -------
    bool tensor, (N,).
    """
    count = whole_number("n", n)
    place = torch.arange(len(as_column("t", t)))
    return place >= len(place) - count


def last_us(t: Column, span_us: int, now_us: int | None = None) -> torch.Tensor:
    """Whether each event is younger than `span_us`.

    With the newest time m_i of the events up to event i, and now = max_i m_i:

        held_i = (t_i > m_i - span) and (t_i > now - span)

    So an event that comes so late that it would have left already never comes in.

    Parameters
    ----------
    t : column of N times in microseconds, in the order in which the events came.
    span_us : positive.
    now_us : a later time; by default that of the newest event.

    Returns
    -------
    bool tensor, (N,).
    """
    span = whole_number("span_us", span_us)
    times = as_column("t", t).long()
    if not len(times):
        return torch.zeros(0, dtype=torch.bool)
    newest = torch.cummax(times, 0).values
    now = int(newest[-1]) if now_us is None else max(int(newest[-1]), now_us)
    return (times > newest - span) & (times > now - span)
