"""Read a source of packets in a background thread, so that it never waits for their consumer."""

from __future__ import annotations

import asyncio
import threading
import weakref
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from async_tnt.sources.queue import PacketQueue, QueueCounters


class BackgroundReader:
    """Iterates a source in a daemon thread, into a bounded queue; iterating the reader yields the packets in order.

    Reading starts at once. An exception of the source is raised in the reader's loop, after the packets before it; the
    loop ends where the source ends. Use it as a context manager (`with` or `async with`), or `close` it to stop the
    thread. A forgotten reader stops when it is garbage collected.

    Parameters
    ----------
    source : any iterable of packets, in any form that `async_tnt.event_forms` lists: a camera, a recording, a
        generator. Only the thread iterates it.
    latest : what happens when the queue is full. False: the source is not read until there is room, so that nothing
        is lost. True: the oldest packets are discarded and their events counted, so that the delay stays bounded
        however slow the consumer is.
    max_packets, max_events, copy : as for `PacketQueue`.
    on_close : called by `close` to wake up a source that may wait forever for its next packet, such as the `close` of a
        camera or a socket.

    Raises
    ------
    TypeError : the source is not iterable, or a limit is not a whole number.
    ValueError : a limit is below 1.

    Example
    -------
    >>> from async_tnt import stream
    >>> from async_tnt.sources import open_recording, sample_recordings
    >>> with BackgroundReader(open_recording(sample_recordings()[3])) as reader:
    ...     [decision.label for decision in stream(reader, "digits")]
    ['3', '3', '3']
    """

    def __init__(
        self,
        source: Iterable[Any],
        *,
        max_packets: int = 64,
        latest: bool = False,
        max_events: int | None = None,
        copy: bool = True,
        on_close: Callable[[], Any] | None = None,
    ) -> None:
        if isinstance(source, (str, Path)):
            raise TypeError(f"`source` must yield events, got the path {source}; open_recording(path) reads a file")
        if not hasattr(source, "__iter__") and not hasattr(source, "__getitem__"):
            if hasattr(source, "__aiter__"):
                raise TypeError("`source` is asynchronous already: pass it to `astream` directly")
            raise TypeError(f"`source` must be an iterable of packets, got {type(source).__name__}")
        self._queue = PacketQueue(max_packets=max_packets, latest=latest, max_events=max_events, copy=copy)
        self._on_close = on_close
        # The thread refers to the queue, not the reader, which can thus be garbage collected while the thread runs.
        self._thread = threading.Thread(
            target=_read, args=(source, self._queue), name="async_tnt.BackgroundReader", daemon=True
        )
        self._forgotten = weakref.finalize(self, self._queue.close)
        self._thread.start()

    def __repr__(self) -> str:
        return f"BackgroundReader({self._queue!r})"

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        return next(self._queue)

    def __aiter__(self) -> AsyncIterator[Any]:
        return self

    async def __anext__(self) -> Any:
        return await self._queue.__anext__()

    @property
    def backlog(self) -> int:
        """Events that wait."""
        return self._queue.backlog

    @property
    def n_skipped(self) -> int:
        """Events discarded."""
        return self._queue.n_skipped

    @property
    def delay_us(self) -> int:
        """Age of the newest packet handed out: microseconds from its arrival until now. 0 before the first."""
        return self._queue.delay_us

    @property
    def counters(self) -> QueueCounters:
        """All counts, at one moment."""
        return self._queue.counters

    def close(self, timeout_s: float = 1.0) -> bool:
        """Discard waiting packets, end the loop over this reader, and stop the thread. May be called again.

        A thread that waits in the source stops at the source's next packet, unless `on_close` wakes it.

        Parameters
        ----------
        timeout_s : how long to wait for the thread.

        Returns
        -------
        True if the thread has stopped.
        """
        try:
            self._stop()
        finally:
            if self._thread is not threading.current_thread():
                self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _stop(self) -> None:
        self._queue.close()
        on_close, self._on_close = self._on_close, None
        if on_close is not None:
            on_close()

    def __enter__(self) -> BackgroundReader:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    async def aclose(self, timeout_s: float = 1.0) -> bool:
        """`close`, with the same `timeout_s` in seconds, while asyncio's other tasks run."""
        self._stop()
        await asyncio.to_thread(self._thread.join, timeout_s)
        return not self._thread.is_alive()

    async def __aenter__(self) -> BackgroundReader:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.aclose()


def _read(source: Iterable[Any], queue: PacketQueue) -> None:
    """The thread's work."""
    try:
        packets = iter(source)
        while queue.wait_for_room():  # before reading the source: it is never ahead by more than the queue holds
            try:
                packet = next(packets)
            except StopIteration:
                break
            queue.put(packet)
            del packet  # its memory belongs to the consumer
    except BaseException as error:  # whatever it is, the consumer must see it
        queue.end(error)
    else:
        queue.end()
