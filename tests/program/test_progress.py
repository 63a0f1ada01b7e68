"""The progress bar: on a terminal only, and nothing is left of it."""

import contextlib
import io
from types import SimpleNamespace

import pytest

from async_tnt import progress as module
from async_tnt.progress import Bar, describe, no_progress, progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def screen(text):
    """The characters that a line of a terminal shows after `text`."""
    shown = ""
    for part in text.split("\r"):
        shown = part + shown[len(part) :]
    return shown.rstrip()


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until it is set."""
    now = SimpleNamespace(seconds=0.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now.seconds))
    monkeypatch.setattr(module.shutil, "get_terminal_size", lambda: SimpleNamespace(columns=60))
    return now


def test_the_line_shows_share_rate_and_time_left(clock):
    terminal = Terminal()
    bar = Bar(100, "checking", terminal, done=10)
    bar.update()
    assert terminal.getvalue() == ""  # quick work needs no bar
    clock.seconds = 2.0
    bar.update(9, "still checking")
    assert screen(terminal.getvalue()) == describe("still checking", 20, 100, 10, 2.0)[:59].rstrip()
    clock.seconds = 2.05
    before = terminal.getvalue()
    bar.update()
    assert terminal.getvalue() == before  # at most ten times a second
    assert describe("x", 1, 7201, 1, 1.0).endswith("1.0/s, 2:00:00 left")


@pytest.mark.parametrize("error", [None, ValueError(), KeyboardInterrupt()])
def test_nothing_is_left_on_the_line(clock, error, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with (
        pytest.raises(type(error)) if error else contextlib.nullcontext(),
        progress(3, "a long title that a shorter one replaces") as bar,
    ):
        clock.seconds = 5.0
        bar.update()
        clock.seconds = 6.0
        bar.update(title="short")
        assert screen(terminal.getvalue()).startswith("short  67 %")
        if error:
            raise error
    assert screen(terminal.getvalue()) == "" and terminal.getvalue().endswith("\r")


def test_it_is_silent_elsewhere_and_survives_a_lost_terminal(clock, monkeypatch):
    clock.seconds = -10.0
    for stderr in (io.StringIO(), None):
        monkeypatch.setattr("sys.stderr", stderr)
        for bar in (progress(1, "checking"), no_progress(1, "checking")):
            with bar:
                bar.update()
            assert stderr is None or stderr.getvalue() == ""
    lost = Terminal()
    with Bar(2, "checking", lost) as bar:
        for clock.seconds in (0.0, 1.0):
            bar.update()
            lost.close()
    assert bar.done == 2
