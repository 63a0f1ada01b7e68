"""async-tnt record: streams from the network into class folders, to train on."""

import contextlib
import errno
import io
import itertools
import json
import os
import queue
import signal
import sys
import tempfile
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from full_disk import full_after
from listening import free_port, sent
from made import events_of, random_events
from sources.test_cameras import PlayedDevice, made_events

from async_tnt import __version__
from async_tnt.cli import main, record
from async_tnt.sources.files import dat_writer
from async_tnt.sources.files.dat_writer import DatWriter
from async_tnt.sources.files.prophesee import dat_header, dat_records
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.live import cameras
from async_tnt.sources.live.cameras import Camera

EVENTS = random_events(5_000, seed=3, duration_us=2_000_000, sensor=(64, 48))
EVENTS["t"] += 7_000_000_000  # a camera that has been on for two hours


def test_a_stream_is_recorded_whole_until_it_ends(program, tmp_path):
    with sent(EVENTS) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=3"
        code, out, err = program(
            "record", url, "--sensor", "64x48", "--class", "wave", "--out", tmp_path / "gestures"
        )
    (path,) = (tmp_path / "gestures" / "wave").glob("*.dat")
    assert code == 0 and out.startswith(f"{path}: 5,000 events, ")
    assert f"recording wave from udp://127.0.0.1:{port} into {path.parent}" in err
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


def test_it_ends_after_the_seconds_and_never_replaces_anything(
    program, tmp_path, monkeypatch, when_recorded
):
    """The time is over as soon as events have come."""
    waits = []
    is_over = threading.Event()

    class Asked:
        def get(self, timeout):
            waits.append(timeout)
            is_over.wait()
            raise queue.Empty

        def put(self, number):
            is_over.set()

    monkeypatch.setattr(record, "SimpleQueue", Asked)
    monkeypatch.setattr(record.time, "strftime", lambda form: "20261126_120000")
    when_recorded(1, is_over.set)
    (tmp_path / "wave").mkdir()
    # These files are of other programs.
    for name in ("20261126_120000.dat.part", "20261126_120000_2.json"):
        (tmp_path / "wave" / name).touch()
    for _ in range(2):
        is_over.clear()
        with sent(EVENTS) as port:
            words = ["record", f"udp://127.0.0.1:{port}", "--sensor", "64x48"]
            words += ["--class", "wave", "--seconds", 1.5, "--out", tmp_path]
            assert program(*words)[0] == 0
    assert waits == [1.5, 1.5]
    assert [path.name for path in sorted((tmp_path / "wave").glob("*.dat"))] == [
        "20261126_120000_3.dat",
        "20261126_120000_4.dat",
    ]


def test_an_interrupted_recording_is_complete_up_to_then(program, tmp_path, when_recorded):
    when_recorded(5_000, lambda: os.kill(os.getpid(), signal.SIGINT))
    with sent(EVENTS) as port:
        words = ["record", f"udp://127.0.0.1:{port}", "--sensor", "64x48", "--class", "a"]
        code, out, err = program(*words, "--out", tmp_path)
    (path,) = (tmp_path / "a").glob("*.dat")
    assert code == 130 and "5,000 events" in out and open_recording(path).n_events == 5_000
    assert err.splitlines()[-1] == "async-tnt: interrupted"


@pytest.fixture
def recorded(program, tmp_path, monkeypatch):
    """Record packets of a camera that is unplugged at the end.

    Returns the exit code, and the files in their order.
    """

    def run(*packets, device=None):
        device = device or PlayedDevice(*packets, OSError("no such device"), sensor=(64, 48))
        monkeypatch.setattr(
            record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played")
        )
        folder = tempfile.mkdtemp(dir=tmp_path)
        code, out, _ = program("record", "camera", "--class", "wave", "--out", folder)
        return code, [Path(line.partition(":")[0]) for line in out.splitlines()]

    return run


