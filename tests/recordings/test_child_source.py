"""Files that are read in a child process: what it sends, and what happens if it is missing, crashes, hangs or lies."""

import io
import json
import os
from types import SimpleNamespace

import numpy as np
import pytest
from recordings.written import made_events, written

from async_tnt.sources.files import child_process, child_source
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording


@pytest.mark.parametrize(
    ("name", "start", "message"),
    [
        ("a.aedat4", b"#!AER-DAT4.0\r\n", r"AEDAT4 is read by faery, .*: pip install 'async_tnt\[files\]'"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", r"HDF5 is read by h5py, .*: pip install 'async_tnt\[hdf5\]'"),
    ],
)
def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, name, start, message):
    monkeypatch.setattr(child_source, "find_spec", lambda name: None)
    (tmp_path / name).write_bytes(start)
    with pytest.raises(ImportError, match=rf"{name}: {message}"):
        open_recording(tmp_path / name)


@pytest.mark.skipif(os.name != "posix", reason="a script in the place of Python")
@pytest.mark.parametrize("program", ["exec sleep 600", "kill -SEGV $$"])
def test_a_child_that_hangs_or_dies_is_damage(tmp_path, monkeypatch, program):
    """HDF5 reads some damaged attributes forever, and faery can run out of memory."""
    recording = open_recording(written(tmp_path / "dv.aedat4", made_events(50)))
    child_source._end_idle()
    script = tmp_path / "program.sh"
    script.write_text(f"#!/bin/sh\n{program}\n")
    script.chmod(0o755)
    monkeypatch.setattr(child_source, "SILENCE_S", 0.2)
    monkeypatch.setattr(child_source.sys, "executable", str(script))
    with pytest.warns(DamagedRecording, match="after event 0: the process that reads it crashed or hung"):
        assert recording.n_events == 0
    with pytest.raises(ValueError, match="the process that reads it crashed or hung"):
        open_recording(recording.path)


def sent(monkeypatch, tmp_path, *messages):
    """The recording of a child that sends these messages."""
    monkeypatch.setattr(child_source, "find_spec", lambda name: True)
    answers = {"sensor": messages[:1], "events": messages[1:]}
    monkeypatch.setattr(child_source.Child, "ask", lambda child, what, *more: iter(answers[what]))
    (tmp_path / "a.aedat4").write_bytes(b"#!AER-DAT4.0\r\n")
    return open_recording(tmp_path / "a.aedat4")


@pytest.mark.parametrize(("row", "value"), [(0, -(1 << 63)), (0, 1 << 62), (1, -1), (2, 1 << 16), (3, 2)])
def test_an_invalid_event_ends_the_reading(tmp_path, monkeypatch, row, value):
    blocks = np.array([[[10, 11, 12], [1, 1, 1], [2, 2, 2], [0, 1, 0]]] * 3, np.int64)
    blocks[1, row, 2] = value
    recording = sent(monkeypatch, tmp_path, b"[34, 34]", *(block.tobytes() for block in blocks))
    with pytest.warns(DamagedRecording, match=r"event 5: t = .* is not a valid event"):
        assert recording.read()["t"].tolist() == [10, 11, 12, 10, 11]


def test_what_came_before_an_error_is_kept(tmp_path, monkeypatch):
    block = np.array([[10, 11], [1, 1], [2, 2], [0, 1]], np.int64).tobytes()
    recording = sent(monkeypatch, tmp_path, b"null", block, "its message")
    with pytest.warns(DamagedRecording, match="damaged recording: after event 2: its message. Keeping the 2 events"):
        assert recording.n_events == 2
    assert recording.sensor is None


READER = """
import numpy as np

def read(path):
    yield None
    for n in range(3):
        yield np.full((4, 1), n)
        yield np.zeros((4, 0))
    raise KeyError("broken\\nat three")
"""


def test_the_alarm_is_set_while_a_file_is_read_and_not_while_the_parent_reads(tmp_path, monkeypatch):
    calls = []

    class Sender:
        def __init__(self, fd, readable):
            assert (fd, readable) == (7, False)

        def send_bytes(self, message):
            calls.append(message)

    monkeypatch.setattr(child_process.connection, "Connection", Sender)
    monkeypatch.setattr(child_process, "_limit_memory", lambda: None)
    monkeypatch.setattr(child_process.signal, "alarm", calls.append, raising=False)
    monkeypatch.setattr(child_process.signal, "signal", lambda *given: None)
    (tmp_path / "reader.py").write_text(READER)
    commands = ([what, str(tmp_path / "reader.py"), "FILE"] for what in ("sensor", "events"))
    lines = io.BytesIO(b"".join(json.dumps(command).encode() + b"\n" for command in commands))
    monkeypatch.setattr(child_process.sys, "stdin", SimpleNamespace(buffer=lines))
    child_process.main(7)
    events = [np.full(4, n, np.int64).tobytes() for n in range(3)]
    answers = [b"null", b"", b""], [*events, b"", b"'broken\\nat three'"]
    assert calls == [
        call for answer in answers for call in (120, *(c for message in answer for c in (0, message, 120)), 0)
    ]


def test_a_path_is_relative_to_the_folder_of_now(tmp_path, monkeypatch):
    for k, name in enumerate("ab"):
        (tmp_path / name).mkdir()
        written(tmp_path / name / "dv.aedat4", made_events(50, seed=k))
        monkeypatch.chdir(tmp_path / name)
        np.testing.assert_array_equal(open_recording("dv.aedat4").read(), made_events(50, seed=k))


def test_a_child_reads_the_next_file_unless_there_was_damage(tmp_path, monkeypatch):
    """And each file as often as asked, whichever was opened last."""
    paths = [
        written(tmp_path / "dv.aedat4", made_events(50, seed=k)).rename(tmp_path / f"{k}.aedat4") for k in range(3)
    ]
    child_source._end_idle()
    recordings = [open_recording(path) for path in paths]
    (first,) = child_source._idle.values()
    for k in (2, 0, 1, 1):
        np.testing.assert_array_equal(recordings[k].read(), made_events(50, seed=k))
    assert child_source._idle[os.getpid()] is first
    for k, packets in enumerate(zip(*recordings, strict=True)):  # at the same time
        assert k == 0 and [len(packet) for packet in packets] == [50] * 3
    kept = child_source._idle[os.getpid()]
    next(recordings[0]._source.blocks())  # not to its end
    assert not kept.is_usable and not child_source._idle
    np.testing.assert_array_equal(recordings[0].read(), made_events(50, seed=0))
    kept = child_source._idle[os.getpid()]
    (tmp_path / "torn.aedat4").write_bytes(paths[0].read_bytes()[:100])
    with pytest.raises(ValueError, match=r"torn.aedat4: not a readable AEDAT4 file"):
        open_recording(tmp_path / "torn.aedat4")
    assert not kept.is_usable
    recordings[0].read()
    kept = child_source._idle[os.getpid()]
    monkeypatch.setenv("HDF5_PLUGIN_PATH", str(tmp_path))  # a child would be started otherwise
    recordings[0].read()
    assert child_source._idle[os.getpid()] is not kept
    child_source._idle[os.getpid()]._process.kill()  # as a system without memory does
    child_source._idle[os.getpid()]._process.wait()
    np.testing.assert_array_equal(recordings[1].read(), made_events(50, seed=1))
