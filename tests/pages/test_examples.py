"""The examples run from any folder with warnings as errors, and print what is right."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import async_tnt
from async_tnt.sources.files.recording import open_recording, sample_recordings

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"


def lines_of(name, folder):
    """What an example prints when it runs in `folder`."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.splitlines()


def shown(line):
    """(time in ms, trigger, label, percent) of a decision's line."""
    return re.match(r" *([\d.]+) ms +(\w+) +(?:\d+ events +)?(\S+) \((\d+)%\)$", line).groups()


def as_shown(decision):
    return f"{decision.time_us / 1000:.1f}", decision.trigger, decision.label, f"{decision.probability * 100:.0f}"


def test_every_example_is_tested_and_has_a_docstring():
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
    assert int(re.fullmatch(r"meanwhile the loop ran other work (\d+) times", last)[1]) >= 1


def test_background_reader(tmp_path):
    n = open_recording(sample_recordings()[8]).n_events
    runs = {}
    for line in lines_of("background_reader.py", tmp_path):
        name, *numbers, label = re.fullmatch(
            r"(every packet|the newest) +(\d+) events = (\d+) handed out \+ (\d+) skipped; waited up to \d+ ms; "
            r"last decision of (\d+) events: (\w+)",
            line,
        ).groups()
        runs[name] = [int(number) for number in numbers]
        if name == "every packet":
            assert label == "8"
    for received, handed_out, skipped, _ in runs.values():
        assert received == handed_out + skipped == n
    assert runs["every packet"][2] == 0 < runs["the newest"][2] < n


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


def test_stream_equals_batch_notices_a_difference(tmp_path):
    source = (EXAMPLES / "stream_equals_batch.py").read_text()
    assert source.count("stream = volume.array") == 1
    (tmp_path / "broken.py").write_text(source.replace("stream = volume.array", "stream = volume.array * 1.001"))
    done = subprocess.run([sys.executable, str(tmp_path / "broken.py")], capture_output=True, text=True, timeout=600)
    assert done.returncode == 1 and "AssertionError" in done.stderr
