"""The examples run from any folder and print what is right."""

import ast
import asyncio
import re
import runpy
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from made import random_events

import async_tnt
from async_tnt.sources import UdpSource, open_recording, sample_recordings
from async_tnt.sources.files.labelled_recordings import find_recordings

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def lines_of(tmp_path, monkeypatch, capsys):
    """What an example prints."""

    def run(name, *words):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.argv", [name, *words])
        capsys.readouterr()
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def as_shown(decision):
    return f"{decision.label} ({decision.probability * 100:.0f}%)"


def test_packet_loop(lines_of):
    *lines, last = lines_of("packet_loop.py")
    events = open_recording(sample_recordings()[3]).read()
    at_once = async_tnt.Processor(async_tnt.load_model("digits"))
    closed = [as_shown(decision) for decision in at_once.push(events) + at_once.finish()]
    assert [line.split("  ")[-1].strip() for line in lines if " fire " not in line] == closed
    assert sum(" fire " in line for line in lines) == len(events) // 1000 + 1
    received, kept, outside, at_start = map(int, re.findall(r"\d+", last))
    assert received == kept + outside + at_start == len(events) < 2 * kept


def test_asyncio_source(lines_of):
    *lines, last = lines_of("asyncio_source.py")
    at_once = async_tnt.stream(
        [open_recording(sample_recordings()[8]).read()], "digits", every_us=30_000
    )
    for line, decision in zip(lines, at_once, strict=True):
        assert line.endswith(as_shown(decision))
    assert int(re.fullmatch(r"meanwhile the loop ran other work (\d+) times", last)[1]) >= 1


RUN = re.compile(
    r"asyncio\.run\((.*?)\)(?:  # in a notebook, where a loop is running already: (.*))?$",
    re.MULTILINE,
)


def test_every_asyncio_run_has_its_form_for_notebooks():
    """A notebook has a running loop, in which `asyncio.run` fails."""
    root = EXAMPLES.parent
    pages = [
        root / "README.md",
        *root.glob("docs/**/*.md"),
        *EXAMPLES.glob("*.py"),
        *root.glob("docs/**/*.ipynb"),
    ]
    found = [form for page in pages for form in RUN.findall(page.read_text(encoding="utf-8"))]
    assert len(found) >= 2 and all(notebook == f"await {call}" for call, notebook in found)


