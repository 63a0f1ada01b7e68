"""The progress bar: on a terminal only, and nothing is left of it."""

import io
from types import SimpleNamespace

import pytest

from async_tnt.base import progress as module
from async_tnt.base.progress import Bar, progress


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


def test_it_is_silent_elsewhere_and_survives_a_lost_terminal(clock, monkeypatch):
    clock.seconds = -10.0
    for stderr in (io.StringIO(), None):
        monkeypatch.setattr("sys.stderr", stderr)
        with progress(1, "checking") as bar:
            bar.update()
        assert stderr is None or stderr.getvalue() == ""
    lost = Terminal()
    with Bar(2, "checking", lost) as bar:
        for clock.seconds in (0.0, 1.0):
            bar.update()
            lost.close()
    assert bar.done == 2
