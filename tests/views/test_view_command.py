"""async-tnt view: to files, to a viewer on loopback, from files and from the network."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from full_disk import full_after
from listening import free_port, sent
from made import random_events
from torch import nn
from views.raw_models import raw_model
from waiting import until

from async_tnt import Model, Processor, TNTConfig, load_model
from async_tnt.cli.view import _milliseconds
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.volume.events import as_events

SAMPLE = sample_recordings()[7]
EVENTS = open_recording(SAMPLE).read()
# `rerun` reports how it is used, but not where this is set, and then writes nothing into the user's
# folders either
SILENT = os.environ | {"CI": "1"}


def test_without_rerun_the_error_says_what_to_install(monkeypatch, program, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    code, _, err = program("view", SAMPLE, "--out", tmp_path / "a.rrd")
    assert code == 2 and err.count("\n") == 1
    assert err.startswith("async-tnt: views need rerun-sdk: pip install 'async_tnt[view]' (")


rrd_files = pytest.importorskip(
    "views.rrd_files", reason="rerun-sdk is not installed (extra `view`)"
)
Rrd = rrd_files.Rrd
from async_tnt.views import rerun_decisions as decisions_log  # noqa: E402
from async_tnt.views import rerun_log as log  # noqa: E402


def own_lines(err):
    return [line for line in err.splitlines() if line.startswith("async-tnt:")]


def test_a_recording_becomes_a_file(tmp_path, program, monkeypatch):
    out = tmp_path / "a.rrd"
    speeds = []
    monkeypatch.setattr(
        "async_tnt.cli.view.replay", lambda packets, speed: speeds.append(speed) or packets
    )
    words = "--every-us", 50000, "--every-ms", 30, "--speed", 2
    code, printed, err = program("view", SAMPLE, "--out", out, *words)
    rrd = Rrd(out)
    n_pictures = len(rrd.times(log.EVENTS))
    assert (code, err, set(speeds)) == (0, "", {2.0})
    counts = f"{len(EVENTS):,} events, {n_pictures} pictures"
    assert printed == f"{out}: {counts}; open it with: rerun {out}\n"
    assert rrd.name == "7.bin" and np.diff(rrd.times(log.EVENTS))[:8].max() == 30_000
    processor = Processor(load_model("digits"), every_us=50_000)
    expected = [decision.label for decision in processor.push(EVENTS) + processor.finish()]
    lines = [text for _, (text,) in rrd.series(decisions_log.DECISIONS, "TextLog:text")]
    assert [line.split()[0] for line in lines] == expected
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]
    rerun = rerun_program()
    if rerun is not None:
        subprocess.run(
            [rerun, "rrd", "verify", out], capture_output=True, timeout=600, env=SILENT, check=True
        )


def test_windows_begin_at_the_start_that_is_given(tmp_path, program):
    """They begin at the recording's first event, or where events before it are left out."""
    first_us = int(EVENTS["t"][0])
    starts = {}
    for start_us in (None, first_us + 100_000):
        words = () if start_us is None else ("--start-us", start_us)
        assert program("view", SAMPLE, "--out", tmp_path / f"{start_us}.rrd", *words)[0] == 0
        processor = Processor(load_model("digits"), start_us=start_us)
        expected = [decision.time_us for decision in processor.push(EVENTS) + processor.finish()]
        starts[start_us] = [
            time
            for time, _ in Rrd(tmp_path / f"{start_us}.rrd").series(
                decisions_log.DECISIONS, "TextLog:text"
            )
        ]
        assert starts[start_us] == expected
    assert starts[None] != starts[first_us + 100_000]


