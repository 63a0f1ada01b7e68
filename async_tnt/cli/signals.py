"""Signals that end a command, so that it can clean up first."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Ctrl-C sends SIGINT. systemd, docker and `timeout` send SIGTERM. A terminal that closes sends
# SIGHUP, which Windows does not have.
ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
REPEATED_S = 1.0
"""Seconds within which a second signal counts as the same request to end."""
UNSAFE_MODULES = ("importlib._bootstrap", "llvmlite.", "numba.")
"""Beginnings of module names. The C code of these modules cannot handle a KeyboardInterrupt."""


class Signals:
    """Handles the signals that end a command, and notes which of them came.

    Attributes
    ----------
    numbers : the numbers of the signals that came, in this order.
    previous_handlers : number of a signal -> its handler before the command began.
    previous_hook : `sys.unraisablehook` as it was before the command began.
    """

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self.previous_handlers: dict[int, Any] = {}
        self.previous_hook = sys.unraisablehook
        self._accepted_s = 0.0

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, so that the command can clean up. This is a signal handler.

        A second signal within `REPEATED_S` is ignored, because a terminal that closes sends two,
        and the second one would interrupt the cleaning up. A later signal raises again, in case the
        cleaning up never ends.
        """
        now_s = time.monotonic()
        if self.numbers and now_s < self._accepted_s + REPEATED_S:
            return
        self._accepted_s = now_s
        self.numbers.append(number)

        if _is_unsafe(frame):
            # the program's own previous handler, `cli._end`, ends the process here
            self._call_previous_handler(number, frame)
        raise KeyboardInterrupt

    def handle_dropped(self, dropped: sys.UnraisableHookArgs) -> None:
        """Handle an exception that Python drops. This is a `sys.unraisablehook`.

        Python drops an exception that is raised in a `__del__` or in a callback of C code. If it is
        our KeyboardInterrupt, the process ends here.
        """
        if self.numbers and isinstance(dropped.exc_value, KeyboardInterrupt):
            self._call_previous_handler(self.numbers[-1], None)
        else:
            self.previous_hook(dropped)

    def _call_previous_handler(self, number: int, frame: FrameType | None) -> None:
        """Call the previous handler of a signal, if there was one.

        The program's own previous handler, `cli._end`, ends the process.
        """
        handler = self.previous_handlers.get(number)
        if callable(handler):
            handler(number, frame)


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    """Call `handler` for the signals in `ENDING` within the block. Yields the previous handlers.

    A signal that is ignored stays ignored, such as Ctrl-C in a background job or SIGHUP under
    nohup. Python sets handlers in the main thread only, so nothing changes in other threads.
    """
    previous_handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            previous = signal.getsignal(number)
            # None: C code has set the handler, and Python could not restore it
            if previous not in (signal.SIG_IGN, None):
                previous_handlers[number] = previous

    for number in previous_handlers:
        signal.signal(number, handler)
    try:
        yield previous_handlers
    finally:
        for number, previous in previous_handlers.items():
            signal.signal(number, previous)


def _is_unsafe(frame: FrameType | None) -> bool:
    """Whether an import or a compilation is running in this frame or in one of its callers.

    The C code of an import or a compilation cannot handle a KeyboardInterrupt. It prints the
    exception and continues, turns it into another error, or crashes. LLVM also calls Python back
    for each kernel that it loads from the cache.
    """
    while frame is not None:
        module = str(frame.f_globals.get("__name__"))
        if module.startswith(UNSAFE_MODULES):
            return True
        frame = frame.f_back
    return False
