"""A queue with bounded delay, for events that outrun the network.

The queue lets the processor decide less often. If that is not enough, the queue skips whole
packets, and counts their events.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from async_tnt.sources.queues.background_reader import BackgroundReader

MAX_PACKETS = 1 << 20
"""The most packets that wait. It is large, because the delay is the limit, and packets may be
small."""

SLOWER_FROM = 0.25
"""Share of `max_delay_us`: a packet that waited longer than that makes decisions rarer."""

URGENT_FROM = 0.5
"""Share of `max_delay_us`: after a longer wait than that, the next change comes soon."""

FASTER_BELOW = 0.05
"""Share of `max_delay_us`: a packet that waited for less than that makes decisions more frequent
again."""

PAUSE = 0.25
"""Least time between two changes, as a share of `max_delay_us`, because a change takes effect only
after a while."""

URGENT_PAUSE = 0.05
"""Least time between two changes where the second is urgent, as a share of `max_delay_us`."""

MOST_SLOWER = 1 << 10
"""The largest factor by which decisions become rarer."""


class KeepUp(BackgroundReader):
    """A `BackgroundReader` with bounded delay.

    When a packet is handed out, it is at most `max_delay_us` old, unless it is the newest one.

    While packets wait for more than a quarter of `max_delay_us`, decisions become rarer: the
    processor's `every_us` and `every_events` are doubled, step by step, up to the length of a
    window, and by a factor of 1,024 at most. While packets wait for less than a twentieth of
    `max_delay_us`, both settings are halved again, step by step, down to the values that the
    processor had at first. The processor has these values again after the `with` block.

    If that is not enough, packets that have waited for more than `max_delay_us` are discarded, also
    while nobody reads. Their events are counted: received = handed_out + skipped + backlog, see
    `counters`.

    Parameters
    ----------
    source : any iterable of packets.
    processor : the `Processor` that receives the packets. Its `every_us` and `every_events` are
        changed here.
    max_delay_us : the longest that a packet may wait, in microseconds.
    copy, on_close : see `BackgroundReader`.

    Attributes
    ----------
    slower : the factor by which decisions are rarer now: 1, 2, 4, ...
    slowest : the largest of these factors so far.

    Example
    -------
    >>> from async_tnt import Processor, load_model, stream
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> processor = Processor(load_model("digits"), every_us=50_000)
    >>> recording = open_recording(sample_recordings()[3])
    >>> with KeepUp(recording, processor, max_delay_us=60_000_000) as packets:
    ...     decisions = list(stream(packets, processor))
    >>> decisions[-1].label, packets.slower, packets.n_skipped
    ('3', 1, 0)
    """

    def __init__(
        self,
        source: Iterable[Any],
        processor: Any,
        *,
        max_delay_us: int,
        copy: bool = True,
        on_close: Callable[[], Any] | None = None,
    ) -> None:
        self.slower = 1
        self.slowest = 1
        self._processor = processor
        self._every_us = processor.every_us
        self._every_events = processor.every_events
        self._most_slower = self._useful_factor()
        self._changed_ns = 0
        super().__init__(
            source,
            latest=True,
            max_packets=MAX_PACKETS,
            max_delay_us=max_delay_us,
            copy=copy,
            on_close=on_close,
        )

    def close(self, timeout_s: float = 1.0) -> None:
        """Close the reader, see `BackgroundReader`; the processor decides as often as at first."""
        try:
            super().close(timeout_s)
        finally:
            # An error means that a call of the processor is running. Then the loop over this reader
            # restores the settings.
            with contextlib.suppress(RuntimeError):
                self._set(1, 0)

    def _useful_factor(self) -> int:
        """The largest factor by which decisions can become rarer."""
        if self._every_events is not None:
            return MOST_SLOWER
        if self._every_us is None:
            return 1
        # a step longer than the window changes nothing
        n_steps: int = -(-self._processor.config.window_us // self._every_us)  # rounded up
        return min(n_steps, MOST_SLOWER)

    def _raise_error(self) -> None:
        self._set(1, 0)  # the loop over this reader ends here
        super()._raise_error()

    def _hand_out(self) -> Any:
        packet = super()._hand_out()
        self._adapt()
        return packet

    def _adapt(self) -> None:
        """Set how often the processor decides, by how long the handed-out packet has waited."""
        wait = self.delay_us / self.max_delay_us  # as a share of the longest allowed
        now_ns = time.monotonic_ns()
        pause = URGENT_PAUSE if wait > URGENT_FROM else PAUSE
        least_ns = 1000 * pause * self.max_delay_us
        if now_ns - self._changed_ns < least_ns:
            return
        if wait > SLOWER_FROM and self.slower < self._most_slower:
            self._set(2 * self.slower, now_ns)
        elif wait < FASTER_BELOW and self.slower > 1:
            self._set(self.slower // 2, now_ns)

    def _set(self, slower: int, now_ns: int) -> None:
        """Make decisions rarer by the factor `slower`, but no rarer than one for each window."""
        self.slower = slower
        self._changed_ns = now_ns
        self.slowest = max(self.slowest, slower)
        config = self._processor.config
        if self._every_us is not None:
            longest_us = max(self._every_us, config.window_us)
            self._processor.every_us = min(slower * self._every_us, longest_us)
        if self._every_events is not None:
            n_wanted = slower * self._every_events
            n_most = max(self._every_events, config.window_events or n_wanted)
            self._processor.every_events = min(n_wanted, n_most)