@pytest.mark.parametrize(
    "words, message",
    [
        (["samples", "--out", "a.png"], "a.png: its name must end in .rrd"),
        (["missing.bin", "--out", "a.rrd"], "missing.bin: No such file or directory"),
        (
            ["large.npz", "--out", "a.rrd"],
            "large.npz: a sensor of 64x48 pixels, but the model is for 34x34",
        ),
        (["empty.npy", "--out", "a.rrd"], "empty.npy: no events, nothing to show"),
        (
            ["samples", "--connect", "127.0.0.1:9876"],
            "a viewer's URL is rerun+http://HOST:9876/proxy, got 127.0.0.1:9876",
        ),
        (
            ["samples", "--connect", "rerun+http://127.0.0.1:1/proxy"],
            "/proxy: no Rerun viewer listens there; `rerun` starts one",
        ),
    ],
)
def test_mistakes_are_one_line_and_leave_no_file(words, message, tmp_path, monkeypatch, program):
    monkeypatch.chdir(tmp_path)
    np.savez("large.npz", events=random_events(10, sensor=(64, 48)), sensor=(64, 48))
    np.save("empty.npy", random_events(0))
    code, _, err = program("view", *words)
    (line,) = [line for line in err.splitlines() if "listening" not in line]
    assert code == 2 and message in line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty.npy", "large.npz"]


@pytest.mark.parametrize(
    ("words", "speed"),
    [
        ((), np.inf),
        (("--speed", "0.5"), 0.5),
        (("--connect", "rerun+http://127.0.0.1:9876/proxy"), 1.0),
    ],
)
def test_a_file_is_written_at_once_and_a_viewer_plays(words, speed, monkeypatch, program, tmp_path):
    """Unless a speed is given. Here nothing is sent."""
    from async_tnt.views import rerun_view

    class Played(Exception):
        pass

    def played(packets, speed):
        raise Played(speed)

    monkeypatch.setattr("async_tnt.cli.view.replay", played)
    monkeypatch.setattr(rerun_view, "_connect", lambda stream, url: None)
    where = () if "--connect" in words else ("--out", tmp_path / "a.rrd")
    with pytest.raises(Played, match=f"^{speed}$"):
        program("view", SAMPLE, *where, *words)


def test_a_live_stream_has_its_own_pace(program, tmp_path):
    code, _, err = program(
        "view", "udp://127.0.0.1:0?timeout_s=0.1", "--speed", 2, "--out", tmp_path / "a.rrd"
    )
    assert code == 2 and err.startswith("async-tnt: --speed belongs to recordings; a camera or ")


@pytest.mark.parametrize(("text", "us"), [("30", 30_000), ("0.0016", 2), ("0.001", 1)])
def test_milliseconds_are_rounded_to_microseconds(text, us):
    assert _milliseconds(text) == us


def test_pictures_are_at_least_a_microsecond_apart(capsys, program):
    with pytest.raises(SystemExit, match=r"^2$"):
        program("view", SAMPLE, "--every-ms", "0.0009")
    rule = "argument --every-ms: must be a number from 0.001 to 1e9, got '0.0009'"
    assert rule in capsys.readouterr().err


def test_events_that_are_left_out_are_told(program, tmp_path):
    """Those outside of a region."""
    n_outside = int((EVENTS["x"] >= 20).sum())
    words = "--roi", "0,0,20,34", "--out", tmp_path / "a.rrd"
    code, _, err = program("view", SAMPLE, *words)
    (line,) = own_lines(err)
    assert code == 0 and line.startswith("async-tnt: left out: ")
    assert f"{n_outside:,} " in line


def test_late_events_are_told(program, tmp_path):
    """As those before the start that is given."""
    start_us = int(EVENTS["t"][0]) + 100_000
    n_late = int((EVENTS["t"] < start_us).sum())
    out = tmp_path / "a.rrd"
    code, _, err = program("view", SAMPLE, "--start-us", start_us, "--out", out)
    (line,) = own_lines(err)
    assert code == 0 and f"{n_late} of {len(EVENTS)} events" in line and "--start-us" in line


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_disk_that_fills_up_ends_it_and_keeps_what_was_written(tmp_path, program):
    out = tmp_path / "a.rrd"
    out.write_bytes(b"before")
    with full_after(60_000):
        code, _, err = program("view", SAMPLE, "--every-ms", "0.5", "--out", out)
    assert code == 2 and own_lines(err)[-1].endswith(f"; what was written before is in {out}.part")
    assert out.read_bytes() == b"before" and sorted(os.listdir(tmp_path)) == ["a.rrd", "a.rrd.part"]


