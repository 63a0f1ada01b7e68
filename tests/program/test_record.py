"""async-tnt record: streams from the network into class folders, to train on."""

import io
import json
import os
import signal

import numpy as np
import pytest
from full_disk import full_after
from listening import free_port, sent
from made import random_events
from sources.test_cameras import PlayedDevice, made_events

from async_tnt.cli import record
from async_tnt.sources.cameras import Camera
from async_tnt.sources.files.prophesee import dat_header, dat_records
from async_tnt.sources.files.recording import open_recording

EVENTS = random_events(5_000, seed=3, duration_us=2_000_000, sensor=(64, 48))
EVENTS["t"] += 7_000_000_000  # a camera that has been on for two hours


def test_a_stream_is_recorded_whole_until_it_ends(program, tmp_path):
    with sent(EVENTS) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=1"
        code, out, err = program("record", url, "--sensor", "64x48", "--class", "wave", "--out", tmp_path / "gestures")
    (path,) = (tmp_path / "gestures" / "wave").glob("*.dat")
    assert code == 0 and out.startswith(f"{path}: 5,000 events, ") and f"recording wave from {url} into {path}" in err
    recording = open_recording(path)
    expected = EVENTS.copy()
    expected["t"] -= EVENTS["t"][0]
    np.testing.assert_array_equal(recording.read(), expected)
    assert recording.sensor == (64, 48) and recording.format == "DAT"
    about = json.loads(path.with_suffix(".json").read_text())
    assert (about["class"], about["sensor"], about["events"]) == ("wave", [64, 48], 5_000)
    assert about["first_us"] == EVENTS["t"][0] and "\x1b" not in err


@pytest.fixture
def when_recorded(monkeypatch):
    """Call a function once so many events are recorded."""

    def arrange(n_events, function):
        seen = []

        def show(picture, events):
            seen.append(len(events))
            if sum(seen) >= n_events:
                function()

        monkeypatch.setattr(record._Picture, "show", show)

    return arrange


def test_it_ends_after_the_seconds_and_never_replaces_anything(program, tmp_path, monkeypatch, when_recorded):
    """The timer closes the source, here as soon as events have come."""
    timers = []

    class Timer:
        def __init__(self, seconds, function):
            timers.append((seconds, function))

        def start(self):
            pass

        def cancel(self):
            pass

    monkeypatch.setattr(record.threading, "Timer", Timer)
    monkeypatch.setattr(record.time, "strftime", lambda form: "20261126_120000")
    when_recorded(1, lambda: timers[-1][1]())
    (tmp_path / "wave").mkdir()
    for name in ("20261126_120000.dat.part", "20261126_120000_2.json"):  # other programs are writing
        (tmp_path / "wave" / name).touch()
    for n in range(2):
        with sent(EVENTS) as port:
            words = ["record", f"udp://127.0.0.1:{port}", "--sensor", "64x48", "--class", "wave", "--seconds", 1.5]
            assert program(*words, "--out", tmp_path)[0] == 0 and timers[n][0] == 1.5
    assert [path.name for path in sorted((tmp_path / "wave").glob("*.dat"))] == [
        "20261126_120000_3.dat",
        "20261126_120000_4.dat",
    ]


def test_an_interrupted_recording_is_complete_up_to_then(program, tmp_path, when_recorded):
    when_recorded(5_000, lambda: os.kill(os.getpid(), signal.SIGINT))
    with sent(EVENTS) as port:
        words = ["record", f"udp://127.0.0.1:{port}", "--sensor", "64x48", "--class", "a"]
        code, out, _ = program(*words, "--out", tmp_path)
    (path,) = (tmp_path / "a").glob("*.dat")
    assert code == 130 and "5,000 events" in out and open_recording(path).n_events == 5_000


