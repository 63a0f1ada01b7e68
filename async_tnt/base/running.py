"""A guard that refuses a call on an object while another call on it is running."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

# Compiled code runs without the GIL and does not check bounds. So two calls that change the same
# memory would corrupt it.

Method = TypeVar("Method", bound=Callable[..., Any])


class Running:
    """A mark that says whether a call is running on an object. Errors call the object `name`.

    A copy of the mark says that no call is running, and so does a mark loaded from a pickle.

    With the GIL, test and assignment are one step: CPython switches threads and handles signals
    only at calls, at the start of functions and where loops jump back. So the mark is as safe as a
    lock, and Ctrl-C does not leave it set. Without the GIL, two calls that begin within some
    nanoseconds of each other can both pass.
    """

    __slots__ = ("name", "now")

    def __init__(self, name: str) -> None:
        self.name = name
        self.now = False

    def __reduce__(self) -> Any:
        return Running, (self.name,)

    def begin(self) -> None:
        """Mark the object as in use.

        The caller continues with `try`, and sets `now = False` in its `finally`.

        Raises
        ------
        RuntimeError : another call is running.
        """
        if self.now:
            raise self.overlap()
        self.now = True

    def overlap(self) -> RuntimeError:
        """The error of a call that begins while another call is running."""
        return RuntimeError(
            f"a {self.name} was called while another call on it is running, in another thread or "
            f"further up in this one; use one {self.name} per thread, or hold one lock around "
            "every call"
        )


def one_at_a_time(method: Method) -> Method:
    """A method that refuses a call while another decorated method runs on the same object.

    The object has a `Running` as its attribute `_running`. The decorator costs 0.2 us: methods that
    take about a microsecond write these lines themselves.
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