# -- raw outputs -----------------------------------------------------------------------------------


def test_a_model_of_raw_outputs_is_shown(tmp_path, program):
    events = random_events(2_000, sensor=(8, 6), duration_us=100_000)
    np.savez(tmp_path / "a.npz", events=events, sensor=(8, 6))
    raw_model().save(tmp_path / "net.safetensors")
    out = tmp_path / "a.rrd"
    words = "--model", tmp_path / "net.safetensors", "--every-us", 10_000, "--out", out
    code, printed, err = program("view", tmp_path / "a.npz", *words)
    assert (code, err) == (0, "")
    assert printed == f"{out}: 2,000 events, 6 pictures; open it with: rerun {out}\n"
    rrd = Rrd(out)
    assert len(rrd.images("outputs/flow")) == 6
    times = [t for t, _ in rrd.series("outputs/total", "Scalars:scalars")]
    processor = Processor(raw_model(), every_us=10_000)
    expected = [output.time_us for output in processor.push(events) + processor.finish()]
    assert len(expected) == 10 and set(expected) < set(times)
    # raw outputs have no confidence
    code, _, err = program("view", tmp_path / "a.npz", *words, "--confidence", 0.9)
    rule = "--confidence is for models with classes; this one has raw outputs"
    assert (code, err) == (2, f"async-tnt: {rule}\n")


def test_few_outputs_lie_in_memory_together(tmp_path, program, monkeypatch):
    """However many events a packet has: they are pushed in pieces. Decisions are small."""
    from async_tnt.cli.view import _push_all
    from async_tnt.views.rerun_view import RerunView

    sizes = []
    push = RerunView.push

    def counted(view, events):
        sizes.append(len(as_events(events, (34, 34))))
        return push(view, events)

    monkeypatch.setattr(RerunView, "push", counted)
    monkeypatch.setattr("async_tnt.cli.view.replay", lambda packets, speed: [EVENTS])
    raw = Model.from_torch(nn.Conv2d(9, 2, 1), load_model("digits").config)
    raw.save(tmp_path / "net.safetensors")
    words = "--every-events", 100, "--out", tmp_path / "a.rrd"
    assert program("view", SAMPLE, "--model", tmp_path / "net.safetensors", *words)[0] == 0
    assert sum(sizes) == len(EVENTS) and max(sizes) == 100
    sizes.clear()
    assert program("view", SAMPLE, *words)[0] == 0
    assert sizes == [len(EVENTS)]
    sizes.clear()
    with RerunView(raw, out=tmp_path / "b.rrd", every_events=100) as view:
        _push_all([EVENTS], view)
    assert max(sizes) == 100


# -- networks of other programs --------------------------------------------------------------------

NAMES = ["left", "right", "nothing *at* all"]
FOREIGN_CONFIG = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=2, window_us=50_000)


@pytest.fixture
def view_onnx(tmp_path, program):
    """A function that views random events with an ONNX network, and reads the file back."""
    pytest.importorskip("onnx", reason="onnx is not installed (extra `onnx`)")
    pytest.importorskip("onnxruntime", reason="onnxruntime is not installed (extra `onnx`)")
    events = random_events(300, sensor=(5, 6))
    np.savez(tmp_path / "a.npz", events=events, sensor=(5, 6))

    def view(content, **described):
        described = {"config": FOREIGN_CONFIG.to_dict(), **described}
        (tmp_path / "net.json").write_text(json.dumps(described))
        (tmp_path / "net.onnx").write_bytes(content)
        words = "--model", tmp_path / "net.onnx", "--config", tmp_path / "net.json"
        code, _, err = program("view", tmp_path / "a.npz", *words, "--out", tmp_path / "a.rrd")
        assert (code, err) == (0, "")
        return events, Rrd(tmp_path / "a.rrd")

    return view


