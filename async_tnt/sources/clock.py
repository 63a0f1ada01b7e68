"""Times that go on where a camera's clock starts anew."""

from __future__ import annotations

import numpy as np

RESTART_US = 1_000_000  # drivers hand on events in order, but for microseconds


class ContinuousTime:
    """Shifts times, in place, where they fall back by more than `RESTART_US`: so often has the clock restarted.

    A camera's clock starts anew when a signal tells it to, or when its firmware recovers. Windows go by the
    events' own time, so a processor would wait, silently, until the new times reach the old ones. Here the event
    that falls back takes the time of the one before it (at the start of a packet, of the newest one that a packet
    ended with), and those after it keep their distance to it:

        t'_i = t_i + offset,    offset += t'_before - t'_i at each fall

    Parameters
    ----------
    field : of the packets' times, int64 or uint64 microseconds.

    Example
    -------
    >>> clock = ContinuousTime("t")
    >>> packets = [np.array([(t,) for t in times], [("t", "<u8")]) for times in ([5_000_000, 5_000_009], [3, 7])]
    >>> [clock(packet)["t"].tolist() for packet in packets], clock.restarts
    ([[5000000, 5000009], [5000009, 5000013]], 1)
    """

    def __init__(self, field: str) -> None:
        self._field = field
        self._offset_us = 0
        self._newest_us = -1
        self.restarts = 0

    @property
    def newest_us(self) -> int | None:
        """The newest time that a packet ended with, as the camera's clock counts now; None before the first."""
        return None if self._newest_us < 0 else self._newest_us - self._offset_us

    def __call__(self, events: np.ndarray) -> np.ndarray:
        """The same array, its times going on. It must not be empty."""
        t = events[self._field]
        if self._offset_us:
            t += self._offset_us
        newest = self._newest_us if self._newest_us >= 0 else int(t[0])
        while int(t[-1]) < newest - RESTART_US:  # mostly at most once in the life of a camera
            times = t.astype(np.int64)
            falls = -np.diff(times, prepend=newest)
            i = int(np.argmax(falls))
            fall = int(falls[i])
            t[i:] += fall
            self._offset_us += fall
            self.restarts += 1
        self._newest_us = max(newest, int(t[-1]))
        return events
