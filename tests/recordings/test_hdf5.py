"""HDF5 files: layouts, compression, and where they may keep their events: in the file itself, in chunks."""

import sys
from collections import Counter
from io import FileIO

import numpy as np
import pytest
from recordings.test_damage import read as read_damaged
from recordings.written import FORMATS, SENSOR, dsec, made_events, metavision, written

from async_tnt.sources.files import hdf5
from async_tnt.sources.files.recording import open_recording

h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")

EVENTS = made_events(5_000)
LAYOUTS = ["dsec.h5", "metavision.hdf5"]
FILTERS = {"Blosc": "32001", "Blosc2": "32026", "Zstd": "32015", "LZ4": "32004"}
SETS = [f"events/{name}" for name in "txyp"]


def read(path):
    """Columns t, x, y, p: what the reader yields in its child process, here in this one."""
    _, *blocks = hdf5.read(str(path))
    return np.concatenate(blocks, axis=1)


def assert_holds(path, events):
    np.testing.assert_array_equal(read(path), [events[name] for name in "txyp"])


def replaced(path, **values):
    """A small DSEC file in which other values stand under some names."""
    dsec(path, made_events(5))
    with h5py.File(path, "a") as file:
        for name, value in values.items():
            name = name if name == "t_offset" else f"events/{name}"
            del file[name]
            file[name] = value
    return path


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"x": np.zeros(4, "u2")}, r"must have one dimension and equal lengths, got \[\(4,\), \(5,\)\]"),
        ({"t": np.zeros(5)}, "must be whole numbers, got float64"),
        ({"t_offset": np.zeros(2, int)}, r"`t_offset` must be one number, got shape \(2,\)"),
        ({"t_offset": np.int64(-(1 << 62))}, r"`t_offset` must be below 2\*\*62 microseconds, got -46"),
        (None, r"expected events/t, x, y, p \(DSEC\) or CD/events .*, got \['data'\]"),
    ],
)
def test_another_layout_is_refused(tmp_path, values, message):
    if values is not None:
        replaced(tmp_path / "a.h5", **values)
    else:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["data"] = np.zeros(3)
    with pytest.raises(ValueError, match=message):
        next(hdf5.read(str(tmp_path / "a.h5")))


@pytest.mark.parametrize("offset_us", [1_000, -1_000, 1 << 61])
def test_times_beyond_64_bits_do_not_wrap_into_others(tmp_path, offset_us):
    """As int64 they are small negative numbers, which the offset would make times again."""
    t = np.array([2_000, 2_001, 2_002, (1 << 64) - 5, 2_003], "u8")
    path = replaced(tmp_path / "a.h5", t=t, t_offset=np.int64(offset_us))
    times = read(path)[0]
    assert times[3] < 0 and np.delete(times, 3).tolist() == [2_000 + offset_us + i for i in range(4)]


def compressed(path, name):
    hdf5plugin = pytest.importorskip("hdf5plugin", reason="Blosc needs hdf5plugin")
    FORMATS[path.name].write(path, EVENTS, SENSOR, chunks=(1_000,), **getattr(hdf5plugin, name)())
    assert path.stat().st_size < EVENTS.nbytes  # it was compressed, not left out as filters may be
    return path


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", FILTERS)
def test_hdf5plugins_filters_are_read_and_named_where_they_are_missing(tmp_path, monkeypatch, layout, name):
    path = compressed(tmp_path / layout, name)
    assert_holds(path, EVENTS)
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: code < 256)
    with pytest.raises(ValueError, match=rf"\(filter {FILTERS[name]}\), which is missing: pip install hdf5plugin"):
        next(hdf5.read(str(path)))


def test_blosc_is_read_in_the_child_process(tmp_path):
    np.testing.assert_array_equal(open_recording(compressed(tmp_path / "dsec.h5", "Blosc")).read(), EVENTS)


