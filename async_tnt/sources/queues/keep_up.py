"""What to do when events outrun the network: decide less often, then skip whole packets, always
counted."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from async_tnt.sources.queues.background_reader import BackgroundReader

MAX_PACKETS = 1 << 20
"""That wait at most: the delay decides, and packets may be small."""
SLOWER_FROM, URGENT_FROM, FASTER_BELOW = 0.25, 0.5, 0.05
"""Shares of `max_delay_us`."""
PAUSE, URGENT_PAUSE = 0.25, 0.05
"""Between two changes, as such shares: what was changed shows after a while."""
MOST_SLOWER = 1 << 10


class KeepUp(BackgroundReader):
    """A `BackgroundReader` whose packets, but for the newest, are at most `max_delay_us` old when
    they are handed out.

    While packets wait for more than a quarter of that, `every_us` and `every_events` of the
    processor that reads them are doubled, again and again, up to a window's length and to 1,024
    times; while they wait for less than a twentieth, they are halved, down to what they were, and
    what they were they are again behind the `with` block. Packets that waited for longer than
    `max_delay_us` all the same are discarded, also while nobody reads. Their events are counted:
    received = handed_out + skipped + backlog, see `counters`.

    Parameters
    ----------
    source : any iterable of packets.
    processor : the `Processor` that is given the packets; its `every_us` and `every_events` are set
        here.
    max_delay_us : in microseconds.
    copy, on_close : as for `BackgroundReader`.

    Attributes
    ----------
    slower : by how much decisions are rarer now: 1, 2, 4, ...
    slowest : the largest of these so far.

    Example
    -------
    >>> from async_tnt import Processor, load_model, stream
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> processor = Processor(load_model("digits"), every_us=50_000)
    >>> with KeepUp(open_recording(sample_recordings()[3]), processor, max_delay_us=60_000_000) as packets:
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
        self.slower = self.slowest = 1
        self._processor = processor
        self._every = every_us, every_events = processor.every_us, processor.every_events
        most = 1 if every_us is None else -(-processor.config.window_us // every_us)
        # beyond, nothing changes
        self._most = MOST_SLOWER if every_events is not None else min(most, MOST_SLOWER)
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
        """As of `BackgroundReader`; the processor decides as often as before."""
        try:
            super().close(timeout_s)
        finally:
            # the processor is at work: the loop over this reader sets it
            with contextlib.suppress(RuntimeError):
                self._set(1, 0)

    def _raise_error(self) -> None:
        self._set(1, 0)  # here the loop ends
        super()._raise_error()

    def _hand_out(self) -> Any:
        packet = super()._hand_out()
        self._adapt()
        return packet

    def _adapt(self) -> None:
        """Set how often the processor decides, by how long the packet that was handed out has
        waited."""
        waited, now_ns = self.delay_us / self.max_delay_us, time.monotonic_ns()
        pause = URGENT_PAUSE if waited > URGENT_FROM else PAUSE
        if now_ns - self._changed_ns < 1000 * pause * self.max_delay_us:
            return
        if waited > SLOWER_FROM and self.slower < self._most:
            self._set(2 * self.slower, now_ns)
        elif waited < FASTER_BELOW and self.slower > 1:
            self._set(self.slower // 2, now_ns)

    def _set(self, slower: int, now_ns: int) -> None:
        self.slower, self._changed_ns = slower, now_ns
        self.slowest = max(self.slowest, slower)
        every_us, every_events = self._every
        if every_us is not None:
            self._processor.every_us = min(
                slower * every_us, max(every_us, self._processor.config.window_us)
            )
        if every_events is not None:
            # beyond, nothing changes
            most = self._processor.config.window_events or slower * every_events
            self._processor.every_events = min(slower * every_events, max(every_events, most))
