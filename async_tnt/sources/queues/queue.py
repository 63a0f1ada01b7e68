"""A bounded queue of packets, between threads that put them and a loop that reads them.

The loop may be one of asyncio.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from async_tnt.base.checks import ParameterValueError, positive_int
from async_tnt.volume.event_forms import named_columns

YIELD_AFTER_S = 1e-3
"""Seconds after which asyncio's other tasks can run while the queue is never empty."""


@dataclass(frozen=True, slots=True)
class QueueCounters:
    """The counts of a queue at one moment: received = handed_out + skipped + backlog."""

    received: int
    """Events put in."""
    handed_out: int
    """Events that the reader received."""
    skipped: int
    """Events discarded: too old for `latest=True`, or still waiting when the queue was closed."""
    backlog: int
    """Events that wait."""
    longest_wait_us: int
    """The longest that a packet waited before it was handed out, in microseconds."""


class PacketQueue:
    """A bounded queue of packets.

    Any thread may `put`; one reader iterates, with `for` or with `async for`, until `end` was
    called and the queue is empty.

    Parameters
    ----------
    max_packets : the most packets that wait.
    latest : what happens when the queue is full. False: `put` waits until there is room. True:
        `put` never waits; the oldest packets are discarded and their events counted, so that the
        reader skips ahead.
    max_delay_us : with `latest`: the longest that a packet may wait, in microseconds. Packets that
        have waited longer are discarded when the next packet is put in or read. The newest packet
        is kept, however long it has waited.
    copy : whether `put` copies packets. Drivers often reuse the memory of a packet for the next
        packet. False is for sources that put each packet in new memory.

    Attributes
    ----------
    backlog : number of events that wait.
    n_skipped : number of events that were discarded.

    Raises
    ------
    TypeError, ValueError : a limit is not a whole number, or is below 1; or `max_delay_us` is
        passed without `latest`.

    Example
    -------
    >>> queue = PacketQueue(max_packets=2, latest=True)
    >>> for t in (10, 20, 30):
    ...     _ = queue.put((t, 1, 1, 1))
    >>> queue.end()
    >>> list(queue), queue.n_skipped
    ([(20, 1, 1, 1), (30, 1, 1, 1)], 1)
    """

    def __init__(
        self,
        *,
        max_packets: int = 64,
        latest: bool = False,
        max_delay_us: int | None = None,
        copy: bool = True,
    ) -> None:
        self.max_packets = positive_int("max_packets", max_packets)
        self.max_delay_us: float = math.inf
        if max_delay_us is not None:
            self.max_delay_us = positive_int("max_delay_us", max_delay_us)
        if max_delay_us is not None and not latest:
            rule = "discards packets, which `latest=True` must allow"
            raise ParameterValueError("max_delay_us", rule)
        self.latest = bool(latest)
        self.copy = bool(copy)
        # One lock for all. It is re-entrant, because a signal handler that closes the queue may run
        # at any moment.
        lock = threading.RLock()
        self._arrival = threading.Condition(lock)  # a packet or the end has come
        self._room = threading.Condition(lock)
        # packet, events, time of arrival in ns
        self._waiting: deque[tuple[Any, int, int]] = deque()
        self._sleepers: list[asyncio.Future[None]] = []
        self._ended = False
        self._closed = False
        self._error: BaseException | None = None
        self.backlog = 0
        self.n_skipped = 0
        self._received = 0
        self._handed_out = 0
        self._newest_ns: int | None = None  # arrival of the newest packet handed out
        self._longest_wait_ns = 0
        self._yielded_s = 0.0  # when asyncio's other tasks last had a chance to run

    def __repr__(self) -> str:
        state = "open"
        if self._ended:
            state = "ended"
        if self._closed:
            state = "closed"
        return (
            f"{type(self).__name__}({state}, {self.backlog} events waiting, {self.n_skipped} "
            "skipped)"
        )

    # -- packets in --------------------------------------------------------------------------------

    def put(self, packet: Any) -> bool:
        """Add a packet. Without `latest`, waits for room first.

        Parameters
        ----------
        packet : in any form that `async_tnt.volume.event_forms` lists.

        Returns
        -------
        False if the queue is closed: the packet is discarded, and its events count as skipped.

        Raises
        ------
        ValueError : `end` has been called.
        """
        arrived_ns = time.monotonic_ns()
        packet, n = measured(packet, self.copy)
        with self._arrival:
            if not self.latest:
                self.wait_for_room()
            if self._ended and not self._closed:
                raise ValueError(
                    "a packet after the end: this queue's end() was called; make a new PacketQueue"
                )
            self._received += n
            self.backlog += n
            self._waiting.append((packet, n, arrived_ns))
            if self._closed:
                self._skip_all()
                return False
            while self.latest and len(self._waiting) > self.max_packets:
                self._skip_oldest()
            # `_hand_out` discards these, too. It is done here, so that memory stays bounded while
            # nobody reads.
            self._skip_outdated()
            self._arrival.notify()
            self._wake()
        return True

    def wait_for_room(self) -> bool:
        """Wait until there is room; with `latest` there always is.

        Returns
        -------
        False if the queue is closed.
        """
        with self._room:
            while not (self._ended or self.latest) and len(self._waiting) >= self.max_packets:
                self._room.wait()
            return not self._closed

    def end(self, error: BaseException | None = None) -> None:
        """Announce that no packets follow. The reader's loop ends after the last one.

        Parameters
        ----------
        error : an error that the loop raises at its end; None: the loop ends without an error.
        """
        with self._arrival:
            # After `close` the queue has ended already, and an error that the closing has caused in
            # the source is dropped.
            if not self._ended:
                self._ended = True
                self._error = error
            self._wake_all()

    def close(self) -> None:
        """Stop now: discard waiting packets, accept no more, and end the reader's loop."""
        with self._arrival:
            self._ended = True
            self._closed = True
            self._error = None
            self._skip_all()
            self._wake_all()

    # -- packets out -------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        with self._arrival:
            while not self._is_ready():
                self._arrival.wait()
            if self._waiting:
                return self._hand_out()
            self._raise_error()
        raise StopIteration

    def __aiter__(self) -> AsyncIterator[Any]:
        return self

    async def __anext__(self) -> Any:
        loop = asyncio.get_running_loop()
        if loop.time() - self._yielded_s > YIELD_AFTER_S:
            await asyncio.sleep(0)
            self._yielded_s = loop.time()
        while True:
            with self._arrival:
                if self._is_ready():
                    if self._waiting:
                        return self._hand_out()
                    self._raise_error()
                    raise StopAsyncIteration
                sleeper = loop.create_future()
                self._sleepers.append(sleeper)
            try:
                await sleeper  # if another task takes the packet first, the loop waits again
                self._yielded_s = loop.time()
            finally:
                with self._arrival:
                    if sleeper in self._sleepers:  # this task was cancelled
                        self._sleepers.remove(sleeper)

    # -- counts ------------------------------------------------------------------------------------

    @property
    def delay_us(self) -> int:
        """Microseconds since the arrival of the newest packet that was handed out.

        0 before the first packet.
        """
        if self._newest_ns is None:
            return 0
        return (time.monotonic_ns() - self._newest_ns) // 1000

    @property
    def counters(self) -> QueueCounters:
        """All counts at one moment."""
        with self._arrival:
            return QueueCounters(
                self._received,
                self._handed_out,
                self.n_skipped,
                self.backlog,
                self._longest_wait_ns // 1000,
            )

    # -- with the lock held ------------------------------------------------------------------------

    def _is_ready(self) -> bool:
        """Whether the reader need not wait: there is a packet, or the end."""
        return bool(self._waiting) or self._ended

    def _hand_out(self) -> Any:
        """Take the oldest packet that is not too old."""
        self._skip_outdated()
        if self._waiting:
            packet, n, arrived_ns = self._waiting.popleft()
        else:  # a signal handler has closed the queue meanwhile
            packet = None
            n = 0
            arrived_ns = time.monotonic_ns()
        self.backlog -= n
        self._handed_out += n
        self._newest_ns = arrived_ns
        self._longest_wait_ns = max(self._longest_wait_ns, time.monotonic_ns() - arrived_ns)
        self._room.notify()
        return packet

    def _skip_outdated(self) -> None:
        """Discard packets that have waited for too long, except the newest one."""
        oldest_ns = time.monotonic_ns() - 1000 * self.max_delay_us
        while len(self._waiting) > 1 and self._waiting[0][2] < oldest_ns:
            self._skip_oldest()

    def _skip_oldest(self) -> None:
        _, n, _ = self._waiting.popleft()
        self.backlog -= n
        self.n_skipped += n

    def _skip_all(self) -> None:
        while self._waiting:
            self._skip_oldest()

    def _raise_error(self) -> None:
        """Raise the error that `end` was given, once."""
        error = self._error
        self._error = None
        if error is not None:
            raise error

    def _wake_all(self) -> None:
        self._arrival.notify_all()
        self._room.notify_all()
        self._wake()

    def _wake(self) -> None:
        """Wake up the readers of asyncio."""
        sleepers = self._sleepers
        self._sleepers = []
        for sleeper in sleepers:
            with contextlib.suppress(RuntimeError):  # the event loop is closed, its tasks are gone
                sleeper.get_loop().call_soon_threadsafe(_resolve, sleeper)


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


