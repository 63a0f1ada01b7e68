"""Calls that must not overlap: where one begins while another is running on the same object, it is refused.

Compiled code runs without the GIL and does not check bounds: two calls that change the same memory would corrupt it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

Method = TypeVar("Method", bound=Callable[..., Any])


class Running:
    """Whether a call is running on an object, which errors call `name`; on a copy or a pickled one, none is.

    With the GIL, test and assignment are one step: CPython switches threads and handles signals only at calls, at the
    start of functions and where loops jump back. So this is as safe as a lock, and not left set by Ctrl-C. Without the
    GIL, two calls that begin within some nanoseconds of each other can both pass.
    """

    __slots__ = ("name", "now")

    def __init__(self, name: str) -> None:
        self.name = name
        self.now = False

    def __reduce__(self) -> Any:
        return Running, (self.name,)

    def begin(self) -> None:
        """Refuse to begin if a call is running. To be followed by `try`, and at its end by `now = False`."""
        if self.now:
            raise self.overlap()
        self.now = True

    def overlap(self) -> RuntimeError:
        """The error of the second call."""
        return RuntimeError(
            f"a {self.name} was called while another call on it is running, in another thread or further up in this "
            f"one; use one {self.name} per thread, or hold one lock around every call"
        )


def one_at_a_time(method: Method) -> Method:
    """Refuse a call of this method while one of this kind is running on the same object, by its `_running`.

    Takes 0.2 us; methods that take about a microsecond themselves write it out.
    """

    @functools.wraps(method)
    def alone(self: Any, *args: Any, **kwargs: Any) -> Any:
        running = self._running
        running.begin()
        try:
            return method(self, *args, **kwargs)
        finally:
            running.now = False

    return cast(Method, alone)
