"""When pictures are taken: at fixed steps from the start of each window, and at its end."""

from __future__ import annotations


def next_moment(t_us: int, origin_us: int, window_us: int, step_us: int) -> int:
    """The first moment after `t_us` at which a picture is due.

    Windows are laid end to end from `origin_us`. Pictures are due every `step_us` from a window's start and at its end,
    so that the last picture of a window shows all of it. Where a window is shorter than a step: at the end of as many
    whole windows as a step needs.

    Parameters
    ----------
    t_us, origin_us : int microseconds; `t_us` may be before `origin_us`.
    window_us, step_us : int microseconds, at least 1.

    Examples
    --------
    >>> [next_moment(t, 1000, 105, 40) for t in (1000, 1040, 1080, 1105)]
    [1040, 1080, 1105, 1145]
    >>> [next_moment(t, 1000, 30, 40) for t in (1000, 1060)]
    [1060, 1120]
    """
    if window_us < step_us:
        window_us = step_us = window_us * -(-step_us // window_us)
    start_us = t_us - (t_us - origin_us) % window_us
    return min(start_us + ((t_us - start_us) // step_us + 1) * step_us, start_us + window_us)