def test_asyncio_source_runs_in_a_notebook_in_that_form(capsys):
    path = EXAMPLES / "asyncio_source.py"
    cell = RUN.sub(r"\2", path.read_text(encoding="utf-8"))
    code = compile(cell, str(path), "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)

    async def run_cell():
        await eval(code, {"__name__": "__main__"})

    asyncio.run(run_cell())
    assert "meanwhile the loop ran other work" in capsys.readouterr().out


def test_background_reader(lines_of):
    n = open_recording(sample_recordings()[8]).n_events
    first, second = lines_of("background_reader.py")
    every = [int(k) for k in re.findall(r"\d+", first)]
    newest = [int(k) for k in re.findall(r"\d+", second)]
    assert every[:3] == [n, n, 0] and every[-1] == 8
    assert newest[0] == newest[1] + newest[2] == n > newest[2] > 0


def test_own_torch_module(lines_of):
    lines = lines_of("own_torch_module.py")
    flow_removed, raw = [int(re.search(r": (\d+) of 20", line)[1]) for line in lines]
    assert flow_removed >= 15 and raw <= 7  # chance is 2


def test_several_digits(lines_of):
    """Each is found and gets its class; at most two have another one before."""
    first, *lines = lines_of("several_digits.py")
    there = re.findall(r"(\d) at \((\d+), (\d+)\)", first)
    assert len(there) == 6 and len(lines) <= 8
    found = {}
    for line in lines:
        words = re.search(r"object (\d+) is a (\d), at \((\d+), (\d+)\)", line)
        number, digit, x, y = words.groups()
        found[number] = (digit, int(x), int(y))
    for digit, x, y in there:
        places = [(u, v) for other, u, v in found.values() if other == digit]
        assert any(max(abs(u - int(x)), abs(v - int(y))) < 8 for u, v in places), digit


def test_stream_equals_batch(lines_of):
    events, cells = lines_of("stream_equals_batch.py")
    t = open_recording(sample_recordings()[5]).read()["t"]
    n = np.count_nonzero(t < t[0] + 105_000)
    assert events.startswith(f"{n} events, one by one and at once")
    largest, difference, n_cells = re.findall(r"\d[\d.e+-]*", cells)
    assert float(difference) <= 1e-6 * float(largest) and float(largest) > 1 and int(n_cells) > 1000


def test_spiking_network(lines_of):
    """Each neuron has one spike for ten events of its half, or a few more."""
    *lines, last = lines_of("spiking_network.py")
    events = open_recording(sample_recordings()[3]).read()
    n_left = int((events["x"] < 17).sum())
    answer = next(line for line in reversed(lines) if " us  spikes " in line)
    left, right, label = answer.split("spikes")[1].split()
    assert (
        0 <= n_left / 9.5 - int(left) <= 1 and 0 <= (len(events) - n_left) / 9.5 - int(right) <= 1
    )
    assert label == ("left" if n_left > len(events) / 2 else "right")
    assert f"{len(events):,} events in the last window" in lines
    assert re.fullmatch(r"layer \S+: 0\.10\d spikes and 2\.0 additions an event", last)


def test_spikes_equal_sinabs(lines_of, tmp_path):
    pytest.importorskip("sinabs", reason="the other side of the comparison")
    nir = pytest.importorskip("nir", reason="needs the extra `nir`")
    rng = np.random.default_rng(0)
    graph = nir.NIRGraph.from_list(
        nir.Input({"input": np.array([2, 34, 34])}),
        nir.Conv2d((34, 34), rng.normal(size=(4, 2, 3, 3)), 2, 1, 1, 1, np.zeros(4)),
        nir.IF(r=np.ones((4, 17, 17)), v_threshold=np.ones((4, 17, 17))),
        nir.Flatten({"input": np.array([4, 17, 17])}, start_dim=0, end_dim=-1),
        nir.Linear(rng.normal(size=(3, 4 * 17 * 17))),
        nir.IF(r=np.ones(3), v_threshold=np.ones(3)),
        nir.Output({"output": np.array([3])}),
    )
    nir.write(tmp_path / "net.nir", graph)
    (line,) = lines_of("spikes_equal_sinabs.py", "net.nir", str(sample_recordings()[3]))
    assert line.startswith("1,000 events, the same spikes after each of them; by layer ")


def test_flow_per_event(lines_of, tmp_path, monkeypatch):
    """With --quick it is trained hardly at all: all ways are compared, and the picture is drawn."""
    pytest.importorskip("torch", reason="the network needs torch")
    from examples.optical_flow import picture, sequences

    monkeypatch.setattr(picture, "DURATION_US", 60_000)
    monkeypatch.setattr(sequences, "DURATION_US", 60_000)
    words = ("--quick", "--out", "flow.safetensors", "--picture", "flow.gif")
    lines = lines_of("flow_per_event.py", *words)
    assert lines[0] == "model in flow.safetensors"
    model = async_tnt.load_model(tmp_path / "flow.safetensors")
    assert lines[1] == repr(model) and model.output_shapes == {"output": (2, 64, 64)}
    assert lines[2].startswith("2 test sequences (seed 0), ")
    errors = [re.fullmatch(r"  (.+?) +([\d.]+) ± +[\d.]+ px/s", line) for line in lines[3:7]]
    assert [error[1] for error in errors] == [
        "network",
        "zero flow",
        "plane fit",
        "plane fits, pooled",
    ]
    assert float(errors[3][2]) < float(errors[1][2])
    assert (tmp_path / "flow.gif").stat().st_size > 10_000
    again = lines_of("flow_per_event.py", "--quick", "--model", "flow.safetensors")
    assert again[0] == lines[1] and again[1:6] == lines[2:7]


def test_send_recordings(lines_of, tmp_path):
    """They arrive whole and in order, each from the start of a window on."""
    first = random_events(400, duration_us=3000)
    second = random_events(300, duration_us=2000, start_us=50)
    for name, events in (("a.npy", first), ("b.npy", second)):
        np.save(tmp_path / name, events)
    with UdpSource(port=0, timeout_s=0.15) as source:
        (line,) = lines_of("send_recordings.py", f"udp://127.0.0.1:{source.port}", "a.npy", "b.npy")
        received = np.concatenate(list(source))
    assert line == f"sent 700 events to 127.0.0.1:{source.port}"
    first["t"] -= first["t"].min()
    second["t"] += 105_000 - second["t"].min()
    np.testing.assert_array_equal(received, np.concatenate([first, second]))


def test_hots_characters(lines_of, tmp_path):
    io = pytest.importorskip("scipy.io", reason="MATLAB files need SciPy")
    made = [random_events(9 + k, seed=k, duration_us=100_000, sensor=(32, 32)) for k in range(40)]
    cells = np.empty((1, len(made)), object)
    for k, e in enumerate(made):
        cells[0, k] = {
            "x": e["x"].astype(np.int16)[None] + 1,
            "y": e["y"].astype(np.int16)[None] + 1,
            "p": 2 * e["p"].astype(np.int16)[None] - 1,
            "ts": e["t"][None].astype(np.int32),
        }
    io.savemat(tmp_path / "made.mat", {"ROI": cells})
    assert lines_of("hots_characters.py", "made.mat", "out") == [
        "40 recordings of 36 characters in out"
    ]
    train = find_recordings(tmp_path / "out", "Train")
    test = find_recordings(tmp_path / "out", "Test")
    assert sorted(train) == sorted("0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    assert sorted(test) == ["F", "G", "X", "Y"]
    for one in chain(*train.values(), *test.values()):
        recording = open_recording(one.path)
        assert recording.sensor == (32, 32)
        np.testing.assert_array_equal(recording.read(), made[int(one.path.stem)])


def test_asl_dvs(lines_of, tmp_path):
    io = pytest.importorskip("scipy.io", reason="MATLAB files need SciPy")
    made = random_events(50, duration_us=100_000, sensor=(240, 180))
    names = {"t": "ts", "x": "x", "y": "y", "p": "pol"}
    columns = {name: made[field].astype(float)[:, None] for field, name in names.items()}
    (tmp_path / "asl" / "a").mkdir(parents=True)
    io.savemat(tmp_path / "asl" / "a" / "a_0001.mat", columns)
    assert lines_of("asl_dvs.py", "asl", "out") == ["1 recordings in out"]
    recording = open_recording(tmp_path / "out" / "a" / "a_0001.npz")
    assert recording.sensor == (240, 180)
    np.testing.assert_array_equal(recording.read(), made)
