"""run --live: the small view in the terminal."""

import io
import sys
import time

import pytest
from made import random_events, random_model

from async_tnt import Counts, Processor, TNTConfig
from async_tnt.cli import main
from async_tnt.cli.live_view import MOST_CLASSES, LiveView
from async_tnt.sources.files.recording import sample_recordings

CONFIG = TNTConfig(window_us=1000)


def drawn(classes, push, width=160):
    rich_console = pytest.importorskip("rich.console", reason="rich is not installed (extra `view`)")
    console = rich_console.Console(file=io.StringIO(), force_terminal=True, width=width, color_system=None)
    with LiveView(classes, "a recording", console) as view:
        push(view)
    last = console.file.getvalue().split("a recording")[-1]
    return [line.rstrip() for line in last.splitlines() if line.strip("\x1b[?25hK \n")]


def test_it_shows_the_newest_decision():
    model = random_model(CONFIG, classes=3)
    processor = Processor(model, every_events=20)
    decisions = processor.push(random_events(100, duration_us=900))

    def push(view):
        view.show(decisions[:2], 50.0, Counts(received=40, kept=30))
        view.show(decisions[2:], 70.0, processor.counts)
        view.show([], 1.0, processor.counts)

    lines = drawn(model.classes, push)
    for name, p, line in zip(model.classes, decisions[-1].probabilities, lines, strict=False):
        assert line.startswith(name) and line.endswith(f"{p:.2f}")
    assert lines[3] == f"{decisions[-1].label} at 0.001 s, every_events; 60 us to a decision"
    assert lines[4].endswith("decisions/s")
    counts = processor.counts
    assert counts.moved_off == counts.received - counts.kept > 0
    assert lines[5] == f"100 events, {counts.moved_off} moved off the grid, 0 dropped"


def test_a_queue_is_shown():
    class Queue:
        delay_us, backlog, n_skipped = 2_500, 1_000, 7

    decision = Processor(random_model(CONFIG, classes=2)).fire()
    lines = drawn(["a", "b"], lambda view: view.show([decision], 9.0, Counts(received=9, dropped_late=2), Queue()))
    assert lines[-2:] == ["9 events, 0 moved off the grid, 9 dropped", "2.5 ms old, 1,000 events waiting, 7 skipped"]


def test_before_the_first_decision():
    lines = drawn(["a", "b"], lambda view: view.show([], 1.0, Counts(received=1234)))
    assert lines[:1] == ["no decision yet, 1,234 events"]


def test_of_many_classes_the_likeliest_are_shown():
    model = random_model(CONFIG, classes=40)
    decision = Processor(model).fire()
    lines = drawn(model.classes, lambda view: view.show([decision], 9.0, Counts()))
    shown = [line.split("  ")[0].split(" █")[0].strip() for line in lines[:MOST_CLASSES]]
    best = sorted(sorted(range(40), key=lambda k: -decision.probabilities[k])[:MOST_CLASSES])
    assert [" ".join(name.split()[:2]) for name in shown] == [model.classes[k] for k in best]


def test_without_rich_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rich.live", None)
    with pytest.raises(ImportError, match=r"run --live draws with rich: pip install '\.\[view\]'"):
        LiveView(["a"], "b")


def test_run_draws_a_recording_at_its_pace(capsys):
    pytest.importorskip("rich", reason="rich is not installed (extra `view`)")
    started = time.perf_counter()
    assert main(["run", "--live", "--speed", "2", str(sample_recordings()[3])]) == 0
    assert time.perf_counter() - started > 0.15  # 304 ms of recording
    out = capsys.readouterr().out
    assert "3.bin" in out and "us to a decision" in out and "█" in out


@pytest.mark.parametrize(
    "options, message",
    [
        (["--live", "--json"], "exclude each other"),
        (["--speed", "2"], "--speed belongs to --live"),
    ],
)
def test_options_that_do_not_go_together(capsys, options, message):
    assert main(["run", *options]) == 2
    assert message in capsys.readouterr().err


def test_wrong_speeds(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["run", "--live", "--speed", "0"])
    assert stop.value.code == 2 and "argument --speed: must be a positive number, got '0'" in capsys.readouterr().err