@pytest.mark.parametrize("has_compiled_form", [True, False])
def test_an_onnx_network_has_the_names_of_its_json_file(view_onnx, has_compiled_form):
    from networks.foreign import WEIGHTS, linear, network, node

    def classifier(volume):
        return linear(volume) if has_compiled_form else np.sin(linear(volume))

    content = network()
    if not has_compiled_form:
        nodes = [
            node("Flatten", ["image"], ["flat"]),
            node("Gemm", ["flat", "w", "b"], ["linear"]),
            node("Sin", ["linear"], ["scores"]),
        ]
        weights = {name: w.astype(np.float32) for name, w in WEIGHTS.items()}
        content = network(nodes, weights=weights)
    events, rrd = view_onnx(content, classes=NAMES)
    rows = [row for t, row in rrd.rows[decisions_log.PROBABILITIES] if t is None]
    assert [row["SeriesLines:names"] for row in rows] == [NAMES]
    processor = Processor(FOREIGN_CONFIG, classifier=classifier, classes=NAMES)
    expected = [decision.label for decision in processor.push(events) + processor.finish()]
    lines = [text for _, (text,) in rrd.series(decisions_log.DECISIONS, "TextLog:text")]
    assert [line.split("  ")[0] for line in lines] == expected
    assert len(expected) == 3
    texts = [text for _, (text,) in rrd.series(decisions_log.CLASS, "TextDocument:text")]
    assert all("| left |" in text and r"| nothing \*at\* all |" in text for text in texts)


def test_an_onnx_network_without_names_has_raw_outputs(view_onnx):
    from networks.foreign import linear, network

    events, rrd = view_onnx(network())
    assert rrd.views["outputs/scores"] == "TimeSeries" and decisions_log.CLASS not in rrd.views
    scores = []
    processor = Processor(FOREIGN_CONFIG, classifier=lambda v: scores.append(linear(v)) or [0.0])
    answers = processor.push(events) + processor.finish()
    found = dict(rrd.series("outputs/scores", "Scalars:scalars"))
    assert len(answers) == 3
    for answer, expected in zip(answers, scores, strict=True):
        assert found[answer.time_us] == pytest.approx(expected.tolist(), abs=1e-4)


# -- live ------------------------------------------------------------------------------------------


def test_events_of_the_network(tmp_path, program):
    out = tmp_path / "a.rrd"
    with sent(EVENTS) as port:
        code, printed, err = program(
            "view", f"udp://127.0.0.1:{port}?timeout_s=3", "--out", out, "--keep-up", 60_000
        )
    assert code == 0 and f"{len(EVENTS):,} events (" in err
    assert printed.startswith(f"{out}: {len(EVENTS):,} events, ")
    processor = Processor(load_model("digits"))
    processor.push(EVENTS)
    t, sheet = Rrd(out).images(log.TNT)[-1]
    assert t == EVENTS["t"].max() + 1
    np.testing.assert_array_equal(sheet, log.bin_sheet(processor.volume()))


@pytest.mark.parametrize(("live", "after"), [(True, 2000), (False, 2000), (True, 0)])
def test_ctrl_c_completes_the_file_and_exits_with_130(tmp_path, live, after, monkeypatch, program):
    from async_tnt.views.rerun_view import RerunView

    push = RerunView.push
    seen = []

    def interrupted(view, events):
        seen.append(events)
        if sum(map(len, seen)) > after:
            raise KeyboardInterrupt
        return push(view, events)

    monkeypatch.setattr(RerunView, "push", interrupted)
    out = tmp_path / "a.rrd"
    with sent(EVENTS) if live else contextlib.nullcontext() as port:
        source = f"udp://127.0.0.1:{port}" if live else SAMPLE
        code, said, err = program("view", source, "--out", out)
    assert code == 130 and len(own_lines(err)) == (2 if live else 1)
    assert said.startswith(f"{out}: ") == (live and after > 0)
    if after:
        assert os.listdir(tmp_path) == ["a.rrd"]
        assert len(Rrd(out).times(log.TNT)) >= 2
    else:
        assert os.listdir(tmp_path) == []


