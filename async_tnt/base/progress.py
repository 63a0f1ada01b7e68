"""The progress bar of every command: one line on stderr if that is a terminal, else nothing."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from typing import TextIO

FIRST_S = 1.0
"""Seconds until the bar appears."""
EVERY_S = 0.1
"""Seconds between two updates of the bar."""


class Bar(contextlib.AbstractContextManager["Bar"]):
    """A line that shows how much of `total` is done.

    It is a context manager, and clears its line at the end, even after an error.

    Parameters
    ----------
    total : units of work; 0 if unknown.
    title : name of the work, such as "checking".
    file : a terminal. None shows nothing, so that `Bar` itself may stand in place of `progress`.
    done : units of work that were done before. They do not count towards the rate.
    """

    def __init__(
        self, total: int, title: str, file: TextIO | None = None, *, done: int = 0
    ) -> None:
        self.total = total
        self.title = title
        self.done = done
        self._file = file
        self._done_before = done
        self._started_s = time.monotonic()
        self._next_draw_s = self._started_s + FIRST_S
        self._width = 0

    def update(self, n: int = 1, title: str | None = None) -> None:
        """Count `n` more units as done; `title`, if given, replaces the title."""
        self.done += n
        if title is not None:
            self.title = title
        if self._file is None:
            return
        now_s = time.monotonic()
        if now_s < self._next_draw_s:
            return

        self._next_draw_s = now_s + EVERY_S
        n_since = self.done - self._done_before
        text = describe(self.title, self.done, self.total, n_since, now_s - self._started_s)
        text = text[: shutil.get_terminal_size().columns - 1]
        self._write("\r" + text.ljust(self._width))
        self._width = len(text)

    def clear(self) -> None:
        """Clear the line, for example before something else is printed.

        The next update draws it again.
        """
        if self._width:
            self._write("\r" + " " * self._width + "\r")
            self._width = 0

    def _write(self, text: str) -> None:
        assert self._file is not None  # for mypy: without a file nothing is drawn or cleared
        with contextlib.suppress(OSError, ValueError):  # the work goes on if the terminal is gone
            self._file.write(text)
            self._file.flush()

    def __exit__(self, *error: object) -> None:
        self.clear()


def progress(total: int, title: str, *, done: int = 0) -> Bar:
    """A bar on stderr if that is a terminal, else a bar that shows nothing.

    It is used as in `with progress(n, "checking") as bar: ... bar.update()`.
    """
    is_terminal = sys.stderr is not None and not sys.stderr.closed and sys.stderr.isatty()
    return Bar(total, title, sys.stderr if is_terminal else None, done=done)


def describe(title: str, done: int, total: int, n_units: int, seconds: float) -> str:
    """The line of a bar whose last `n_units` units took `seconds`.

    Examples
    --------
    >>> describe("checking", 2_000, 8_000, 1_500, 3.0)
    'checking  25 % [#####...............] 2,000/8,000, 500/s, 0:12 left'
    >>> describe("epoch 1/3", 0, 30, 0, 2.0)
    'epoch 1/3   0 % [....................] 0/30'
    >>> describe("reading", 4, 0, 4, 16.0)
    'reading 4, 4.0 s each'
    """
    text = f"{title} {done:,}"
    if total > 0:
        share = min(done / total, 1.0)
        text = f"{title} {100 * share:3.0f} % [{'#' * int(20 * share):.<20}] {done:,}/{total:,}"
    if n_units <= 0 or seconds <= 0:
        return text

    rate = n_units / seconds
    if rate >= 10:
        text += f", {rate:,.0f}/s"
    elif rate >= 1:
        text += f", {rate:.1f}/s"
    else:
        text += f", {seconds / n_units:.1f} s each"

    if total > 0:
        minutes, seconds_left = divmod(round(max(total - done, 0) / rate), 60)
        hours, minutes = divmod(minutes, 60)
        if hours:
            text += f", {hours}:{minutes:02}:{seconds_left:02} left"
        else:
            text += f", {minutes}:{seconds_left:02} left"
    return text
