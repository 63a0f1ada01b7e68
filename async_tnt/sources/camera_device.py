"""What the two libraries of cameras are to this package: something that finds devices, and devices that are read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np


@dataclass
class Losses:
    """What a library says it lost; None where it does not say. A device updates its own while it is read."""

    overflows: int | None = None
    """Gaps in the stream of events: the computer did not fetch them in time."""
    dropped: int | None = None
    """Raw packets of the cable that were dropped."""
    most_waiting: int | None = None
    """Raw packets that waited in the library's ring, at the worst moment."""


class Device(Protocol):
    """An opened camera of one of the libraries. `Camera` calls one method at a time."""

    sensor: tuple[int, int]
    pause_s: float
    """How long to wait after `read` had nothing; 0 where `read` itself waits."""
    time_field: str
    """Of its packets' arrays."""
    losses: Losses
    handle: Any
    """The library's own object."""

    def read(self) -> np.ndarray | None:
        """The next packet, a structured array that is nobody else's; None if there is none now.

        Returns after 0.2 s at most. Raises whatever the library does where the camera is gone, see `is_failure`.
        """

    def close(self) -> None:
        """Let go of the camera."""


@dataclass(frozen=True)
class FoundCamera:
    """A camera that a library sees."""

    model: str
    """As the library calls it."""
    kinds: tuple[str, ...]
    """KIND of `camera:KIND` that mean it."""
    serial: str | None
    open: Callable[[], Device]
    problem: str | None = None
    """Why it may not open, where the library says so already."""

    def __str__(self) -> str:
        return self.model if not self.serial else f"{self.model} {self.serial}"


class Driver(Protocol):
    """A library of cameras."""

    name: str
    """With its version."""

    def find(self) -> Sequence[FoundCamera]:
        """The cameras that are connected. Raises whatever the library does where it cannot look."""


def is_failure(error: BaseException) -> bool:
    """Whether it says that a library failed, rather than that the program is to stop.

    Libraries in Rust panic with an exception that `except Exception` does not catch.
    """
    return isinstance(error, Exception) or type(error).__name__ == "PanicException"


def first_line(error: BaseException) -> str:
    """What an error of a library says, in one line.

    dv-processing's messages hold a place in its source, the sentence, and a stack of C++.

    Examples
    --------
    >>> first_line(RuntimeError("/a/b.hpp(88): dv::open()\\nRuntimeError: no such device\\nStacktrace:\\n 0# x"))
    'no such device'
    >>> first_line(ValueError())
    'ValueError'
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    for line in lines[1:]:
        kind, colon, sentence = line.partition(": ")
        if colon and kind.endswith(("Error", "Exception")):
            return sentence
    return lines[0] if lines else type(error).__name__