def measured(packet: Any, copy: bool) -> tuple[Any, int]:
    """A packet, or a copy of it, and the number of its events.

    A structured array and a tuple of four columns keep their form when they are copied. Other
    objects become a tuple of four columns (t, x, y, p). An object that is no packet of events
    counts 0 events: its reader will refuse it.

    Parameters
    ----------
    packet : in any form that `async_tnt.volume.event_forms` lists.
    """
    if isinstance(packet, np.ndarray) and packet.dtype.names is not None and packet.ndim == 1:
        if copy:
            packet = _copied(packet)
        return packet, len(packet)
    try:
        columns = named_columns(packet)
    except (TypeError, ValueError):
        return packet, 0
    if columns is None:
        return packet, 0
    n_events = columns[0].size
    is_one_event = isinstance(packet, tuple) and all(type(value) is int for value in packet)
    if not copy or is_one_event:
        return packet, n_events
    return tuple(column.copy() for column in columns), n_events


def _copied(packet: np.ndarray) -> np.ndarray:
    """A copy of a structured array."""
    if type(packet) is not np.ndarray or not packet.flags.c_contiguous or packet.dtype.hasobject:
        return packet.copy()
    # NumPy itself copies records field by field, which is five times as slow.
    return packet.view(np.uint8).copy().view(packet.dtype)
