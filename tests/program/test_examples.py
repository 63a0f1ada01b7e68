"""Examples and the script behind the documentation's numbers run as they are, from anywhere, with warnings as
errors, and what they print is right."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, DOCS = ROOT / "examples", ROOT / "docs"


def lines_of(name, folder, *arguments, scripts=EXAMPLES):
    """What a script prints, run in a folder of its own."""
    command = [sys.executable, "-W", "error", str(scripts / name), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.splitlines()


def shown(line):
    """(time in ms, trigger, label, percent) of a decision's line."""
    return re.match(r" *([\d.]+) ms +(\w+) +(?:\d+ events +)?(\S+) \((\d+)%\)$", line).groups()


def as_shown(decision):
    return f"{decision.time_us / 1000:.1f}", decision.trigger, decision.label, f"{decision.probability * 100:.0f}"


def test_every_example_is_tested_and_says_what_it_shows():
    source = Path(__file__).read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f'lines_of("{path.name}"' in source
        assert path.read_text().startswith('"""')


def test_packet_loop(tmp_path):
    *decisions, last = lines_of("packet_loop.py", tmp_path)
    decisions = [shown(line) for line in decisions]
    recording = open_recording(sample_recordings()[3])
    at_once = async_tnt.Processor(async_tnt.load_model("digits"))
    closed = at_once.push(recording.read()) + at_once.finish()
    assert [d for d in decisions if d[1] != "fire"] == [as_shown(decision) for decision in closed]
    assert {label for _, trigger, label, _ in decisions if trigger != "fire"} == {"3"}
    assert sum(trigger == "fire" for _, trigger, _, _ in decisions) == recording.n_events // 1000 + 1
    received, kept, outside, at_start = (int(number) for number in re.findall(r"\d+", last))
    assert received == kept + outside + at_start == recording.n_events
    assert kept > received / 2


def test_asyncio_source(tmp_path):
    *decisions, last = lines_of("asyncio_source.py", tmp_path)
    events = open_recording(sample_recordings()[8]).read()
    at_once = async_tnt.stream([events], "digits", every_us=30_000)
    assert [shown(line) for line in decisions] == [as_shown(decision) for decision in at_once]
    assert {shown(line)[2] for line in decisions if shown(line)[1] in ("window", "end")} == {"8"}
    # 0.3 s with a heartbeat due every 0.01 s; a loop held up throughout would give one at most
    assert int(re.fullmatch(r"meanwhile the loop did something else (\d+) times", last)[1]) > 4


def test_background_reader(tmp_path):
    n = open_recording(sample_recordings()[8]).n_events
    runs = {}
    for line in lines_of("background_reader.py", tmp_path):
        name, *numbers, label = re.fullmatch(
            r"(all of them|the latest) +(\d+) events = (\d+) handed out \+ (\d+) skipped; waited up to (\d+) ms; "
            r"last decision of (\d+) events: (\w+)",
            line,
        ).groups()
        runs[name] = [int(number) for number in numbers]
        if name == "all of them":
            assert label == "8"
    for received, handed_out, skipped, _, _ in runs.values():
        assert received == handed_out + skipped == n
    assert runs["all of them"][2] == 0 < runs["the latest"][2] < n
    assert runs["the latest"][3] < runs["all of them"][3] / 2  # 20 ms or so, against half a second


def test_own_torch_module(tmp_path):
    removed, raw = lines_of("own_torch_module.py", tmp_path)
    right = [
        int(re.fullmatch(f"{name}: (\\d+) of 20 saccades recognised", line)[1])
        for name, line in (("flow removed", removed), ("no transform", raw))
    ]
    assert right[0] >= 15  # chance is 2
    assert right[1] <= 7


def test_stream_equals_batch(tmp_path):
    events, cells = lines_of("stream_equals_batch.py", tmp_path)
    t = open_recording(sample_recordings()[5]).read()["t"]
    n = np.count_nonzero(t < t[0] + 105_000)
    assert events == f"{n} events, one by one and at once: volumes of shape (9, 34, 34)"
    largest, difference, in_use = re.fullmatch(
        r"largest cell ([\d.]+), largest difference ([\d.e+-]+), (\d+) cells in use", cells
    ).groups()
    assert float(difference) <= 1e-6 * float(largest)
    assert float(largest) > 1 and int(in_use) > 1000


@pytest.mark.parametrize("broken", ["stream = volume.array * 1.001", "stream = np.zeros_like(volume.array)"])
def test_stream_equals_batch_would_notice(tmp_path, broken):
    source = (EXAMPLES / "stream_equals_batch.py").read_text()
    assert source.count("stream = volume.array") == 1
    (tmp_path / "broken.py").write_text(source.replace("stream = volume.array", broken))
    done = subprocess.run([sys.executable, str(tmp_path / "broken.py")], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1 and "AssertionError" in done.stderr


def test_the_numbers_in_the_mathematics_are_those_that_the_script_prints(tmp_path):
    text = (DOCS / "mathematics.md").read_text()
    printed = lines_of("laws.py", tmp_path, scripts=DOCS / "figures")
    rows = [line for line in printed if line.startswith("|")]
    assert [line for line in text.splitlines() if line.startswith("|")] == rows
    assert len(rows) > 30
    border, cancellation, *fallen = [line for line in printed if line[:1].isdigit()]
    assert f"> {border}\n" in text
    words = " ".join(text.split())
    for error in re.findall(r"\d+e-\d+", cancellation):
        assert error in words
    for line in fallen:
        assert re.search(r"\d+ columns and \d+ rows", line)[0] in words
