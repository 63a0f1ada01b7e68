"""A queue that a background thread fills from a source of packets."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

from async_tnt.base.checks import ParameterTypeError
from async_tnt.sources.queues.queue import PacketQueue


class BackgroundReader(PacketQueue):
    """A `PacketQueue` that a daemon thread fills from a source.

    A loop over it gets the packets in order.

    Reading starts at once. An exception of the source is raised in the reader's loop, after the
    packets before it; the loop ends where the source ends. Use it as a context manager (`with` or
    `async with`), or `close` it to stop the thread.

    Parameters
    ----------
    source : any iterable of packets, such as a camera, a recording or a generator. A packet has any
        form that `async_tnt.volume.event_forms` lists. Only the thread iterates the source.
    latest : what happens when the queue is full. False: the source is not read until there is room,
        so that nothing is lost. True: the oldest packets are discarded and their events counted, so
        that the delay stays bounded however slow the consumer is.
    max_packets, max_delay_us, copy : see `PacketQueue`.
    on_close : called by `close` to wake up a source that may wait forever for its next packet, such
        as the `close` of a camera or a socket.

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
        max_delay_us: int | None = None,
        copy: bool = True,
        on_close: Callable[[], Any] | None = None,
    ) -> None:
        if isinstance(source, (str, Path)):
            rule = f"must yield events, got the path {source}; open_recording(path) reads a file"
            raise ParameterTypeError("source", rule)
        if not hasattr(source, "__iter__") and not hasattr(source, "__getitem__"):
            if hasattr(source, "__aiter__"):
                rule = "is asynchronous already: pass it to `astream` directly"
                raise ParameterTypeError("source", rule)
            rule = "must be an iterable of packets"
            raise ParameterTypeError("source", rule, type(source).__name__)
        super().__init__(
            max_packets=max_packets, latest=latest, max_delay_us=max_delay_us, copy=copy
        )
        self._on_close = on_close
        self._thread = threading.Thread(
            target=self._read, args=(source,), name="async_tnt.BackgroundReader", daemon=True
        )
        self._thread.start()

    def close(self, timeout_s: float = 1.0) -> None:
        """Discard waiting packets, end the loop over this reader, and stop the thread.

        May be called again.

        A thread that waits in the source stops at the source's next packet, unless `on_close` wakes
        it.

        Parameters
        ----------
        timeout_s : how long to wait for the thread.
        """
        super().close()
        on_close = self._on_close
        self._on_close = None
        try:
            if on_close is not None:
                on_close()
        finally:
            if self._thread is not threading.current_thread():
                self._thread.join(timeout_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    async def aclose(self, timeout_s: float = 1.0) -> None:
        """Do what `close` does, while asyncio's other tasks run."""
        await asyncio.to_thread(self.close, timeout_s)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *error: object) -> None:
        await self.aclose()

    def _read(self, source: Iterable[Any]) -> None:
        """Put the packets of the source into the queue: the thread's work."""
        try:
            packets = iter(source)
            # The thread waits for room before it reads, so that the source is never ahead by more
            # packets than the queue holds.
            while self.wait_for_room():
                try:
                    packet = next(packets)
                except StopIteration:
                    break
                self.put(packet)
                del packet  # only the consumer keeps the packet's memory
        except BaseException as error:  # the consumer must see an error of any type
            self.end(error)
        else:
            self.end()