@pytest.mark.parametrize(("code", "hint"), [(0x8ECF, "Prophesee's ECF: install its plugin"), (0x7FFE, "filter 32766")])
def test_a_filter_that_nobody_has_is_named(tmp_path, code, hint):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("CD")
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((10,))
        plist.set_filter(code, h5py.h5z.FLAG_OPTIONAL, ())  # else it could not even be written
        dtype = h5py.h5t.py_create(np.dtype([("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]))
        h5py.h5d.create(group.id, b"events", dtype, h5py.h5s.create_simple((10,)), dcpl=plist)
    with pytest.raises(ValueError, match=rf"its events are compressed by .*{hint}"):
        next(hdf5.read(str(tmp_path / "a.h5")))


@pytest.mark.parametrize("how", [{"compression": "gzip", "shuffle": True}, {"compression": "lzf"}])
def test_h5pys_own_filters_are_read(tmp_path, how):
    metavision(tmp_path / "a.h5", EVENTS, chunks=(777,), **how)
    assert_holds(tmp_path / "a.h5", EVENTS)


def test_a_wrong_checksum_is_damage_where_the_block_begins(tmp_path):
    """A block has several chunks: what is before the broken one is lost, too."""
    dsec(tmp_path / "dsec.h5", EVENTS, chunks=(1_000,), fletcher32=True)
    data = bytearray((tmp_path / "dsec.h5").read_bytes())
    place = data.find((EVENTS["x"][3_000:3_100]).astype("<u2").tobytes())
    assert place > 0
    data[place] ^= 1
    (tmp_path / "dsec.h5").write_bytes(data)
    got, caught = read_damaged(tmp_path / "dsec.h5")
    assert len(got) == 0 and "damaged recording: after event 0" in str(caught[0].message)


@pytest.mark.parametrize("chunks", [None, (1_000,)])
def test_a_header_that_claims_events_that_were_never_written_is_refused_at_once(tmp_path, chunks):
    """HDF5 makes zeros of them: events at t = 0, in a corner, for hours."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, dtype in (("t", "u4"), ("x", "u2"), ("y", "u2"), ("p", "u1")):
            file.create_dataset(f"events/{name}", (10**12 if chunks else 10**6,), dtype, chunks=chunks)
    with pytest.raises(ValueError, match=r"/events/t claims 10*0 events, but the file holds 0 of"):
        next(hdf5.read(str(path)))


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_file_cut_anywhere_is_refused(tmp_path, name):
    path = written(tmp_path / name, made_events(5))
    data = path.read_bytes()
    for size in range(0, len(data), 31):
        path.write_bytes(data[:size])
        with pytest.raises((OSError, RuntimeError)):
            next(hdf5.read(str(path)))


class Watched(FileIO):
    """A file that counts where reads begin."""

    def __init__(self, path):
        super().__init__(path)
        self.reads = Counter()

    def readinto(self, buffer):
        self.reads[self.tell()] += 1
        return super().readinto(buffer)


@pytest.mark.parametrize("chunks", [(5_000,) * 4, (5_000, 700, 3_333, 90), (64,) * 4, (100, 101, 5_000, 1)])
def test_each_chunk_is_read_once(tmp_path, monkeypatch, chunks):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, chunk in zip(SETS, chunks, strict=True):
            file.create_dataset(name, data=EVENTS[name[-1]], chunks=(chunk,), compression="gzip")
    with h5py.File(path) as file:
        ids = [file[name].id for name in SETS]
        places = [each.get_chunk_info(i).byte_offset for each in ids for i in range(each.get_num_chunks())]
    watched = Watched(path)
    real = h5py.File
    monkeypatch.setattr(h5py, "File", lambda path, mode: real(watched, mode, rdcc_nbytes=1))  # no chunk fits its cache
    monkeypatch.setattr(hdf5, "BLOCK_EVENTS", 100)
    assert_holds(path, EVENTS)
    watched.close()
    assert {watched.reads[place] for place in places} == {1}


def link_elsewhere(path, name, link):
    """Another file gets what was at `name`, and this one a link to it."""
    (path.parent / "other.h5").write_bytes(path.read_bytes())
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = link


def external_link(path, name):
    link_elsewhere(path, name, h5py.ExternalLink("other.h5", f"/{name}"))


def through_a_linked_group(path, name):
    link_elsewhere(path, name, h5py.SoftLink("/first"))
    with h5py.File(path, "r+") as file:
        file["first"] = h5py.SoftLink(f"group/{name}")
        file["group"] = h5py.ExternalLink("other.h5", "/")


def external_storage(path, name):
    with h5py.File(path, "r+") as file:
        values = np.atleast_1d(file[name][()])  # h5py keeps a single number in the file
        del file[name]
        raw = path.with_suffix(".raw")
        raw.write_bytes(values.tobytes())
        file.create_dataset(name, values.shape, values.dtype, external=[(str(raw), 0, values.nbytes)])


def virtual(path, name):
    with h5py.File(path, "r+") as file:
        layout = h5py.VirtualLayout(file[name].shape, file[name].dtype)
        layout[...] = h5py.VirtualSource("other.h5", name, file[name].shape)
    link_elsewhere(path, name, h5py.SoftLink("/virtual"))
    with h5py.File(path, "r+") as file:
        file.create_virtual_dataset("virtual", layout)


LINKS = (external_link, through_a_linked_group)
STORED = (external_storage, virtual)
ELSEWHERE = [
    *[(dsec, name, move) for name in ("events/t", "t_offset") for move in LINKS + STORED],
    *[(metavision, "CD/events", move) for move in LINKS + STORED],
    *[(dsec, "events", move) for move in LINKS],
    *[(metavision, "CD", move) for move in LINKS],
]


@pytest.mark.parametrize(("write", "name", "move"), ELSEWHERE)
def test_values_in_another_file_are_refused(tmp_path, write, name, move):
    path = tmp_path / "a.h5"
    write(path, EVENTS)
    move(path, name)
    with h5py.File(path) as file:
        assert name in file  # HDF5 itself would read it
    with pytest.raises(ValueError, match=r"^\S+ must be stored in the file itself, but "):
        next(hdf5.read(str(path)))


def test_links_within_the_file_are_followed(tmp_path):
    path = tmp_path / "a.h5"
    dsec(path, EVENTS)
    with h5py.File(path, "r+") as file:
        file.move("events", "recorded/left")
        file["events"] = h5py.SoftLink("/recorded/left")
        file.move("recorded/left/t", "recorded/left/times")
        file["recorded/left/t"] = h5py.SoftLink("times")
    assert_holds(path, EVENTS)
    with h5py.File(path, "r+") as file:
        del file["recorded/left/t"]
        file["recorded/left/t"] = h5py.SoftLink("t")
    with pytest.raises(ValueError, match="t is a link to a link to a link"):
        next(hdf5.read(str(path)))
