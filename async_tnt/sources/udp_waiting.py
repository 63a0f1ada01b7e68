"""Sleeping until a datagram comes or somebody ends the wait: for a thread, and for a task of asyncio."""

from __future__ import annotations

import asyncio
import select
import socket
import time
from collections.abc import Callable

LONGEST_S = 86_400.0  # one sleep: a system's `poll` or `select` takes no more than some days


class Waiter:
    """Waits for one socket. `wake` ends every wait, now and later, from any thread."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._woken = False
        self._tasks: set[tuple[asyncio.AbstractEventLoop, asyncio.Future[bool]]] = set()
        self._wake_out, self._wake_in = socket.socketpair()  # one end becomes readable when the other is closed
        self._poll: Callable[[float | None], list[tuple[int, int]]] | None = None
        if hasattr(select, "poll"):  # takes less than `selectors`, which looks each event up in a dictionary
            poll = select.poll()
            poll.register(sock, select.POLLIN)
            poll.register(self._wake_out, select.POLLIN)
            self._poll = poll.poll

    def wait(self, timeout_s: float | None) -> None:
        """Sleep until there is something to read, `wake`, or so long (None: for ever), but a day at most."""
        if timeout_s is not None:
            timeout_s = min(timeout_s, LONGEST_S)
        if self._poll is not None:
            self._poll(None if timeout_s is None else timeout_s * 1e3)
        else:  # Windows
            select.select([self._socket, self._wake_out], [], [], timeout_s)

    async def wait_in_task(self, timeout_s: float | None, wait: Callable[[float | None], None]) -> bool:
        """The same, while other tasks run; False if the time was up or `wake` was called.

        Parameters
        ----------
        wait : waits in a thread, for event loops that watch no sockets: Windows' default one.
        """
        loop = asyncio.get_running_loop()
        came: asyncio.Future[bool] = loop.create_future()
        entry = (loop, came)
        self._tasks.add(entry)  # before all else: who wakes from here on leaves the socket to this task
        try:
            if self._woken:
                return False
            descriptor = self._socket.fileno()
            try:
                loop.add_reader(descriptor, _settle, came, True)
            except NotImplementedError:
                return await self._wait_in_thread(timeout_s, wait)
            try:
                return await asyncio.wait_for(came, timeout_s)
            except TimeoutError:
                return False
            finally:
                loop.remove_reader(descriptor)
        finally:
            self._tasks.discard(entry)  # after all else: from here on the socket may be closed

    async def _wait_in_thread(self, timeout_s: float | None, wait: Callable[[float | None], None]) -> bool:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        while left is None or left > 0:
            await asyncio.to_thread(wait, left)
            if self._woken:
                return False
            if select.select([self._socket], [], [], 0)[0]:
                return True
            left = None if deadline is None else deadline - time.monotonic()
        return False

    @property
    def in_task(self) -> bool:
        """Whether an event loop watches the socket: it must let go before the socket's number is given to another."""
        return bool(self._tasks)

    def wake(self) -> None:
        self._woken = True
        for loop, came in list(self._tasks):
            if not loop.is_closed():
                loop.call_soon_threadsafe(_settle, came, False)
        self._wake_in.close()

    def close(self) -> None:
        """Nobody waits any more."""
        self._wake_in.close()
        self._wake_out.close()


def _settle(came: asyncio.Future[bool], value: bool) -> None:
    if not came.done():
        came.set_result(value)
