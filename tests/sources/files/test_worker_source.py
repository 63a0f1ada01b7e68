"""Files that are read in a worker process.

The tests say what happens if the library is missing, crashes, hangs or lies.
"""

import os
import time

import numpy as np
import pytest
from sources.files.written import made_events, written

from async_tnt.sources.files import ros_bags, worker_source
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import CorruptData
from async_tnt.sources.files.worker_source import WorkerSource


def misbehaving(path):
    """A reader as libraries are with damaged files.

    The file has two words: what to do to this process before, and what after the sensor and two
    events.
    """
    with open(path) as file:
        first, later = file.read().split()
    misbehave(first)
    yield 34, 34
    yield [np.array(column) for column in ([10, 11], [1, 1], [2, 2], [0, 1])]
    misbehave(later)


def misbehave(how):
    if how == "hang":
        time.sleep(3600)
    if how == "die":
        os._exit(3)
    if how == "panic":
        raise BaseException("its message\nin two lines")


@pytest.mark.parametrize(
    ("name", "start", "message"),
    [
        (
            "a.aedat4",
            b"#!AER-DAT4.0\r\n",
            r"AEDAT4 is read by faery, .*: pip install 'async_tnt\[files\]'",
        ),
        ("a.es", b"Event Stream", r"ES is read by faery, .*: pip install 'async_tnt\[files\]'"),
        (
            "a.h5",
            b"\x89HDF\r\n\x1a\n",
            r"HDF5 is read by h5py, .*: pip install 'async_tnt\[hdf5\]'",
        ),
        *(
            (f"a{suffix}", b"", r"ROS bags are read by rosbags, .*: pip install 'async_tnt\[ros\]'")
            for suffix in (".bag", ".db3", ".mcap")
        ),
    ],
)
def test_a_missing_library_is_named_with_its_extra(tmp_path, monkeypatch, name, start, message):
    monkeypatch.setattr(worker_source, "find_spec", lambda name: None)
    monkeypatch.setattr(ros_bags, "find_spec", lambda name: None)
    (tmp_path / name).write_bytes(start)
    with pytest.raises(ImportError, match=rf"{name}: {message}"):
        open_recording(tmp_path / name)


STOPPED = "a worker process crashed, hung, was killed, or ran out of memory"


@pytest.mark.parametrize(
    ("how", "message"),
    [("hang", STOPPED), ("die", STOPPED), ("panic", "BaseException: its message in two lines")],
)
def test_a_reader_that_hangs_dies_or_panics_is_damage_after_the_events_before(
    tmp_path, monkeypatch, how, message
):
    """HDF5 reads some damaged attributes forever, and faery can run out of memory."""
    path = tmp_path / "a.odd"
    path.write_text("read end")
    source = WorkerSource(path, misbehaving, "odd")
    assert [len(block) for block in source.blocks()] == [2] and source.sensor == (34, 34)
    if how == "hang":
        monkeypatch.setattr(worker_source, "SILENCE_S", 0.5)
    path.write_text(f"read {how}")
    with pytest.raises(CorruptData, match=f"after event 2: {message}"):
        list(source.blocks())
    path.write_text(f"{how} end")
    with pytest.raises(CorruptData, match=f"after event 0: {message}"):
        list(source.blocks())
    with pytest.raises(ValueError, match=f"a.odd: not a readable odd file: {message}"):
        WorkerSource(path, misbehaving, "odd")


def test_files_are_read_as_often_as_asked_at_once_and_after_damage(tmp_path):
    """One worker reads one after another; it is replaced after damage, or if it is killed."""
    paths = [
        written(tmp_path / "dv.aedat4", made_events(50, seed=k)).rename(tmp_path / f"{k}.aedat4")
        for k in range(3)
    ]
    recordings = [open_recording(path) for path in paths]
    before = worker_source._idle[os.getpid()]
    for k in (2, 0, 1, 1):
        np.testing.assert_array_equal(recordings[k].read(), made_events(50, seed=k))
    assert worker_source._idle[os.getpid()] is before
    assert [[len(packet) for packet in packets] for packets in zip(*recordings, strict=True)] == [
        [50] * 3
    ]
    # This file is not read to its end.
    next(recordings[0].source.blocks())
    np.testing.assert_array_equal(recordings[0].read(), made_events(50, seed=0))
    paths[2].write_bytes(paths[0].read_bytes()[:100])
    with pytest.raises(ValueError, match=r"2.aedat4: not a readable AEDAT4 file"):
        open_recording(paths[2])
    recordings[0].read()
    kept = worker_source._idle[os.getpid()]
    kept._process.kill()  # a system without memory kills processes, too
    kept._process.wait()
    np.testing.assert_array_equal(recordings[1].read(), made_events(50, seed=1))
