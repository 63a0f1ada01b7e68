"""Files that are no recordings, empty ones, links, folders, pipes, and headers that promise too much."""

import os
import tracemalloc
import zipfile

import numpy as np
import pytest
from recordings.damaging import EVERY_WRITER
from recordings.written import WRITERS, dat, evt3, evt_header, made_events

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.damage import DamagedRecording
from async_tnt.sources.files.formats import READERS
from async_tnt.sources.files.recording import open_recording

EVENTS = made_events(50, sensor=(34, 34))
EMPTY = {".bin": 0, ".csv": 0, ".tsv": 0, ".txt": 0}  # no header: nothing is nothing; all others are refused


@pytest.mark.parametrize("suffix", sorted(READERS))
def test_an_empty_file_has_no_events_or_is_refused(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.touch()
    if suffix in EMPTY:
        assert open_recording(path).n_events == 0
        return
    with pytest.raises(ValueError, match=rf"a\{suffix}: (the file is empty|not a readable NumPy file)"):
        open_recording(path)


@pytest.mark.parametrize("suffix", sorted(READERS))
def test_a_folder_is_no_recording(tmp_path, suffix):
    (tmp_path / f"a{suffix}").mkdir()
    with pytest.raises(IsADirectoryError, match=rf"a\{suffix}"):
        open_recording(tmp_path / f"a{suffix}")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("suffix", sorted(READERS))
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, suffix):
    os.mkfifo(tmp_path / f"a{suffix}")
    with pytest.raises(ValueError, match=rf"a\{suffix}: a recording must be a file that can be read more than once"):
        open_recording(tmp_path / f"a{suffix}")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no such device on this system")
def test_a_device_is_refused(tmp_path):
    (tmp_path / "a.csv").symlink_to("/dev/zero")
    with pytest.raises(ValueError, match="got a pipe or a device"):
        open_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("name", sorted(EVERY_WRITER))
def test_links_are_followed_and_suffixes_may_be_in_capitals(tmp_path, name):
    EVERY_WRITER[name](tmp_path / name, EVENTS, (34, 34))
    capitals = tmp_path / name.upper()
    if not capitals.exists():  # a file system may not tell them apart
        capitals.symlink_to(tmp_path / name)
    np.testing.assert_array_equal(open_recording(capitals).read(), EVENTS)
    (tmp_path / f"gone{capitals.suffix}").symlink_to(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="gone"):
        open_recording(tmp_path / f"gone{capitals.suffix}")


@pytest.mark.parametrize("suffix", [".gz", ".zip", ".xz"])
def test_a_packed_file_is_to_be_unpacked(tmp_path, suffix):
    (tmp_path / f"a.csv{suffix}").touch()
    with pytest.raises(ValueError, match=rf"unknown suffix '\{suffix}', expected one of .*; unpack it first$"):
        open_recording(tmp_path / f"a.csv{suffix}")


@pytest.mark.parametrize(
    ("name", "data", "text"),
    [
        ("a.raw", evt3(EVENTS)[len(evt_header("3.0")) :], "its first bytes are of no known format"),
        ("a.dat", b"1 2 3\n4 5 6\n", "its first bytes are of no known format"),
        ("a.dat", b"\x00\x01\x02\x03" * 9, "its first bytes are of no known format"),
        ("a.dat", b"% some table\n1 2 3\n4 5 6\n", "after the header there must be a type of events, 0 or 12"),
        ("a.dat", b"% Version 7\n\x0c\x08", "the header's Version must be 1 or 2, got '7'"),
        (
            "a.dat",
            dat(EVENTS)[: dat(EVENTS).index(b"\x0c\x08") + 1],
            "a type of events, 0 or 12, and their size, 8; got",
        ),
        ("a.es", b"Event Stream\x01\x00\x00\x01\x22\x00\x22\x00", "expected Event Stream version 2"),
        ("a.es", b"Event Stream\x02\x00\x00\x01\x22\x00", "expected the 20 bytes of an Event Stream header"),
        ("a.csv", b"\x89PNG\r\n\x1a\n\x00\x00", "expected text, got bytes that are none"),
        ("a.npy", b"PK\x03\x04", "rename it to .npz"),
    ],
)
def test_another_kind_of_file_is_refused_in_one_line(tmp_path, name, data, text):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=text) as told:
        open_recording(tmp_path / name)
    assert str(tmp_path / name) in str(told.value) and "\n" not in str(told.value)


@pytest.mark.parametrize("name", sorted(set(WRITERS) - {"plain.csv", "uzh.txt"}))
def test_a_header_without_events_is_an_empty_recording(tmp_path, name):
    WRITERS[name](tmp_path / name, EVENTS[:0], (34, 34))
    recording = open_recording(tmp_path / name)
    assert (recording.n_events, recording.duration_us, list(recording)) == (0, 0, [])


def header_of(n, dtype=EVENT_DTYPE):
    """A .npy header that claims n events."""
    from io import BytesIO

    out = BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": dtype.descr, "fortran_order": False, "shape": (n,)})
    return out.getvalue()


@pytest.mark.parametrize("n", [10**6, 10**9, 10**12, 10**17, 10**30])
@pytest.mark.parametrize("name", ["a.npy", "stored.npz", "deflated.npz"])
def test_a_header_that_promises_too_much_takes_no_memory(tmp_path, name, n):
    path = tmp_path / name
    data = header_of(n) + bytes(1_300)
    if name == "a.npy":
        path.write_bytes(data)
    else:
        how = zipfile.ZIP_STORED if name == "stored.npz" else zipfile.ZIP_DEFLATED
        with zipfile.ZipFile(path, "w", how) as archive:
            archive.writestr("events.npy", data)
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=rf"{name}: not a readable NumPy file"):
            open_recording(path)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()


def test_an_archive_that_lies_about_its_sizes_takes_no_memory(tmp_path):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("events.npy", header_of(10**8) + bytes(1_300))
    data = bytearray(path.read_bytes())
    claimed = len(header_of(10**8)) + 10**8 * EVENT_DTYPE.itemsize
    place = data.rindex(b"PK\x01\x02") + 24  # the central directory: size when unpacked
    data[place : place + 4] = claimed.to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a\.npz: not a readable NumPy file: events\.npy ends before its array does$"):
        open_recording(path)


@pytest.mark.parametrize("n_lost", [-5, 1, 12, 13, 40])
def test_a_npy_of_another_size_than_it_says_is_refused(tmp_path, n_lost):
    path = tmp_path / "a.npy"
    np.save(path, EVENTS)
    data = path.read_bytes()
    path.write_bytes(data[:-n_lost] if n_lost > 0 else data + bytes(-n_lost))
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy file"):
        open_recording(path)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_npy_is_read_up_to_what_is_no_event(tmp_path, order):
    """In the second block of 65,536."""
    table = np.zeros((70_000, 4), np.int64, order=order)
    table[:, 0] = np.arange(70_000)
    table[66_000, 1] = -3
    np.save(tmp_path / "a.npy", table)
    with pytest.warns(DamagedRecording, match="event 66000: t = 66000, x = -3, y = 0, p = 0 is no event"):
        assert open_recording(tmp_path / "a.npy").read()["t"].tolist() == list(range(66_000))
    table[66_000, 1] = 3
    table[67_000, 3] = -1
    np.save(tmp_path / "a.npy", table)
    with pytest.warns(DamagedRecording, match=r"event 67000: p = -1, and before it 0: polarity is 0/1 or -1/\+1"):
        assert open_recording(tmp_path / "a.npy").n_events == 67_000
