"""The examples run from any folder and print what is right."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import async_tnt
from async_tnt.sources import open_recording, sample_recordings

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def lines_of(tmp_path, monkeypatch, capsys):
    """What an example prints."""

    def run(name):
        monkeypatch.chdir(tmp_path)
        capsys.readouterr()
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def shown(line):
    """(time in ms, trigger, label, percent) of a decision's line."""
    return re.match(r" *([\d.]+) ms +(\w+) +(?:\d+ events +)?(\S+) \((\d+)%\)$", line).groups()


def as_shown(decision):
    return f"{decision.time_us / 1000:.1f}", decision.trigger, decision.label, f"{decision.probability * 100:.0f}"


def test_every_example_is_tested():
    assert all(f'lines_of("{path.name}")' in Path(__file__).read_text() for path in EXAMPLES.glob("*.py"))


def test_packet_loop(lines_of):
    *lines, last = lines_of("packet_loop.py")
    decisions = [shown(line) for line in lines]
    events = open_recording(sample_recordings()[3]).read()
    at_once = async_tnt.Processor(async_tnt.load_model("digits"))
    closed = at_once.push(events) + at_once.finish()
    assert [d for d in decisions if d[1] != "fire"] == [as_shown(decision) for decision in closed]
    assert {decision.label for decision in closed} == {"3"}
    assert sum(trigger == "fire" for _, trigger, _, _ in decisions) == len(events) // 1000 + 1
    received, kept, outside, at_start = (int(number) for number in re.findall(r"\d+", last))
    assert received == kept + outside + at_start == len(events) < 2 * kept


def test_asyncio_source(lines_of):
    *decisions, last = lines_of("asyncio_source.py")
    at_once = list(async_tnt.stream([open_recording(sample_recordings()[8]).read()], "digits", every_us=30_000))
    assert [shown(line) for line in decisions] == [as_shown(decision) for decision in at_once]
    assert {decision.label for decision in at_once if decision.trigger in ("window", "end")} == {"8"}
    assert int(re.fullmatch(r"meanwhile the loop ran other work (\d+) times", last)[1]) >= 1


def test_background_reader(lines_of):
    n = open_recording(sample_recordings()[8]).n_events
    number = r"\D+ (\d+)"
    line = re.compile(rf"(every packet|the newest) +(\d+) events{number} handed out{number} skipped; .*: (\w+)")
    every, newest = (line.fullmatch(text).groups() for text in lines_of("background_reader.py"))
    assert every == ("every packet", str(n), str(n), "0", "8")
    assert newest[0] == "the newest" and int(newest[2]) + int(newest[3]) == int(newest[1]) == n > int(newest[3]) > 0


def test_own_torch_module(lines_of):
    flow_removed, raw = (int(re.search(r": (\d+) of 20", line)[1]) for line in lines_of("own_torch_module.py"))
    assert flow_removed >= 15 and raw <= 7  # chance is 2


def test_stream_equals_batch(lines_of):
    events, cells = lines_of("stream_equals_batch.py")
    t = open_recording(sample_recordings()[5]).read()["t"]
    n = np.count_nonzero(t < t[0] + 105_000)
    assert events == f"{n} events, one by one and at once: volumes of shape (9, 34, 34)"
    largest, difference, n_cells = re.findall(r"\d[\d.e+-]*", cells)
    assert float(difference) <= 1e-6 * float(largest) and float(largest) > 1 and int(n_cells) > 1000
