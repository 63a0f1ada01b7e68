"""The progress bar: on a terminal only, and nothing is left of it."""

import errno
import io
import os
from types import SimpleNamespace

import pytest

from async_tnt.base import progress as module
from async_tnt.base.progress import Bar, describe, progress


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


def test_nothing_is_left_on_the_line_after_an_error(clock, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with (
        pytest.raises(KeyboardInterrupt),
        progress(3, "a long title that a shorter one replaces") as bar,
    ):
        for clock.seconds, title in ((5.0, None), (6.0, "short")):
            bar.update(title=title)
        assert screen(terminal.getvalue()).startswith("short  67 %")
        raise KeyboardInterrupt
    assert screen(terminal.getvalue()) == "" and terminal.getvalue().endswith("\r")


def test_it_is_silent_where_there_is_no_terminal(clock, monkeypatch):
    with open(os.devnull, "w") as closed:
        pass
    for stderr in (io.StringIO(), None, closed):
        monkeypatch.setattr("sys.stderr", stderr)
        with progress(2, "checking") as bar:
            clock.seconds += 10
            bar.update()
        assert stderr in (None, closed) or stderr.getvalue() == ""


def closed_by_this_program(terminal):
    terminal.close()


def hung_up(terminal):
    def fail():
        raise OSError(errno.EIO, "Input/output error")

    terminal.flush = fail


@pytest.mark.parametrize("lose", [closed_by_this_program, hung_up])
def test_the_work_goes_on_without_a_lost_terminal(lose, clock):
    terminal = Terminal()
    with Bar(2, "checking", terminal) as bar:
        for clock.seconds in (10.0, 20.0):
            bar.update()
            lose(terminal)
    assert bar.done == 2


def test_it_appears_after_a_second_and_changes_ten_times_a_second(clock):
    terminal = Terminal()
    bar = Bar(9, "checking", terminal)
    drawn = []
    for clock.seconds in (0.99, 1.0, 1.09, 1.11, 1.2, 1.22):
        bar.update()
        drawn.append(terminal.getvalue().count("\r"))
    assert drawn == [0, 1, 1, 2, 2, 3]
    assert screen(terminal.getvalue()).startswith("checking  67 %")
    bar.clear()
    cleared = terminal.getvalue()
    bar.clear()
    assert terminal.getvalue() == cleared and screen(cleared) == ""


def test_what_was_done_before_counts_for_the_share_and_not_for_the_rate(clock):
    terminal = Terminal()
    bar = Bar(100, "on", terminal, done=60)
    clock.seconds = 5.0
    bar.update(10)
    assert screen(terminal.getvalue()) == "on  70 % [##############......] 70/100, 2.0/s, 0:15 left"


def test_the_line_is_one_shorter_than_the_terminal_is_wide(clock):
    terminal = Terminal()
    bar = Bar(100, "x" * 50, terminal)
    clock.seconds = 5.0
    bar.update()
    assert screen(terminal.getvalue()) == "x" * 50 + "   1 % [."


@pytest.mark.parametrize(
    ("done", "total", "seconds", "expected"),
    [
        (1, 61, 61.0, "2 % [....................] 1/61, 61.0 s each, 1:01:00 left"),
        (1, 60, 61.0, "2 % [....................] 1/60, 61.0 s each, 59:59 left"),
        (5, 4, 1.0, "100 % [####################] 5/4, 5.0/s, 0:00 left"),
        (10, 20, 1.0, "50 % [##########..........] 10/20, 10/s, 0:01 left"),
        (99, 198, 10.0, "50 % [##########..........] 99/198, 9.9/s, 0:10 left"),
        (19, 20, 20.0, "95 % [###################.] 19/20, 1.1 s each, 0:01 left"),
    ],
)
def test_a_line_by_hand(done, total, seconds, expected):
    assert describe("x", done, total, done, seconds).removeprefix("x").lstrip() == expected
