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

# Ctrl-C; SIGTERM of systemd, docker and timeout; SIGHUP of a terminal that closes. Windows has no
# SIGHUP.
ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
REPEATED_S = 1.0
"""Seconds within which a second signal is the same request to end."""
UNSAFE_MODULES = ("importlib._bootstrap", "llvmlite.", "numba.")
"""Beginnings of the names of modules whose C code does not expect an exception."""


class Signals:
    """What a command does at the signals that end it, and which of them came.

    Attributes
    ----------
    received : the numbers of the signals, in the order in which they came.
    before : number -> the handler that was there before the command began.
    hook : `sys.unraisablehook` as it was before the command began.
    """

    def __init__(self) -> None:
        self.received: list[int] = []
        self.before: dict[int, Any] = {}
        self.hook = sys.unraisablehook
        self._accepted_s = 0.0

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt at any of the signals, so that a command can clean up.

        A signal that follows at once does nothing: a terminal that is closed sends two, and the
        second would end the cleaning up. A later one is obeyed, in case that takes forever.
        """
        now_s = time.monotonic()
        if self.received and now_s < self._accepted_s + REPEATED_S:
            return
        self._accepted_s = now_s
        self.received.append(number)

        if _is_unsafe(frame):
            self._call_before(number, frame)
        raise KeyboardInterrupt

    def report(self, dropped: sys.UnraisableHookArgs) -> None:
        """Handle an exception that Python drops; a `sys.unraisablehook`.

        Python drops what is raised in a `__del__` or in a callback of C code. If that is our
        KeyboardInterrupt, the process ends here.
        """
        if self.received and isinstance(dropped.exc_value, KeyboardInterrupt):
            self._call_before(self.received[-1], None)
        else:
            self.hook(dropped)

    def _call_before(self, number: int, frame: FrameType | None) -> None:
        """Call the handler of before, if there was one. The program's own ends the process."""
        handler = self.before.get(number)
        if callable(handler):
            handler(number, frame)


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[dict[int, Any]]:
    """Call `handler` for the signals in `ENDING` within the block; yields the previous handlers.

    Signals that are ignored stay ignored: Ctrl-C in a background job, SIGHUP under nohup. Outside
    of the main thread nothing changes, as Python can set handlers only there.
    """
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            known = signal.getsignal(number)
            # None: C code has set the handler, and Python could not set it again
            if known not in (signal.SIG_IGN, None):
                before[number] = known

    for number in before:
        signal.signal(number, handler)
    try:
        yield before
    finally:
        for number, known in before.items():
            signal.signal(number, known)


def _is_unsafe(frame: FrameType | None) -> bool:
    """Whether an import or a compilation is running in this frame or in one of its callers.

    Their C code prints a KeyboardInterrupt and continues, turns it into another error, or crashes:
    LLVM calls back for each kernel that it loads from the cache.
    """
    while frame is not None:
        module = str(frame.f_globals.get("__name__"))
        if module.startswith(UNSAFE_MODULES):
            return True
        frame = frame.f_back
    return False
