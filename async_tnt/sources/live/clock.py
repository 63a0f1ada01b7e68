"""Times that only go forward, whatever a sender's or a camera's clock does."""

from __future__ import annotations

import numpy as np

from async_tnt.kernels.jit import compile_only
from async_tnt.kernels.sources.clock import (
    ARGUMENTS,
    INITIAL,
    JUMPED,
    LATE,
    NO_LIMIT,
    RESTARTS,
    repair_times,
)


class Clock:
    """Drops events whose time jumps, until eight consecutive packets agree that the clock has
    moved.

    A processor relies on the events' own times: one time far ahead closes all its windows, and
    after a fall back all times come too late for them. The rule, for a packet that arrives when
    `passed` microseconds have gone by here since the newest event so far, n:

        an event jumps   iff   t > n + passed + max_jump   or   t < n - max(1 s - passed, 20 ms)

    Such events are dropped and counted. `passed` allows for a camera that sees nothing for an hour,
    and reveals a short recording that is sent again. Where all events of a packet jump, the packet
    votes for its oldest time: within `max_jump` of the previous vote, or later by what has passed
    here since, it adds to it, elsewhere it starts a new one; a packet with an event that does not
    jump ends the vote. With the eighth vote the clock has moved. A clock that moved ahead keeps its
    times. After one moved back, by a restart or a wrap, times continue: all are shifted from here
    on, so that the oldest event of this packet takes the time n.

    The first packet starts the clock at its oldest event, which lies before the year 2100.

    Parameters
    ----------
    max_jump_s : seconds; None: every time is trusted and kept as it is.

    Attributes
    ----------
    max_jump_us, state : for the kernel.

    Raises
    ------
    ValueError : `max_jump_s` out of range.

    Example
    -------
    >>> clock = Clock(max_jump_s=1)
    >>> def times_of(*times, arrival_us=0):
    ...     return clock(np.array([(t,) for t in times], [("t", "<u8")]), "t", arrival_us)["t"].tolist()
    >>> times_of(5_000_000, 5_000_009), times_of(5_000_020, 90_000_000, 5_000_030)  # one time is garbled
    ([5000000, 5000009], [5000020, 5000030])
    >>> times_of(4_000_000_000, arrival_us=4_000_000_000)  # an hour of silence is no jump
    [4000000000]
    >>> [times_of(10 * k, 10 * k + 5, arrival_us=4_000_000_000) for k in range(9)][6:]  # the camera starts again
    [[], [4000000000, 4000000005], [4000000010, 4000000015]]
    >>> clock.jumped, clock.restarts
    (15, 1)
    """

    def __init__(self, max_jump_s: float | None) -> None:
        if max_jump_s is not None and not 0 < max_jump_s < 1e9:
            raise ValueError(
                f"`max_jump_s` must be a positive number of seconds, or None, got {max_jump_s}"
            )
        compile_only(repair_times, *ARGUMENTS)
        self.max_jump_us = NO_LIMIT if max_jump_s is None else round(max_jump_s * 1e6)
        self.state = np.array(INITIAL, np.int64)

    def __call__(self, events: np.ndarray, field: str, arrival_us: int) -> np.ndarray:
        """The events of a packet that are kept, in its own memory, which is changed.

        Parameters
        ----------
        events : structured array, contiguous.
        field : of its times, int64 or uint64.
        arrival_us : of the packet, on the receiver's clock.
        """
        if events.dtype.fields is None or events.dtype.fields[field][0].itemsize != 8:
            raise TypeError(f"the field `{field}` must be a time of 64 bits, got {events.dtype}")
        time_at = events.dtype.fields[field][1]
        records = events.view(np.uint8)
        size = events.itemsize
        kept = repair_times(
            records, 0, len(events), size, time_at, arrival_us, self.max_jump_us, self.state
        )
        return events if kept == len(events) else events[:kept]

    @property
    def jumped(self) -> int:
        """Events dropped."""
        return int(self.state[JUMPED])

    @property
    def late(self) -> int:
        """Events kept that are older than one before them."""
        return int(self.state[LATE])

    @property
    def restarts(self) -> int:
        """How often the clock moved back."""
        return int(self.state[RESTARTS])