MODULES = {module.__file__ for module in (record, dat_writer, cameras)}
PACKETS = [made_events(*range(1_000 * k, 1_000 * k + 60)) for k in range(4)]


@contextlib.contextmanager
def signals_at(moment):
    """A signal at this call or return in the modules of a recording, and two more at once."""
    count = itertools.count()

    def profile(frame, kind, argument):
        if frame.f_code.co_filename in MODULES and moment <= next(count) < moment + 3:
            signal.raise_signal(signal.SIGINT)

    sys.setprofile(profile)
    try:
        yield count
    finally:
        sys.setprofile(None)


def test_whenever_signals_come_each_packet_that_was_read_is_in_the_file(recorded):
    moment = 0
    codes = []
    while True:
        device = PlayedDevice(
            *(packet.copy() for packet in PACKETS), OSError("gone"), sensor=(64, 48)
        )
        with signals_at(moment) as count:
            code, paths = recorded(device=device)
        n_read = min(4, 5 - len(device.packets))
        expected = np.concatenate([made_events(), *PACKETS[:n_read]])
        got = [open_recording(path, strict=True).read() for path in paths]
        assert len(got) == (n_read > 0) and sum(map(len, got)) == len(expected), moment
        assert all(np.array_equal(events["t"], expected["t"]) for events in got)
        assert all(
            json.loads(path.with_suffix(".json").read_text())["events"] == len(expected)
            for path in paths
        )
        codes.append(code)
        if next(count) <= moment:
            break
        moment += 1
    assert set(codes) == {2, 130} and codes[-1] == 2 and codes.count(130) > 100


def test_what_has_come_is_in_the_file_at_once(recorded, monkeypatch, tmp_path):
    """The file keeps what has come, even if the program is killed."""
    seen = []

    def show(picture, events):
        (path,) = tmp_path.rglob("*.dat")
        seen.append(open_recording(path, strict=True).n_events)

    monkeypatch.setattr(record._Picture, "show", show)
    recorded(*(packet.copy() for packet in PACKETS))
    assert seen == [60, 120, 180, 240]


def test_without_its_description_a_recording_is_whole(program, tmp_path, monkeypatch):
    def fail(path, text):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(record, "write_text", fail)
    with sent(EVENTS) as port:
        url = f"udp://127.0.0.1:{port}?timeout_s=3"
        code, _, err = program(
            "record", url, "--sensor", "64x48", "--class", "wave", "--out", tmp_path
        )
    (path,) = (tmp_path / "wave").iterdir()
    assert code == 2 and err.endswith(
        f"async-tnt: {path.with_suffix('.json')}: No space left on device\n"
    )
    assert open_recording(path, strict=True).n_events == 5_000


def test_where_no_line_can_be_printed_a_recording_and_its_description_are_whole(
    program, tmp_path, monkeypatch
):
    """The terminal has been closed, and the second file begins after a pause."""

    def fail(*lines):
        raise OSError(errno.EIO, "Input/output error")

    class Played(list):
        name = "played"
        sensor = (64, 48)

        def summary(self):
            return "2 packets"

        def close(self):
            pass

    source = Played([made_events(5, 9), made_events(9 + (1 << 31), 10 + (1 << 31))])
    monkeypatch.setattr(record, "open_source", lambda name, sensor: source)
    monkeypatch.setattr(record, "say", fail)
    code, _, err = program("record", "camera", "--class", "wave", "--out", tmp_path)
    paths = sorted((tmp_path / "wave").glob("*.dat"))
    assert code == 2 and "Input/output error" in err
    assert [open_recording(path, strict=True).n_events for path in paths] == [2, 2]
    assert [json.loads(path.with_suffix(".json").read_text())["events"] for path in paths] == [2, 2]


