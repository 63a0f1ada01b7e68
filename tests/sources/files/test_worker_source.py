"""Files that are read in a worker process.

The tests say what happens if the library is missing, crashes, hangs or lies.
"""

import os
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from sources.files.written import SENSOR, made_events, written

from async_tnt.base.worker import Worker
from async_tnt.sources.files import library_readers, ros_bags, worker_source
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


def test_the_first_stream_of_events_is_read_and_no_other(monkeypatch):
    """As of two cameras in one AEDAT4 file. The library is played: it writes one stream only."""
    images, left, right = [
        SimpleNamespace(id=k, data_type=kind, dimensions=dimensions)
        for k, kind, dimensions in (
            (0, "frame", (9, 9)),
            (1, "events", (34, 20)),
            (2, "events", (60, 48)),
        )
    ]
    names = {"t": "<u8", "x": "<u2", "y": "<u2", "on": "?"}
    packets = [np.array([(t, 1, 2, 1)], list(names.items())) for t in (5, 6, 7)]

    class Decoder:
        def __init__(self, path):
            self.tracks = lambda: [images, left, right]

        def __iter__(self):
            yield images, packets[0]
            yield from ((left, packets[0]), (right, packets[1]), (left, packets[2][:0]))
            yield left, packets[2]

    extension = SimpleNamespace(aedat=SimpleNamespace(Decoder=Decoder))
    monkeypatch.setitem(sys.modules, "faery", SimpleNamespace(extension=extension))
    monkeypatch.setitem(sys.modules, "faery.extension", extension)
    sensor, *blocks = library_readers.read_aedat4("a.aedat4")
    assert sensor == (34, 20)
    assert [[column.tolist() for column in block] for block in blocks] == [
        [[t], [1], [2], [True]] for t in (5, 7)
    ]
    left.dimensions = None
    assert next(library_readers.read_aedat4("a.aedat4")) is None


def test_no_worker_is_left_but_one_for_the_next_file(tmp_path, monkeypatch):
    """Two loops at once need two; a loop that is left before its end ends its own."""
    workers = []

    class Noted(Worker):
        def __init__(self):
            super().__init__()
            workers.append(self)

    def running():
        return [worker for worker in workers if worker.is_running]

    monkeypatch.setattr(worker_source, "Worker", Noted)
    monkeypatch.setattr(worker_source, "_idle", {})
    path = tmp_path / "a.odd"
    path.write_text("read end")
    source = WorkerSource(path, misbehaving, "odd")
    loops = [source.blocks(), source.blocks()]
    assert [len(next(loop)) for loop in loops] == [2, 2] and len(running()) == 2
    assert [list(loop) for loop in loops] == [[], []]
    assert running() == list(worker_source._idle.values()) and len(running()) == 1
    left = source.blocks()
    next(left)
    left.close()
    assert running() == [] and worker_source._idle == {}


def test_events_off_the_sensor_are_read_in_files_of_many_packets(tmp_path):
    """faery reads such an ES file up to the first of them only."""
    pytest.importorskip("faery", reason="ES needs faery")
    events = made_events(150_000, step_us=4)
    events["x"][[70_000, 149_000]] = SENSOR[0]
    sensor, *blocks = library_readers.read_es(str(written(tmp_path / "dvs.es", events)))
    columns = [np.concatenate(parts) for parts in zip(*blocks, strict=True)]
    assert sensor == SENSOR
    np.testing.assert_array_equal(columns, [events[name] for name in "txyp"])


def test_a_relative_name_is_of_the_folder_at_opening(tmp_path, monkeypatch):
    """The worker's own folder may be another, and so may be that of the program later."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        written(tmp_path / name / "dv.aedat4", made_events(50, seed=len(name)))
    open_recording(tmp_path / "there" / "dv.aedat4")  # there is a worker now
    monkeypatch.chdir(tmp_path / "here")
    recording = open_recording("dv.aedat4")
    monkeypatch.chdir(tmp_path / "there")
    np.testing.assert_array_equal(recording.read(), made_events(50, seed=4))


def test_a_file_without_one_valid_event_is_refused_at_opening(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = written(tmp_path / "dsec.h5", made_events(5))
    with h5py.File(path, "a") as file:
        file["events/p"][...] = 7
    with pytest.raises(ValueError, match=r"dsec\.h5: not one event can be read: event 0: .* p = 7"):
        open_recording(path)
