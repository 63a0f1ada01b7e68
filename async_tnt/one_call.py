"""Calls that must not overlap: where one begins while another is running on the same object, it is refused.

Compiled code runs without the GIL and does not check bounds: two calls that change the same memory would corrupt it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

Method = TypeVar("Method", bound=Callable[..., Any])


class Running:
    """Whether a call is running on an object, which errors call `name`; on a copy or a pickled one, none is."""

    __slots__ = ("name", "now")

    def __init__(self, name: str) -> None:
        self.name = name
        self.now = False

    def __reduce__(self) -> Any:
        return Running, (self.name,)

    def overlap(self) -> RuntimeError:
        """The error of another call."""
        return RuntimeError(
            f"a {self.name} was called while another call on it is running, in another thread or further up in this "
            f"one; use one {self.name} per thread, or hold one lock around every call"
        )


def one_at_a_time(method: Method) -> Method:
    """Refuse a call of this method while one of this kind is running on the same object, by its `_running`.

    Methods that take about a microsecond write the same out; the wrapper takes 0.2 us more.

    With the GIL, test and assignment are one step: CPython switches threads and handles signals only at calls, at the
    start of functions and where loops jump back. A lock would be no safer, as Ctrl-C may come between acquiring it and
    `try`, and costs 100 ns instead of 20. Without the GIL, two calls that begin within some nanoseconds of each other
    can both pass.
    """

    @functools.wraps(method)
    def alone(self: Any, *args: Any, **kwargs: Any) -> Any:
        running = self._running
        if running.now:
            raise running.overlap()
        running.now = True
        try:
            return method(self, *args, **kwargs)
        finally:
            running.now = False

    return cast(Method, alone)