def test_a_file_is_complete_though_the_next_one_cannot_be_made(tmp_path):
    def create():
        return (tmp_path / "a.dat").open("xb", 0)

    events = random_events(4, sensor=(64, 48))
    events["t"] = [5, 6, 5 + 40 * MINUTE_US, 6 + 40 * MINUTE_US]
    files = []
    with pytest.raises(FileExistsError), DatWriter((64, 48), create, files.append) as writer:
        writer.write(events)
    np.testing.assert_array_equal(read_back(files), events[:2])


MINUTE_US = 60_000_000


@pytest.mark.parametrize(
    ("times", "n_files"),
    [
        (range(0, 71 * MINUTE_US, MINUTE_US), 1),
        (range(0, 143 * MINUTE_US, MINUTE_US), 2),  # each of less than 2**32 us
        ([5, 6, 5 + 35 * MINUTE_US], 1),
        ([5, 6, 6 + (1 << 31) - 1], 1),
        ([*range(0, 70 * MINUTE_US, 30 * MINUTE_US), (1 << 32) - 1], 1),
        ([*range(0, 70 * MINUTE_US, 30 * MINUTE_US), 1 << 32, (1 << 32) + 1], 2),
        ([5, 6, 6 + (1 << 31)], 2),
        ([5, 6, 5 + 40 * MINUTE_US, 6 + 40 * MINUTE_US], 2),
        # back by 40 minutes
        ([0, 30 * MINUTE_US, 60 * MINUTE_US, 20 * MINUTE_US, 21 * MINUTE_US], 2),
        # out of order within the first packet
        ([50 * MINUTE_US, 50 * MINUTE_US - 7, 50 * MINUTE_US + 1], 1),
        ([0, 1 << 40, 3, 4], 3),
        # back by the longest step, within a packet
        ([(1 << 31) - 1, 0, 1], 1),
        # the step counts from the previous event, not from the newest
        ([1_005, 5, 5 + (1 << 31)], 2),
    ],
)
@pytest.mark.parametrize("size", [1, 2, 1000])
def test_every_time_is_read_back_whatever_the_clock_does(times, n_files, size, tmp_path):
    events = random_events(len(times), seed=3, sensor=(64, 48))
    events["t"] = np.array(times) + 7_000_000_000
    files = written(np.split(events, range(size, len(events), size)), tmp_path)
    np.testing.assert_array_equal(read_back(files), events)
    if size == 1000:
        assert len(files) == n_files
    assert [file.on for file in files] == [
        open_recording(file.path).read()["p"].sum() for file in files
    ]


@pytest.mark.parametrize("seed", range(20))
def test_every_time_of_a_clock_that_jumps_at_random_is_read_back(seed, tmp_path):
    rng = np.random.default_rng(seed)
    steps = rng.choice(
        [0, 1, 1_000, -900, 1 << 31, -(1 << 31), 1 << 32, 1 << 33],
        400,
        p=[0.3, 0.3, 0.3, *5 * [0.02]],
    )
    events = random_events(400, seed=seed, sensor=(64, 48))
    events["t"] = (1 << 50) + np.cumsum(steps + rng.integers(-1, 2, 400))
    files = written(np.split(events, np.sort(rng.integers(0, 400, 30))), tmp_path)
    assert len(files) > 1
    np.testing.assert_array_equal(read_back(files), events)


def written(packets, folder, files=None):
    """The files of these packets, which are added to `files` as they are completed."""
    files = [] if files is None else files
    names = itertools.count()
    with DatWriter(
        (64, 48), lambda: (folder / f"{next(names)}.dat").open("xb", 0), files.append
    ) as writer:
        for packet in packets:
            writer.write(packet)
    assert writer.n_events == sum(map(len, packets)) == sum(file.events for file in files)
    return files


def read_back(files):
    parts = [open_recording(file.path, strict=True).read() for file in files]
    for part, file in zip(parts, files, strict=True):
        part["t"] += file.first_us
    return np.concatenate(parts)


