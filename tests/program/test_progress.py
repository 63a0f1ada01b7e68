"""The progress bar: on a terminal only, and nothing is left of it."""

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
    shown, column = [], 0
    for character in text:
        if character == "\r":
            column = 0
            continue
        shown[column : column + 1] = [character]
        column += 1
    return "".join(shown).rstrip()


@pytest.fixture
def seconds(monkeypatch):
    """A clock that stands still until it is set."""
    now = SimpleNamespace(value=0.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now.value))
    monkeypatch.setattr(module.shutil, "get_terminal_size", lambda: SimpleNamespace(columns=60))
    return now


def test_the_line_shows_share_rate_and_time_left(seconds):
    terminal = Terminal()
    bar = Bar(100, "checking", terminal, done=10)
    bar.update()
    assert terminal.getvalue() == ""  # quick work needs no bar
    seconds.value = 2.0
    bar.update(9, "still checking")
    assert screen(terminal.getvalue()) == describe("still checking", 20, 100, 10, 2.0)[:59].rstrip()
    assert describe("x", 20, 100, 10, 2.0) == "x  20 % [####................] 20/100, 5.0/s, 0:16 left"
    assert describe("x", 1, 7201, 1, 1.0).endswith("1.0/s, 2:00:00 left")
    seconds.value = 2.05
    before = terminal.getvalue()
    bar.update()
    assert terminal.getvalue() == before  # at most ten times a second


@pytest.mark.parametrize("error", [None, ValueError(), KeyboardInterrupt()])
def test_nothing_is_left_on_the_line(seconds, error, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    try:
        with progress(3, "a long title that a shorter one replaces") as bar:
            seconds.value = 5.0
            bar.update()
            seconds.value = 6.0
            bar.update(title="short")
            assert screen(terminal.getvalue()).startswith("short  67 %")
            if error is not None:
                raise error
    except (ValueError, KeyboardInterrupt):
        pass
    assert screen(terminal.getvalue()) == "" and terminal.getvalue().endswith("\r")


def test_it_is_silent_elsewhere_and_survives_a_lost_terminal(seconds, monkeypatch):
    seconds.value = -10.0
    for stderr in (io.StringIO(), None):
        monkeypatch.setattr("sys.stderr", stderr)
        for bar in (progress(1, "checking"), no_progress(1, "checking")):
            with bar:
                bar.update()
            assert stderr is None or stderr.getvalue() == ""
    lost = Terminal()
    with Bar(2, "checking", lost) as bar:
        seconds.value = 0.0
        bar.update()
        lost.close()
        seconds.value = 1.0
        bar.update()
    assert bar.done == 2
