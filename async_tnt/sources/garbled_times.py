"""Leaves out events whose times a cable or a driver garbled."""

from __future__ import annotations

import numpy as np

from async_tnt.sources.clock import RESTART_US

SILENCE_US = 60_000_000  # within a packet; between packets it may last
LATEST_US = 1 << 53  # 285 years, also where a camera counts from 1970; a flipped high bit is beyond


def without_garbled_times(events: np.ndarray, field: str, newest_us: int | None) -> np.ndarray:
    """The same array, but for events whose time cannot be: one of them would make a processor wait for it, silently.

    Left out is what is more than `RESTART_US` ahead of both the newest event of the packets before and this packet's
    median, and which the packet then falls back from, or which is more than `SILENCE_US` ahead; and whatever lies
    outside of [0, `LATEST_US`). Of a packet that is garbled for the greater part, the rest is what the clock goes by.

    Parameters
    ----------
    events : structured array; must not be empty.
    field : of its times, int64 or uint64 microseconds.
    newest_us : as the camera's clock has it; None where nothing came before.

    Examples
    --------
    >>> packet = np.array([(t,) for t in (10, 2_000_010, 12, 3 << 61, 13)], [("t", "<u8")])
    >>> without_garbled_times(packet, "t", 9)["t"].tolist()
    [10, 12, 13]
    """
    times = events[field].view(np.uint64)  # below 0 is beyond LATEST_US
    top = int(times.max())
    if newest_us is not None and top <= min(newest_us + RESTART_US, LATEST_US - 1):
        return events  # mostly: one look at each time
    if top >= LATEST_US:
        events = events[times < LATEST_US]
        if len(events) == 0:
            return events
    t = events[field].astype(np.int64)
    middle = (len(t) - 1) // 2
    usual = int(np.partition(t, middle)[middle])
    if newest_us is not None:
        usual = max(usual, newest_us)
    oldest_to_come = np.minimum.accumulate(t[::-1])[::-1]
    garbled = (t > usual + RESTART_US) & ((t - oldest_to_come > RESTART_US) | (t > usual + SILENCE_US))
    return events[~garbled] if garbled.any() else events
