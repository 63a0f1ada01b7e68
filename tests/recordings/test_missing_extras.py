"""What a user reads who has not installed what a format needs; and layouts that are not known."""

import os
import struct

import numpy as np
import pytest
from recordings.written import WRITERS, dsec, made_events

from async_tnt.sources.files import aedat4, child, hdf5
from async_tnt.sources.files.damage import DamagedRecording
from async_tnt.sources.files.recording import open_recording


def test_faery_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(aedat4, "find_spec", lambda name: None)
    (tmp_path / "a.aedat4").write_bytes(b"#!AER-DAT4.0\r\n")
    with pytest.raises(ImportError, match=r"a\.aedat4: AEDAT4 files are read by faery, .*: pip install '\.\[files\]'"):
        open_recording(tmp_path / "a.aedat4")


def test_h5py_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5, "find_spec", lambda name: None)
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(ImportError, match=r"a\.h5: HDF5 files are read by h5py, .*: pip install '\.\[hdf5\]'"):
        open_recording(tmp_path / "a.h5")


@pytest.mark.parametrize(("code", "hint"), [(0x8ECF, "Prophesee's ECF: install its plugin"), (0x7FFE, "filter 32766")])
def test_a_filter_is_missing(tmp_path, code, hint):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("CD")
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((10,))
        plist.set_filter(code, h5py.h5z.FLAG_OPTIONAL, ())  # else it could not even be written
        dtype = h5py.h5t.py_create(np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]))
        h5py.h5d.create(group.id, b"events", dtype, h5py.h5s.create_simple((10,)), dcpl=plist)
    with pytest.raises(ValueError, match=rf"a\.h5: its events are compressed by .*{hint}"):
        open_recording(tmp_path / "a.h5")


def test_hdf5_of_another_layout(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["data"] = np.zeros(3)
    with pytest.raises(ValueError, match=r"expected events/t, x, y, p \(DSEC\) or CD/events .*, got \['data'\]"):
        open_recording(path)
    dsec(path, made_events(5))
    with h5py.File(path, "a") as file:
        del file["events/x"]
        file["events/x"] = np.zeros(4, "u2")
    with pytest.raises(ValueError, match=r"must have one dimension and equal lengths, got \[\(4,\), \(5,\)\]"):
        open_recording(path)
    dsec(path, made_events(5))
    with h5py.File(path, "a") as file:
        del file["events/t"]
        file["events/t"] = np.zeros(5)
    with pytest.raises(ValueError, match=r"must be whole numbers, got float64"):
        open_recording(path)


def test_hdf5_values_that_are_no_events(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "a.h5"
    dsec(path, made_events(5))
    with h5py.File(path, "a") as file:
        file["events/p"][3] = 7
    with pytest.warns(DamagedRecording, match="event 3: t = .*, p = 7 is no event"):
        assert open_recording(path).n_events == 3


@pytest.mark.parametrize("offset_us", [1_000, 0, -1_000, 1 << 61])
def test_hdf5_times_beyond_64_bits_do_not_wrap_into_others(tmp_path, offset_us):
    """As int64 they are small negative numbers, which the offset would make times again."""
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "a.h5"
    dsec(path, made_events(5))
    with h5py.File(path, "a") as file:
        del file["events/t"], file["t_offset"]
        file["events/t"] = np.array([2_000, 2_001, 2_002, (1 << 64) - 5, 2_003], "u8")
        file["t_offset"] = np.int64(offset_us)
    with pytest.warns(DamagedRecording, match="event 3: t = -"):
        assert open_recording(path).read()["t"].tolist() == [2_000 + offset_us + i for i in range(3)]


def test_metavision_polarity_may_be_minus_one(tmp_path):
    h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")
    path = tmp_path / "a.hdf5"
    events = made_events(50)
    WRITERS["metavision.hdf5"](path, events)
    with h5py.File(path, "a") as file:
        records = file["CD/events"][:]
        records["p"] = np.where(records["p"] == 1, 1, -1)
        file["CD/events"][:] = records
    np.testing.assert_array_equal(open_recording(path).read(), events)


@pytest.mark.parametrize("name", ["dv.aedat4", "dsec.h5"])
def test_a_reader_that_hangs_is_ended(tmp_path, monkeypatch, name):
    """As HDF5's does in some damaged attributes: it reads them for ever."""
    WRITERS[name](tmp_path / name, made_events(50))
    recording = open_recording(tmp_path / name)
    (tmp_path / "sleep.sh").write_text("#!/bin/sh\nexec sleep 60\n")
    (tmp_path / "sleep.sh").chmod(0o755)
    monkeypatch.setattr(child, "SILENCE_S", 0.2)
    monkeypatch.setattr(child.sys, "executable", str(tmp_path / "sleep.sh"))
    with pytest.warns(DamagedRecording, match="after event 0: its reader stopped for good, or hung, at the damage"):
        assert recording.n_events == 0
    with pytest.raises(ValueError, match="its reader stopped for good, or hung, at the damage"):
        open_recording(tmp_path / name)


@pytest.mark.skipif(os.name != "posix", reason="a script in the place of Python")
@pytest.mark.parametrize(("field", "value"), [("t", 1 << 63), ("t", 1 << 62), ("p", 2)])
def test_an_event_of_aedat4_that_cannot_be_ends_the_reading(tmp_path, monkeypatch, field, value):
    """faery's process says it: here written down, as its writer refuses such events."""
    packets = np.array([(10 + i, 1, 2, i % 2) for i in range(9)], aedat4.DTYPE).reshape(3, 3)
    packets[1, 2][field] = value
    said = b"".join(struct.pack("<I", 3) + packet.tobytes() for packet in packets)
    (tmp_path / "said").write_bytes(b'{"sensor": [34, 34]}\n' + said + bytes(4) + b"{}\n")
    (tmp_path / "says.sh").write_text(f"#!/bin/sh\nexec cat '{tmp_path}/said'\n")
    (tmp_path / "says.sh").chmod(0o755)
    (tmp_path / "a.aedat4").write_bytes(b"#!AER-DAT4.0\r\n")
    monkeypatch.setattr(aedat4, "find_spec", lambda name: True)
    monkeypatch.setattr(child.sys, "executable", str(tmp_path / "says.sh"))
    with pytest.warns(DamagedRecording, match=r"event 5: t = .* is no event"):
        assert open_recording(tmp_path / "a.aedat4").read()["t"].tolist() == [10, 11, 12, 13, 14]


def test_aedat4_child_stopped_for_good_is_damage(tmp_path, monkeypatch):
    """A process that dies without a word, as faery's does where it runs out of memory."""
    pytest.importorskip("faery", reason="AEDAT4 needs faery")
    path = tmp_path / "a.aedat4"
    WRITERS["dv.aedat4"](path, made_events(50))
    recording = open_recording(path)
    monkeypatch.setattr(child.sys, "executable", "/bin/false")
    with pytest.warns(DamagedRecording, match="after event 0: its reader stopped for good, or hung, at the damage"):
        assert recording.n_events == 0
