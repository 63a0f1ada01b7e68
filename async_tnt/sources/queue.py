"""A bounded queue of packets, from whoever brings them to one who reads them, in a loop or in asyncio."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from typing import Any

from async_tnt.checks import positive_int
from async_tnt.sources.own_packets import n_events_of, own_packet

LOOP_TURN_S = 1e-3  # asyncio's other tasks wait no longer than this for a queue that never runs empty


@dataclass(frozen=True, slots=True)
class QueueCounters:
    """What a queue has seen so far, all of one moment: received = handed_out + skipped + backlog."""

    received: int
    """Events that came in."""
    handed_out: int
    """Events that the reader got."""
    skipped: int
    """Events thrown away: too old for `latest=True`, or still waiting when the queue was closed."""
    backlog: int
    """Events that wait."""
    packets_received: int
    packets_handed_out: int
    packets_skipped: int
    packets_waiting: int
    waited_us: int
    """How long the newest packet that was handed out had waited in the queue, in microseconds."""
    longest_wait_us: int
    """The longest that a packet waited before it was handed out, in microseconds."""


class PacketQueue:
    """Packets in order of arrival, a bounded number of them.

    Any thread may `put`; one reader iterates, with `for` or with `async for`. The queue ends for the reader when
    `end` was called and the last packet is out.

    Parameters
    ----------
    max_packets : packets that wait at most.
    latest : what happens to a packet that finds the queue full. False: `put` waits until there is room. True: `put`
        never waits; the oldest packets are thrown away and their events counted, so that the reader skips ahead.
    max_events : events that wait at most, where packets differ much in size. A packet that is larger by itself
        passes alone.
    copy : whether `put` copies packets: drivers often reuse the memory of a packet for the next one, while in the
        queue it has to outlive that. False hands over what came, for sources that make each packet anew.

    Raises
    ------
    TypeError, ValueError : a limit is no whole number or below 1.

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
        self, *, max_packets: int = 64, latest: bool = False, max_events: int | None = None, copy: bool = True
    ) -> None:
        self.max_packets = positive_int("max_packets", max_packets)
        self.max_events = None if max_events is None else positive_int("max_events", max_events)
        self.latest = bool(latest)
        self.copy = bool(copy)
        # One lock, re-entrant: garbage collection, which may set in anywhere, closes the queue of a forgotten reader.
        lock = threading.RLock()
        self._came = threading.Condition(lock)  # a packet, or the end
        self._room = threading.Condition(lock)
        self._waiting: deque[tuple[Any, int, int]] = deque()  # packet, events, time of arrival in ns
        self._sleepers: list[tuple[asyncio.AbstractEventLoop, asyncio.Future[None]]] = []
        self._ended = self._closed = False
        self._error: BaseException | None = None
        self._backlog = self._received = self._handed_out = self._skipped = 0
        self._packets_received = self._packets_handed_out = self._packets_skipped = 0
        self._newest_ns: int | None = None  # arrival of the newest packet handed out
        self._wait_ns = self._longest_wait_ns = 0
        self._turn_s = 0.0  # when asyncio's other tasks last had their turn

    def __repr__(self) -> str:
        state = "closed" if self._closed else "ended" if self._ended else "open"
        return f"PacketQueue({state}, {self._backlog} events waiting, {self._skipped} skipped)"

    # -- packets in --------------------------------------------------------------------------------------

    def put(self, packet: Any) -> bool:
        """Add a packet, in any form that `async_tnt.event_forms` lists; without `latest`, wait for room first.

        Returns
        -------
        False if the queue is closed: nobody will read the packet, and its events count as skipped.

        Raises
        ------
        ValueError : after `end`.
        """
        arrived_ns = time.monotonic_ns()
        packet, n = own_packet(packet) if self.copy else (packet, n_events_of(packet))
        with self._came:
            if not self.latest:
                self.wait_for_room()
            if self._ended and not self._closed:
                raise ValueError("a packet after the end: this queue's end() was called; make a new PacketQueue")
            self._packets_received += 1
            self._received += n
            self._backlog += n
            self._waiting.append((packet, n, arrived_ns))
            if self._closed:
                self._skip_all()
                return False
            while len(self._waiting) > 1 and self._is_over():
                self._skip_oldest()
            self._came.notify()
            self._wake()
        return True

    def wait_for_room(self) -> bool:
        """Wait until a packet may come in; with `latest` that is always. Returns False if the queue is closed."""
        with self._room:
            while not (self._closed or self._ended or self.latest) and self._is_full():
                self._room.wait()
            return not self._closed

    def end(self, error: BaseException | None = None) -> None:
        """No packets come any more: the reader's loop ends after the last one, or raises `error` there."""
        with self._came:
            if not self._ended:
                self._ended = True
                self._error = None if self._closed else error  # a source that fails since it was closed did right
            self._wake_all()

    def close(self) -> None:
        """Stop at once: what waits is thrown away, `put` takes nothing more, and the reader's loop ends."""
        with self._came:
            self._closed = True
            self._error = None
            self._skip_all()
            self._wake_all()

    # -- packets out -------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        with self._came:
            while not self._is_due():
                self._came.wait()
            if self._waiting:
                return self._hand_out()
            self._raise_error()
        raise StopIteration

    def __aiter__(self) -> AsyncIterator[Any]:
        return self

    async def __anext__(self) -> Any:
        loop = asyncio.get_running_loop()
        if loop.time() - self._turn_s > LOOP_TURN_S:
            await asyncio.sleep(0)
            self._turn_s = loop.time()
        while True:
            with self._came:
                if self._is_due():
                    if self._waiting:
                        return self._hand_out()
                    self._raise_error()
                    raise StopAsyncIteration
                sleeper = (loop, loop.create_future())
                self._sleepers.append(sleeper)
            try:
                await sleeper[1]  # another task may be quicker: hence the loop
                self._turn_s = loop.time()
            finally:
                with self._came:
                    if sleeper in self._sleepers:  # cancelled
                        self._sleepers.remove(sleeper)

    # -- what is going on --------------------------------------------------------------------------------

    @property
    def backlog(self) -> int:
        """Events that wait."""
        return self._backlog

    @property
    def n_skipped(self) -> int:
        """Events thrown away."""
        return self._skipped

    @property
    def delay_us(self) -> int:
        """Age of the newest packet handed out: microseconds from its arrival until now. 0 before the first."""
        newest_ns = self._newest_ns
        return 0 if newest_ns is None else (time.monotonic_ns() - newest_ns) // 1000

    @property
    def counters(self) -> QueueCounters:
        """All counts, of one moment."""
        with self._came:
            return QueueCounters(
                received=self._received,
                handed_out=self._handed_out,
                skipped=self._skipped,
                backlog=self._backlog,
                packets_received=self._packets_received,
                packets_handed_out=self._packets_handed_out,
                packets_skipped=self._packets_skipped,
                packets_waiting=len(self._waiting),
                waited_us=self._wait_ns // 1000,
                longest_wait_us=self._longest_wait_ns // 1000,
            )

    # -- with the lock held ------------------------------------------------------------------------------

    def _is_due(self) -> bool:
        return bool(self._waiting) or self._ended or self._closed

    def _is_full(self) -> bool:
        if len(self._waiting) >= self.max_packets:
            return True
        return self.max_events is not None and bool(self._waiting) and self._backlog >= self.max_events

    def _is_over(self) -> bool:
        """More than may wait: only with `latest`, since otherwise there was room."""
        if not self.latest:
            return False
        most_events = self._backlog if self.max_events is None else self.max_events
        return len(self._waiting) > self.max_packets or self._backlog > most_events

    def _hand_out(self) -> Any:
        packet, n, arrived_ns = self._waiting.popleft()
        self._backlog -= n
        self._handed_out += n
        self._packets_handed_out += 1
        self._newest_ns = arrived_ns
        self._wait_ns = time.monotonic_ns() - arrived_ns
        self._longest_wait_ns = max(self._longest_wait_ns, self._wait_ns)
        self._room.notify()
        return packet

    def _skip_oldest(self) -> None:
        _, n, _ = self._waiting.popleft()
        self._backlog -= n
        self._skipped += n
        self._packets_skipped += 1

    def _skip_all(self) -> None:
        while self._waiting:
            self._skip_oldest()

    def _raise_error(self) -> None:
        error, self._error = self._error, None  # once: after it, the end
        if error is not None:
            raise error

    def _wake_all(self) -> None:
        self._came.notify_all()
        self._room.notify_all()
        self._wake()

    def _wake(self) -> None:
        sleepers, self._sleepers = self._sleepers, []
        for loop, future in sleepers:
            try:
                loop.call_soon_threadsafe(_resolve, future)
            except RuntimeError:  # that loop is closed, and who slept in it is gone
                continue


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