def rerun_program():
    return shutil.which("rerun", path=str(Path(sys.executable).parent))


def is_open(port):
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", port)).close()
        return True


@contextlib.contextmanager
def viewer_that_writes(out):
    """A viewer that has no window, and writes what it receives.

    Yields the process, which leads a group, and its URL.
    """
    rerun = rerun_program()
    if rerun is None:
        pytest.skip("no program `rerun` beside this Python")
    port = free_port(socket.SOCK_STREAM)
    serving = subprocess.Popen(
        [rerun, "--bind", "127.0.0.1", "--port", str(port), "--save", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=SILENT,
        start_new_session=True,  # it is a script that starts the program: both are to be stopped
    )
    try:
        until(lambda: is_open(port))
        yield serving, f"rerun+http://127.0.0.1:{port}/proxy"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(serving.pid, signal.SIGKILL)
        serving.wait(30)


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
def test_a_viewer_on_loopback_gets_it_all(tmp_path, program):
    def volumes(path):
        with contextlib.suppress(Exception):  # it is being written
            return [(t, a.tobytes()) for t, a in Rrd(path).images(log.TNT)]

    got = tmp_path / "got.rrd"
    written = tmp_path / "written.rrd"
    assert program("view", SAMPLE, "--out", written)[0] == 0
    expected = volumes(written)
    with viewer_that_writes(got) as (_, url):
        assert program("view", SAMPLE, "--connect", url, "--speed", "inf")[0] == 0
        until(lambda: volumes(got) == expected)
    assert len(expected) > 15


@pytest.mark.skipif(sys.platform == "win32", reason="no process groups")
def test_a_viewer_that_is_closed_ends_the_program(tmp_path):
    got = tmp_path / "got.rrd"
    with viewer_that_writes(got) as (serving, url):
        words = [str(SAMPLE), "--connect", url, "--speed", "0.01"]  # 30 s
        command = [sys.executable, "-m", "async_tnt", "view", *words]
        showing = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            until(
                lambda: (
                    (got.exists() and got.stat().st_size >= 50_000) or showing.poll() is not None
                )
            )
            os.killpg(serving.pid, signal.SIGKILL)
            _, err = showing.communicate(timeout=600)
        finally:
            showing.kill()
    (line,) = own_lines(err)
    assert showing.returncode == 2 and "Traceback" not in err
    assert line.startswith(f"async-tnt: {url}: the Rerun viewer was closed or does not respond: ")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays of Linux")
def test_without_a_display_no_viewer_is_started(monkeypatch, program):
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    code, _, err = program("view", SAMPLE)
    assert code == 2 and err.count("\n") == 1
    assert err.startswith("async-tnt: no display to open the Rerun viewer on")


@pytest.mark.parametrize(
    ("platform", "display"),
    [("linux", "DISPLAY"), ("linux", "WAYLAND_DISPLAY"), ("darwin", None), ("win32", None)],
)
def test_where_there_is_a_display_a_viewer_is_started(platform, display, monkeypatch, program):
    """Here one that cannot be. Linux alone names its displays."""
    monkeypatch.setattr("async_tnt.views.rerun_view.sys", SimpleNamespace(platform=platform))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv(display, ":7")

    def spawn(stream, **_):
        raise RuntimeError("no\nviewer")

    monkeypatch.setattr("rerun.RecordingStream.spawn", spawn)
    code, _, err = program("view", SAMPLE)
    assert code == 2
    assert own_lines(err) == ["async-tnt: the Rerun viewer cannot be started: no viewer"]
