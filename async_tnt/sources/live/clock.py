"""A filter of times that jump, because of a sender's or a camera's clock."""

from __future__ import annotations

import numpy as np

from async_tnt.base.checks import ParameterValueError
from async_tnt.kernels.entry_points import prepare
from async_tnt.kernels.sources.clock import (
    INITIAL,
    JUMPED,
    LATE,
    NO_LIMIT,
    RESTARTS,
    repair_times,
)


class Clock:
    """A filter that drops events whose time jumps.

    It drops them until eight consecutive packets agree that the clock has moved.

    A processor relies on the events' own times: one time far ahead closes all its windows, and
    after a fall back all times come too late for its windows. Let n be the newest time so far. The
    rule, for a packet that arrives here `pause` microseconds after the event of this time, is

        an event jumps   iff   t > n + pause + max_jump   or   t < n - max(1 s - pause, 20 ms)

    Such events are dropped and counted. `pause` allows for a camera that sees nothing for an hour,
    and reveals a short recording that is sent again.

    If all events of a packet jump, the packet votes for its oldest time. If this time lies within
    `max_jump` of the previous vote's time, allowing for the time that has passed here since, it
    counts as one more vote. Otherwise the votes start again. A packet with an event that does not
    jump ends the votes. With the eighth vote the clock has moved. If it moved ahead, its times are
    kept. If it moved back, by a restart or a wrap, times continue: all are shifted from here on, so
    that the oldest event of this packet takes the time n.

    The first packet starts the clock at its oldest event, which lies before the year 2100.

    Parameters
    ----------
    max_jump_s : seconds; None: every time is trusted and kept as it is.

    Attributes
    ----------
    max_jump_us, state : arguments of the kernel.

    Raises
    ------
    ParameterValueError : `max_jump_s` is out of range.

    Example
    -------
    >>> clock = Clock(max_jump_s=1)
    >>> def kept(*times, arrival_us=0):
    ...     events = np.array([(t,) for t in times], [("t", "<u8")])
    ...     return clock(events, "t", arrival_us)["t"].tolist()
    >>> kept(5_000_000, 5_000_009)
    [5000000, 5000009]
    >>> kept(5_000_020, 90_000_000, 5_000_030)  # one time is garbled
    [5000020, 5000030]
    >>> kept(4_000_000_000, arrival_us=4_000_000_000)  # an hour of silence is no jump
    [4000000000]

    The camera starts again:

    >>> [kept(10 * k, 10 * k + 5, arrival_us=4_000_000_000) for k in range(9)][6:]
    [[], [4000000000, 4000000005], [4000000010, 4000000015]]
    >>> clock.jumped, clock.restarts
    (15, 1)
    """

    def __init__(self, max_jump_s: float | None) -> None:
        if max_jump_s is not None and not 0 < max_jump_s < 1e9:
            rule = "must be a positive number of seconds, or None"
            raise ParameterValueError("max_jump_s", rule, max_jump_s)
        prepare(repair_times)
        self.max_jump_us = NO_LIMIT if max_jump_s is None else round(max_jump_s * 1e6)
        self.state = np.array(INITIAL, np.int64)

    def __call__(self, events: np.ndarray, field: str, arrival_us: int) -> np.ndarray:
        """The events of a packet that are kept, in the packet's own memory, which is changed.

        Parameters
        ----------
        events : structured array, contiguous.
        field : name of the field of times, int64 or uint64.
        arrival_us : when the packet arrived, in microseconds on the receiver's clock.
        """
        if events.dtype.fields is None or events.dtype.fields[field][0].itemsize != 8:
            raise TypeError(f"the field `{field}` must be a time of 64 bits, got {events.dtype}")
        time_at = events.dtype.fields[field][1]
        records = events.view(np.uint8)
        size = events.itemsize
        n_kept = repair_times.checked(
            records, 0, len(events), size, time_at, arrival_us, self.max_jump_us, self.state
        )
        return events if n_kept == len(events) else events[:n_kept]

    @property
    def jumped(self) -> int:
        """The number of events that were dropped."""
        return int(self.state[JUMPED])

    @property
    def late(self) -> int:
        """The number of events that were kept although an event before them has a later time."""
        return int(self.state[LATE])

    @property
    def restarts(self) -> int:
        """The number of times that the clock moved back."""
        return int(self.state[RESTARTS])