def test_of_an_unplugged_camera_what_came_before_is_kept_with_its_settings(program, tmp_path, monkeypatch):
    device = PlayedDevice(made_events(5, 9, 30), OSError("no such device"), sensor=(34, 34))
    monkeypatch.setattr(record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played"))
    code, out, err = program("record", "camera", "--class", "wave", "--out", tmp_path)
    (path,) = (tmp_path / "wave").glob("*.dat")
    assert code == 2 and "3 events" in out and "the camera is gone after 3 events" in err.splitlines()[-1]
    assert open_recording(path).read()["t"].tolist() == [0, 4, 25]
    about = json.loads(path.with_suffix(".json").read_text())
    assert (about["source"], about["settings"]) == ("EVK4 0042 by played", device.settings) and device.n_closed


@pytest.mark.parametrize("n, room", [(100, 50_003), (5_000, 50_003), (100, 79_003)])
def test_on_a_full_disk_all_whole_events_are_kept(n, room, program, tmp_path, monkeypatch):
    """Of packets that wait in the file's buffer, of one that is written in part, and after Ctrl-C."""
    packets = [made_events(*range(k * n, (k + 1) * n)) for k in range(10_000 // n)]
    device = PlayedDevice(*packets, KeyboardInterrupt(), sensor=(6_000, 34))
    monkeypatch.setattr(record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played"))
    with full_after(room):
        code, out, _ = program("record", "camera", "--class", "wave", "--out", tmp_path)
    (path,) = (tmp_path / "wave").glob("*.dat")
    n_whole = (room - len(dat_header((6_000, 34)))) // 8
    assert code == 2 and f"{n_whole:,} events" in out
    assert open_recording(path, strict=True).read()["t"].tolist() == list(range(n_whole))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.bin", "--class", "x"], "SOURCE must be a camera or udp://HOST:PORT, got a.bin"),
        (["udp://127.0.0.1:PORT", "--class", "../x"], "--class must be the name of a folder, got '../x'"),
        (["udp://127.0.0.1:PORT", "--class", "x"], "does not state its sensor; give --sensor WxH"),
        (["camera", "--class", "x", "--sensor", "4x4"], "--sensor belongs to a network stream"),
        (["udp://127.0.0.1:PORT", "--class", "x", "--seconds", "0"], "--seconds must be a positive number, got 0.0"),
        (["udp://127.0.0.1:PORT", "--class", "x", "--sensor", "20000x9"], "DAT files hold 16384 pixels a side"),
        (["udp://127.0.0.1:PORT?timeout_s=.1", "--class", "x", "--sensor", "9x9", "--seconds", ".3"], "no event came"),
    ],
)
def test_what_cannot_be_recorded_is_refused_in_one_line_and_leaves_nothing(words, message, program, tmp_path):
    words = [word.replace("PORT", str(free_port())) for word in words]
    code, out, err = program("record", *words, "--out", tmp_path / "new")
    assert code == 2 and out == "" and message in err.splitlines()[-1]
    assert not [path for path in tmp_path.rglob("*") if path.name != "new"]


def test_records_of_every_pixel_and_of_long_recordings_are_read_back(tmp_path):
    """Times wrap after 71 minutes."""
    events = random_events(1_000, seed=1, sensor=(16_384, 16_384))
    events["t"] = np.linspace(0, 3 * (1 << 32), len(events)).astype(np.int64)
    events["x"][:2], events["y"][:2] = (0, 16_383), (16_383, 0)
    (tmp_path / "a.dat").write_bytes(dat_header((16_384, 16_384)) + dat_records(events, 0))
    np.testing.assert_array_equal(open_recording(tmp_path / "a.dat").read(), events)


def test_a_terminal_shows_the_last_events_and_their_rate(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(record, "EVERY_S", 0.0)
    picture = record._Picture((64, 40), "wave")
    events = random_events(600, sensor=(64, 40))
    events["x"], events["y"] = np.arange(600) % 32, 10
    picture.show(events)
    picture.show(events)
    lines = terminal.getvalue().split("\n")
    lit = [line for line in lines if "▀" in line or "▄" in line or "█" in line]
    assert len(lit) == 2 and all(line.rstrip().endswith(("▀", "▄", "█")) for line in lit)
    assert sum("events a second" in line for line in lines) == 2 and terminal.getvalue().count("\x1b[") == 1
