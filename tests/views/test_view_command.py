"""async-tnt view: to files, to a viewer on loopback, from files and from the network."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from listening import free_port
from made import random_events, random_model

from async_tnt import Processor, load_model
from async_tnt.cli import main
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.udp_sender import UdpSender

SAMPLE = sample_recordings()[7]


def test_without_rerun_it_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", "--out", str(tmp_path / "a.rrd")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("async-tnt: views are shown by rerun-sdk: pip install '.[view]' (")
    assert len(err.splitlines()) == 1


def test_an_old_rerun_is_refused(monkeypatch, capsys, tmp_path):
    old = type(sys)("rerun")
    old.__version__, old.__path__ = "0.19.0", []
    monkeypatch.setitem(sys.modules, "rerun", old)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", type(sys)("rerun.blueprint"))
    assert main(["view", "--out", str(tmp_path / "a.rrd")]) == 2
    assert capsys.readouterr().err == (
        "async-tnt: views need rerun-sdk 0.23 or newer, got 0.19.0: pip install '.[view]'\n"
    )


# `rerun` reports how it is used, but not where this is set, and then writes nothing into the user's folders either
SILENT = os.environ | {"CI": "1"}


rrd_files = pytest.importorskip("views.rrd_files", reason="rerun-sdk is not installed (extra `view`)")
Rrd = rrd_files.Rrd
from async_tnt.views import rerun_layout as layout  # noqa: E402


def test_a_recording_becomes_a_file(tmp_path, capsys):
    out = tmp_path / "seven.rrd"
    assert main(["view", str(SAMPLE), "--out", str(out), "--every-us", "50000", "--every-ms", "30"]) == 0
    rrd = Rrd(out)
    events = open_recording(SAMPLE).read()
    processor = Processor(load_model("digits"), every_us=50_000)
    expected = processor.push(events) + processor.finish()
    lines = [text for _, (text,) in rrd.series(layout.DECISIONS, "TextLog:text")]
    assert lines[0] == "7.bin begins"
    assert [line.split()[0] for line in lines[1:]] == [decision.label for decision in expected]
    n_pictures = len(rrd.times(layout.EVENTS))
    captured = capsys.readouterr()
    assert captured.out == f"{out}: {len(events):,} events, {n_pictures} pictures; open it with: rerun {out}\n"
    assert captured.err == ""
    assert [path.name for path in tmp_path.iterdir()] == ["seven.rrd"]
    gaps = np.diff(rrd.times(layout.EVENTS))
    assert gaps.max() == 30_000


def test_several_recordings_in_one_file(tmp_path):
    out = tmp_path / "a.rrd"
    assert main(["view", str(SAMPLE), str(sample_recordings()[3]), "--out", str(out)]) == 0
    rrd = Rrd(out)
    begins = [text for _, (text,) in rrd.series(layout.DECISIONS, "TextLog:text") if "begins" in text]
    assert begins[0] == "7.bin begins" and begins[1].startswith("3.bin begins, its times moved by +")
    assert rrd.name == "7.bin and 1 more"


def test_a_file_may_be_paced(tmp_path):
    started = time.perf_counter()
    assert main(["view", str(SAMPLE), "--out", str(tmp_path / "a.rrd"), "--speed", "2"]) == 0
    assert time.perf_counter() - started > 0.15  # 304 ms of recording


def test_a_rerun_file_is_sound_by_reruns_own_judgement(tmp_path):
    program = Path(sys.executable).parent / "rerun"
    if not program.exists():
        pytest.skip("no program `rerun` beside this Python")
    out = tmp_path / "a.rrd"
    assert main(["view", str(SAMPLE), "--out", str(out)]) == 0
    done = subprocess.run([program, "rrd", "verify", out], capture_output=True, text=True, timeout=60, env=SILENT)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "argv, message",
    [
        (["--out", "a.png"], "--out must end in .rrd, got a.png"),
        (["--out", "nowhere/a.rrd"], "no folder nowhere to write a.rrd to"),
        (["--out", "folder.rrd"], "folder.rrd is a folder, expected a regular file or a new name"),
        (["missing.bin", "--out", "a.rrd"], "missing.bin: No such file or directory"),
        (["large.npz", "--out", "a.rrd"], "large.npz: a sensor of 64x48 pixels, but the model is for 34x34"),
        (["empty.npy", "--out", "a.rrd"], "no event in empty.npy: nothing to show"),
        (["--connect", "127.0.0.1:9876"], "--connect expects rerun+http://HOST:9876/proxy, got 127.0.0.1:9876"),
        (["--connect", "http://127.0.0.1:9876/proxy"], "--connect expects rerun+http://HOST:9876/proxy"),
        (["--connect", "rerun+http://127.0.0.1:x/proxy"], "--connect expects rerun+http://HOST:9876/proxy"),
        (["--connect", "rerun+http://127.0.0.1:1/proxy"], "/proxy: no Rerun viewer listens there; `rerun` starts one"),
        (["udp://127.0.0.1", "--out", "a.rrd"], "expected udp://HOST:PORT"),
        (["--model", "nix", "--out", "a.rrd"], "nix"),
        (["--crop", "--out", "a.rrd"], "--crop belongs to --roi"),
    ],
)
def test_mistakes_are_one_line_and_leave_no_file(argv, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("folder.rrd").mkdir()
    np.savez("large.npz", events=random_events(10, sensor=(64, 48)), sensor=(64, 48))
    np.save("empty.npy", random_events(0))
    before = sorted(path.name for path in tmp_path.iterdir())
    assert main(["view", *argv]) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if "listening" not in line]
    assert len(err) == 1 and message in err[0]
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "argv", [["--speed", "0"], ["--every-ms", "0"], ["--every-ms", "x"], ["--spawn", "--out", "a.rrd"]]
)
def test_wrong_flags(argv):
    with pytest.raises(SystemExit) as stopped:
        main(["view", str(SAMPLE), *argv])
    assert stopped.value.code == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays of Linux")
def test_without_a_display_it_says_so(monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert main(["view", str(SAMPLE)]) == 2
    assert capsys.readouterr().err == (
        "async-tnt: no display to open the Rerun viewer on: give --out FILE.rrd, or --connect to a viewer elsewhere\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_one_line_and_the_old_file_stays(tmp_path, capfd, monkeypatch):
    import rerun

    save = rerun.RecordingStream.save
    monkeypatch.setattr(rerun.RecordingStream, "save", lambda stream, path: save(stream, "/dev/full"))
    out = tmp_path / "a.rrd"
    out.write_bytes(b"before")
    assert main(["view", str(SAMPLE), "--out", str(out)]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("async-tnt:")]
    assert len(lines) == 1 and "No space left on device" in lines[0]
    assert out.read_bytes() == b"before" and [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="for root every folder can be written")
def test_a_folder_without_permission(tmp_path, capsys):
    tmp_path.chmod(0o500)
    assert main(["view", str(SAMPLE), "--out", str(tmp_path / "a.rrd")]) == 2
    assert "cannot be written: no permission" in capsys.readouterr().err


# -- live ----------------------------------------------------------------------------------------------------


def send(port, events, pause_s=0.004):
    with UdpSender(port=port) as sender:
        for packet in np.array_split(events, 40):
            sender.send(packet)
            time.sleep(pause_s)


def send_to_listener(captured, port, events, patience_s=60):
    """Send once the program of this process listens: earlier events are lost.

    Trying to bind its port would tell, too, but now and then take it away from the program.
    """
    deadline = time.monotonic() + patience_s
    while "listening" not in captured.getvalue():
        assert time.monotonic() < deadline, "it never listened"
        time.sleep(0.01)
    send(port, events)


@pytest.mark.parametrize("latest", [[], ["--latest", "1000"]])
def test_events_of_the_network(tmp_path, capsys, latest):
    events = open_recording(SAMPLE).read()
    port, out = free_port(), tmp_path / "a.rrd"
    sender = threading.Thread(target=send_to_listener, args=(sys.stderr, port, events), daemon=True)
    sender.start()
    assert main(["view", f"udp://127.0.0.1:{port}?timeout_s=2", "--out", str(out), *latest]) == 0
    sender.join()
    captured = capsys.readouterr()
    assert f"{len(events):,} events (0 malformed" in captured.err
    assert captured.out.startswith(f"{out}: {len(events):,} events, ")
    processor = Processor(load_model("digits"))
    processor.push(events)
    t, volume = Rrd(out).tensors(layout.TNT_VOLUME)[-1]
    assert t == events["t"].max() + 1 and volume.tobytes() == processor.volume().tobytes()


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to another process")
@pytest.mark.parametrize("live", [True, False])
def test_ctrl_c_completes_the_file_and_exits_with_130(tmp_path, live):
    port, out = free_port(), tmp_path / "a.rrd"
    source = [f"udp://127.0.0.1:{port}"] if live else [str(SAMPLE), "--speed", "0.01"]
    argv = [sys.executable, "-m", "async_tnt.cli", "view", *source, "--out", str(out)]
    process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    try:
        if live:
            while "listening" not in (line := process.stderr.readline()):
                assert line or process.poll() is None
            send(port, open_recording(SAMPLE).read())
            time.sleep(0.3)
        else:
            deadline = time.monotonic() + 60
            while not (tmp_path / "a.rrd.part").exists() and time.monotonic() < deadline:
                time.sleep(0.05)
            time.sleep(4)  # 40 ms of the recording
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130 and "Traceback" not in err
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]
    rrd = Rrd(out)
    assert len(rrd.times(layout.TNT_VOLUME)) >= (5 if live else 2)  # a live source has at most 60 a second


@contextlib.contextmanager
def viewer_that_writes(out):
    """In place of a window it writes down what it is sent. Yields the process, which leads a group, and its URL."""
    program = shutil.which("rerun", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("no program `rerun` beside this Python")
    port = free_port(socket.SOCK_STREAM)
    serving = subprocess.Popen(
        [program, "--bind", "127.0.0.1", "--port", str(port), "--save", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=SILENT,
        start_new_session=True,  # it is a script that starts the program: both are to be stopped
    )
    try:
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline:
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1).close()
                break
            except OSError:
                time.sleep(0.05)
        yield serving, f"rerun+http://127.0.0.1:{port}/proxy"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(serving.pid, signal.SIGKILL)
        serving.wait(30)


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to another process")
def test_a_viewer_on_loopback_gets_it_all(tmp_path, capsys):
    got, written = tmp_path / "got.rrd", tmp_path / "written.rrd"
    with viewer_that_writes(got) as (serving, url):
        assert main(["view", str(SAMPLE), "--connect", url, "--speed", "inf"]) == 0
        time.sleep(0.5)
        os.killpg(serving.pid, signal.SIGINT)
        serving.wait(30)
    assert main(["view", str(SAMPLE), "--out", str(written)]) == 0
    got_tensors, tensors = Rrd(got).tensors(layout.TNT_VOLUME), Rrd(written).tensors(layout.TNT_VOLUME)
    assert len(tensors) > 15
    assert [(t, a.tobytes()) for t, a in got_tensors] == [(t, a.tobytes()) for t, a in tensors]


@pytest.mark.skipif(sys.platform == "win32", reason="no signal stops a process for a while")
@pytest.mark.parametrize("stop", [signal.SIGSTOP, signal.SIGKILL] if sys.platform != "win32" else [])
def test_a_viewer_that_hangs_or_is_closed_ends_the_program(tmp_path, stop):
    code = (
        "import sys; from async_tnt.views import rerun_sinks; rerun_sinks.PATIENCE_S = 0.5; "
        "from async_tnt.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    with viewer_that_writes(tmp_path / "got.rrd") as (serving, url):
        argv = [sys.executable, "-c", code, "view", *[str(SAMPLE)] * 60, "--connect", url]  # 18 s at their own pace
        showing = subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        try:
            deadline = time.monotonic() + 60
            while (not (got := tmp_path / "got.rrd").exists() or got.stat().st_size < 50_000) and (
                time.monotonic() < deadline
            ):
                time.sleep(0.05)
            os.killpg(serving.pid, stop)
            _, err = showing.communicate(timeout=60)
        finally:
            showing.kill()
    lines = [line for line in err.splitlines() if line.startswith("async-tnt:")]
    assert showing.returncode == 2 and len(lines) == 1 and "Traceback" not in err
    assert lines[0].startswith(f"async-tnt: {url}: the Rerun viewer was closed or does not respond: ")


def test_a_spawned_viewer_that_is_not_there(monkeypatch, capsys):
    """The viewer starts and dies, as on a display that refuses it: here none is started at all."""
    import rerun

    from async_tnt.views import rerun_sinks as sinks

    asked = {}
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(rerun.RecordingStream, "spawn", lambda stream, **settings: asked.update(settings))
    monkeypatch.setattr(sinks, "DEFAULT_PORT", free_port(socket.SOCK_STREAM))
    monkeypatch.setattr(sinks, "PATIENCE_S", 0.2)
    assert main(["view", str(SAMPLE)]) == 2
    assert asked == {"connect": False, "memory_limit": "25%"}
    err = capsys.readouterr().err
    assert err.startswith("async-tnt: the Rerun viewer was started but does not listen") and err.count("\n") == 1


def test_a_model_for_another_sensor_can_be_viewed(tmp_path, capsys):
    from async_tnt import TNTConfig

    random_model(TNTConfig(sensor=(64, 48), grid=(32, 24))).save(tmp_path / "m.safetensors")
    np.savez(tmp_path / "large.npz", events=random_events(2000, sensor=(64, 48)), sensor=(64, 48))
    argv = ["view", str(tmp_path / "large.npz"), "--model", str(tmp_path / "m.safetensors")]
    assert main([*argv, "--out", str(tmp_path / "a.rrd")]) == 0
    assert Rrd(tmp_path / "a.rrd").images(layout.EVENTS, "SegmentationImage")[0][1].shape == (48, 64)


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_disk_that_fills_up_on_the_way_ends_it_and_keeps_what_was_written(tmp_path):
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000)); "
        "from async_tnt.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    out = tmp_path / "a.rrd"
    argv = [sys.executable, "-c", code, "view", str(SAMPLE), "--every-ms", "0.5", "--out", str(out)]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=120)
    lines = [line for line in done.stderr.splitlines() if line.startswith("async-tnt:")]
    assert done.returncode == 2 and len(lines) == 1 and "Traceback" not in done.stderr
    assert lines[0].endswith(f"; what was written before is in {out}.part")
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd.part"]