def test_of_an_unplugged_camera_what_came_before_is_kept_with_its_settings(
    program, tmp_path, monkeypatch
):
    events = made_events(5, 9, 30)
    events["on"][:2] = True
    device = PlayedDevice(events, OSError("no such device"), sensor=(34, 34))
    monkeypatch.setattr(record.time, "strftime", lambda form: "20261126_120000")
    monkeypatch.setattr(
        record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played")
    )
    code, out, err = program("record", "camera", "--class", "wave", "--out", tmp_path)
    (path,) = (tmp_path / "wave").glob("*.dat")
    counts = "1 packets, 3 events (lost: unknown)"
    assert code == 2 and out == f"{path}: 3 events, 67% ON; {counts}\n"
    assert "the camera is gone after 3 events" in err.splitlines()[-1]
    assert open_recording(path).read()["t"].tolist() == [0, 4, 25]
    about = json.loads(path.with_suffix(".json").read_text())
    assert about == {
        "source": "EVK4 0042 by played",
        "class": "wave",
        "sensor": [34, 34],
        "started": "20261126_120000",
        "first_us": 5,
        "events": 3,
        "counts": counts,
        "settings": device.settings,
        "async_tnt": __version__,
    }
    assert device.n_closed


@pytest.mark.parametrize("n, room", [(100, 50_003), (5_000, 50_003), (100, 79_003)])
def test_on_a_full_disk_all_whole_events_are_kept(n, room, program, tmp_path, monkeypatch):
    """The events are in packets that wait in the file's buffer, and in one that is half written.

    This also holds after Ctrl-C.
    """
    packets = [made_events(*range(k * n, (k + 1) * n)) for k in range(10_000 // n)]
    device = PlayedDevice(*packets, KeyboardInterrupt(), sensor=(6_000, 34))
    monkeypatch.setattr(
        record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played")
    )
    with full_after(room):
        code, out, _ = program("record", "camera", "--class", "wave", "--out", tmp_path)
    (path,) = (tmp_path / "wave").glob("*.dat")
    n_whole = (room - len(dat_header((6_000, 34)))) // 8
    assert code == 2 and f"{n_whole:,} events" in out
    assert open_recording(path, strict=True).read()["t"].tolist() == list(range(n_whole))


def test_of_a_packet_that_is_written_in_part_what_is_there_is_counted(tmp_path):
    files = []
    with pytest.raises(OSError, match="File too large"), full_after(30_000):
        written([EVENTS[:2_000], EVENTS[2_000:]], tmp_path, files)
    (file,) = files
    there = read_back(files)
    assert 2_000 < file.events == len(there) < 5_000 and file.on == there["p"].sum()


@pytest.mark.parametrize("n_bytes", [-1, 0, 7])
def test_where_the_disk_has_no_room_for_an_event_no_file_is_left(
    n_bytes, program, tmp_path, monkeypatch
):
    """There is room for a part of the header, for the header, or for a part of the first event."""
    device = PlayedDevice(made_events(1, 2), sensor=(64, 48))
    monkeypatch.setattr(
        record, "open_source", lambda name, sensor: Camera(device, "EVK4 0042 by played")
    )
    with full_after(len(dat_header((64, 48))) + n_bytes):
        code, out, err = program("record", "camera", "--class", "wave", "--out", tmp_path)
    assert (code, out) == (2, "") and err.endswith(": File too large\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("a.bin --class x", "SOURCE must be a camera or udp://HOST:PORT, got a.bin"),
        ("udp://127.0.0.1:PORT --class x", "does not state its sensor; give --sensor WxH"),
        ("camera --class x --sensor 4x4", "--sensor belongs to a network stream"),
        (
            "udp://127.0.0.1:PORT --class x --seconds 0",
            "--seconds must be a positive number, got 0.0",
        ),
        *(
            (
                f"udp://127.0.0.1:PORT?timeout_s=.1 --class x --sensor 9x9 --seconds {seconds}",
                f"--seconds must be a positive number, got {seconds}",
            )
            for seconds in ("inf", "nan", "1e+30")
        ),
        (
            "udp://127.0.0.1:PORT --class x --sensor 20000x9",
            "DAT files hold 16384 pixels a side",
        ),
        (
            "udp://127.0.0.1:PORT?timeout_s=.1 --class x --sensor 9x9 --seconds .3",
            "no event came",
        ),
    ],
)
def test_what_cannot_be_recorded_is_refused_in_one_line_and_leaves_nothing(
    words, message, program, tmp_path
):
    words = words.replace("PORT", str(free_port())).split()
    code, out, err = program("record", *words, "--out", tmp_path / "new")
    assert code == 2 and out == "" and message in err.splitlines()[-1]
    assert not [path for path in tmp_path.rglob("*") if path.name != "new"]


BLANK_OR_HIDDEN = ("", "  ", " a", "a ", ".a", ".", "..")
NO_CLASSES = (*BLANK_OR_HIDDEN, "/", "a/", "a" * 256, "é" * 128, "a\0b", "a\nb")
"""Names that no folder of a class can have."""


@pytest.mark.parametrize(
    ("option", "value", "rule"),
    [
        *[("--class", name, "must be the name of a folder") for name in NO_CLASSES],
        *[("--out", name, "must be a folder") for name in ("", "  ", "a\0b")],
        ("--class", "--", "expected a value"),
        ("--out", "--", "expected a value"),
    ],
    ids=ascii,
)
def test_a_name_that_no_folder_can_have_is_refused_in_one_line(
    option, value, rule, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    options = {"--sensor": "9x9", "--class": "a", "--out": "new"} | {option: value}
    words = [f"{name}={word}" for name, word in options.items()]
    with pytest.raises(SystemExit) as stopped:
        main(["record", "udp://127.0.0.1:0?timeout_s=.1", *words])
    out, err = capsys.readouterr()
    assert stopped.value.code == 2 and not out and not list(tmp_path.iterdir())
    assert err.startswith(f"async-tnt record: argument {option}: {rule}")
    assert err.count("\n") == 1 and len(err) < 400


def test_a_name_that_the_file_system_refuses_is_one_line(program, tmp_path):
    words = ["record", "udp://127.0.0.1:0?timeout_s=.1", "--sensor=9x9", "--class", "a"]
    code, out, err = program(*words, "--out", tmp_path / ("a" * 300))
    assert (code, out, err.count("\n")) == (2, "", 1) and "File name too long" in err


def test_records_of_every_pixel_and_of_clocks_that_wrap_are_read_back(tmp_path):
    """Other programs write files whose times wrap after 71 minutes."""
    events = random_events(1_000, seed=1, sensor=(16_384, 16_384))
    events["t"] = np.linspace(0, 3 * (1 << 32), len(events)).astype(np.int64)
    events["x"][:2] = (0, 16_383)
    events["y"][:2] = (16_383, 0)
    wrapped = events.copy()
    wrapped["t"] %= 1 << 32
    (tmp_path / "a.dat").write_bytes(dat_header((16_384, 16_384)) + dat_records(wrapped, 0))
    np.testing.assert_array_equal(open_recording(tmp_path / "a.dat").read(), events)


@pytest.mark.parametrize("t", [6, 7 + (1 << 32)])
def test_a_time_that_the_format_cannot_say_is_refused(t):
    events = random_events(2)
    events["t"] = [7, t]
    with pytest.raises(
        ValueError, match=rf"^`t` must be in \[7, 4294967303\) for a DAT file, got {t} at event 1$"
    ):
        dat_records(events, 7)


@pytest.mark.parametrize(("encoding", "blocks"), [("utf-8", "▀▄█"), ("ascii", "'.#")])
def test_a_terminal_shows_the_last_events_and_their_rate(encoding, blocks, monkeypatch):
    class Terminal(io.TextIOWrapper):
        def isatty(self):
            return True

        def getvalue(self):
            return self.buffer.getvalue().decode(encoding)

    terminal = Terminal(io.BytesIO(), encoding, newline="")
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(record, "EVERY_S", 0.0)
    picture = record._Picture((64, 40), "wave")
    events = random_events(600, sensor=(64, 40))
    events["x"] = np.arange(600) % 32
    events["y"] = 10
    picture.show(events)
    picture.show(events)
    lines = terminal.getvalue().split("\n")
    rates = [line for line in lines if "events a second" in line]
    lit = [line for line in lines if line not in rates and set(blocks) & set(line)]
    assert len(rates) == 2 and terminal.getvalue().count("\x1b[") == 1
    assert len(lit) == 2 and all(line.rstrip().endswith(tuple(blocks)) for line in lit)
    terminal.close()
    picture.show(events)  # the recording goes on without it


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


@pytest.fixture
def pictures(monkeypatch):
    """A function of (columns, lines) that gives a terminal, a picture of a 10 x 20 sensor on it,
    and its clock, in seconds, as a list of one number."""

    def arrange(columns, lines, terminal=None):
        terminal = terminal or Terminal()
        now_s = [10.0]
        monkeypatch.setattr("sys.stderr", terminal)
        monkeypatch.setenv("COLUMNS", str(columns))
        monkeypatch.setenv("LINES", str(lines))
        monkeypatch.setattr(record, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
        return terminal, record._Picture((10, 20), "wave"), now_s

    return arrange


def at_pixels(*pixels):
    """Five events at each of these pixels (x, y)."""
    x, y = np.repeat(np.array(pixels), 5, axis=0).T
    return events_of(np.arange(len(x)), x, y, [1] * len(x))


def test_a_picture_shows_the_events_since_the_one_before_by_hand(pictures):
    """A character is a pixel wide and four high, of which its upper and its lower half have two."""
    terminal, picture, now_s = pictures(columns=11, lines=7)
    now_s[0] += 0.05
    picture.show(at_pixels((2, 6)))  # too early to draw
    assert terminal.getvalue() == ""
    now_s[0] += 0.45
    picture.show(at_pixels((9, 8), (0, 16), (0, 19)))
    first = ["", "  ▄", "         ▀", "", "█"]
    now_s[0] += 1
    picture.show(at_pixels((5, 1)))
    second = ["     ▀", "", "", "", ""]
    captions = "wave: 0.5 s, 40 events a second", "wave: 1.5 s, 5 events a second"
    expected = ""
    for lines, caption in zip((first, second), captions, strict=True):
        up = "\x1b[6A" if expected else ""
        rows = [line.ljust(10) for line in lines] + [caption]
        expected += up + "".join(f"\r{row}\n" for row in rows)
    assert terminal.getvalue() == expected


@pytest.mark.parametrize(
    ("columns", "lines", "is_shown"),
    [(10, 7, True), (9, 7, False), (10, 6, False), (1, 1, False), (500, 500, True)],
)
def test_a_picture_needs_room_and_takes_no_more_than_it_needs(pictures, columns, lines, is_shown):
    terminal, picture, now_s = pictures(columns, lines)
    now_s[0] += 1
    picture.show(at_pixels((2, 3)))
    rows = terminal.getvalue().replace("\r", "").splitlines()
    assert bool(rows) == is_shown
    if columns == 500:
        assert len(rows) == 21 and all(len(row) == 64 for row in rows)


def test_nothing_is_drawn_into_a_file(pictures):
    terminal, picture, now_s = pictures(80, 24, io.StringIO())
    now_s[0] += 1
    picture.show(at_pixels((2, 3)))
    assert terminal.getvalue() == ""


def test_the_recording_goes_on_when_the_terminal_has_hung_up(pictures):
    terminal, picture, now_s = pictures(80, 24)

    def fail():
        raise OSError(errno.EIO, "Input/output error")

    terminal.flush = fail
    for _ in range(2):
        now_s[0] += 1
        picture.show(at_pixels((2, 3)))
