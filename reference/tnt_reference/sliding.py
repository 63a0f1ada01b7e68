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


def slices(
    t: Column, start_us: int, span_us: int, bins: int, now_us: int | None = None
) -> torch.Tensor:
    """The bin of each event in a window of B slices; -1 for an event that it does not hold.

    With slices of d = span / B, and the slice of a time s(t) = floor((t - start) / d):

        b_i = s(t_i) - (s(now) - B + 1)
        held_i = (t_i >= start) and (b_i >= 0), and also when event i came, with now = m_i

    where m_i is the newest time of the events up to event i, and now = max_i m_i.

    Parameters
    ----------
    t : column of N times in microseconds, in the order in which the events came.
    start_us : the start of the first slice.
    span_us : positive, a multiple of `bins`.
    bins : B.
    now_us : a later time; by default that of the newest event.

    Returns
    -------
    int64 tensor, (N,).
    """
    length = whole_number("span_us", span_us) // whole_number("bins", bins)
    times = as_column("t", t).long()
    if not len(times):
        return torch.zeros(0, dtype=torch.int64)
    number = torch.div(times - start_us, length, rounding_mode="floor")
    newest = torch.cummax(number, 0).values
    now = int(newest[-1])
    if now_us is not None:
        now = max(now, (now_us - start_us) // length)
    came_in = (times >= start_us) & (number > newest - bins)
    b = number - (now - bins + 1)
    return torch.where(came_in & (b >= 0), b, -1)


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
