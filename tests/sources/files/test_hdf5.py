"""HDF5 files: layouts and compression.

Their events must be in the file itself, in chunks.
"""

import sys

import numpy as np
import pytest
from sources.files.written import dsec, made_events, metavision, rvt

from async_tnt.sources.files.library_readers import read_hdf5
from async_tnt.sources.files.recording import open_recording

h5py = pytest.importorskip("h5py", reason="HDF5 needs h5py")

EVENTS = made_events(5_000)


def read(path):
    """Columns t, x, y, p: what the reader yields in a worker process, here in this one."""
    _, *blocks = read_hdf5(str(path))
    return np.concatenate(blocks, axis=1)


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
        (
            {"x": np.zeros(4, "u2")},
            r"must have one dimension and equal lengths, got \[\(4,\), \(5,\)\]",
        ),
        ({"t": np.zeros(5)}, "must be whole numbers, got float64"),
        ({"x": np.zeros(5, bool)}, "must be whole numbers, got uint32, bool, uint16, uint8"),
        ({"t_offset": np.zeros(2, int)}, r"`t_offset` must be one number, got shape \(2,\)"),
        (
            {"t_offset": np.int64(-(1 << 62))},
            r"`t_offset` must be below 2\*\*62 microseconds, got -46",
        ),
        (None, r"expected events/t, x, y, p \(DSEC, RVT\) or CD/events .*, got \['data'\]"),
    ],
)
def test_another_layout_is_refused(tmp_path, values, message):
    if values is not None:
        replaced(tmp_path / "a.h5", **values)
    else:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            file["data"] = np.zeros(3)
    with pytest.raises(ValueError, match=message):
        next(read_hdf5(str(tmp_path / "a.h5")))


@pytest.mark.parametrize("offset_us", [1_000, -1_000, 1 << 61])
def test_times_beyond_64_bits_do_not_wrap_into_others(tmp_path, offset_us):
    """As int64 they are small negative numbers, which the offset would make times again."""
    t = np.array([2_000, 2_001, 2_002, (1 << 64) - 5, 2_003], "u8")
    path = replaced(tmp_path / "a.h5", t=t, t_offset=np.int64(offset_us))
    times = read(path)[0]
    assert times[3] < 0
    assert np.delete(times, 3).tolist() == [2_000 + offset_us + i for i in range(4)]


def test_a_polarity_may_be_bool_or_signed(tmp_path):
    for p in (np.array([0, 1, 1, 0, 1], bool), np.array([-1, 1, 1, -1, 1], "i1")):
        path = replaced(tmp_path / "a.h5", p=p)
        np.testing.assert_array_equal(read(path)[3], p)
        assert open_recording(path).read()["p"].tolist() == [0, 1, 1, 0, 1]


def test_a_file_that_was_opened_may_be_written_before_it_is_read(tmp_path):
    """HDF5 would let nobody write a file that a worker keeps open."""
    dsec(tmp_path / "a.h5", EVENTS)
    recording = open_recording(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["t_offset"][()] = 7
    assert recording.read()["t"].tolist() == (EVENTS["t"] - EVENTS["t"][0] + 7).tolist()


def test_the_missing_filter_of_metavision_is_named_with_its_plugin(tmp_path):
    path = tmp_path / "a.h5"
    dsec(path, EVENTS[:5])
    with h5py.File(path, "a") as file:
        del file["events/t"]
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((5,))
        plist.set_filter(0x8ECF, h5py.h5z.FLAG_OPTIONAL)
        space = h5py.h5s.create_simple((5,))
        h5py.h5d.create(file["events"].id, b"t", h5py.h5t.STD_U32LE, space, plist)
    with pytest.raises(ValueError, match=r"compressed by Prophesee's ECF: install its plugin"):
        next(read_hdf5(str(path)))


@pytest.mark.parametrize(("name", "code"), [("Blosc", 32001), ("Zstd", 32015)])
def test_hdf5plugins_filters_are_read_and_named_where_they_are_missing(
    tmp_path, monkeypatch, name, code
):
    hdf5plugin = pytest.importorskip("hdf5plugin", reason="Blosc needs hdf5plugin")
    path = tmp_path / "a.h5"
    metavision(path, EVENTS, chunks=(1_000,), **getattr(hdf5plugin, name)())
    assert path.stat().st_size < EVENTS.nbytes  # it was compressed, not left out as filters may be
    np.testing.assert_array_equal(read(path), [EVENTS[name] for name in "txyp"])
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    monkeypatch.setattr(h5py.h5z, "filter_avail", lambda code: code < 256)
    with pytest.raises(
        ValueError, match=rf"\(filter {code}\), which is missing: pip install hdf5plugin"
    ):
        next(read_hdf5(str(path)))


@pytest.mark.parametrize("chunks", [None, (1_000,)])
def test_a_header_that_claims_events_that_were_never_written_is_refused_at_once(tmp_path, chunks):
    """HDF5 makes zeros of them: events at t = 0, in a corner, for hours."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, dtype in (("t", "u4"), ("x", "u2"), ("y", "u2"), ("p", "u1")):
            file.create_dataset(
                f"events/{name}", (10**12 if chunks else 10**6,), dtype, chunks=chunks
            )
    with pytest.raises(ValueError, match=r"/events/t claims 10*0 events, but the file holds 0 of"):
        next(read_hdf5(str(path)))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_chunk_that_was_never_written_is_refused(tmp_path, missing):
    """There are three chunks, and the last one is filled in part: HDF5 reads zeros there."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name in "txyp":
            data = file.create_dataset(f"events/{name}", (2_500,), "u4", chunks=(1_000,))
            for chunk in {0, 1, 2} - {missing}:
                data[1_000 * chunk : 1_000 * (chunk + 1)] = 1
    message = "/events/t claims 2500 events, but the file holds 2 of their 3 chunks"
    with pytest.raises(ValueError, match=message):
        next(read_hdf5(str(path)))


@pytest.mark.parametrize(
    ("name", "how"),
    [
        *((name, "link") for name in ("events/t", "t_offset", "events")),
        ("events/t", "bytes"),
        ("events/t", "virtual"),
    ],
)
def test_values_in_another_file_are_refused(tmp_path, name, how):
    path = tmp_path / "a.h5"
    n = len(EVENTS)
    for each in (path, tmp_path / "other.h5"):
        dsec(each, EVENTS)
    with h5py.File(path, "r+") as file:
        del file[name]
        if how == "link":
            file[name] = h5py.ExternalLink("other.h5", f"/{name}")
        elif how == "bytes":
            (tmp_path / "t.raw").write_bytes(bytes(4 * n))
            file.create_dataset(name, (n,), "u4", external=[(str(tmp_path / "t.raw"), 0, 4 * n)])
        else:
            layout = h5py.VirtualLayout((n,), "u4")
            layout[...] = h5py.VirtualSource("other.h5", name, (n,))
            file.create_virtual_dataset(name, layout)
        assert name in file  # HDF5 itself would read it
    with pytest.raises(ValueError, match=r"^\S+ must be stored in the file itself, but "):
        next(read_hdf5(str(path)))


@pytest.mark.parametrize(
    "geometry, sensor", [("34x34", (34, 34)), (b"34x34", (34, 34)), ("0x0", None), ("wide", None)]
)
def test_only_a_geometry_with_pixels_is_a_sensor(tmp_path, geometry, sensor):
    metavision(tmp_path / "a.h5", EVENTS)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file.attrs["geometry"] = geometry
    assert next(read_hdf5(str(tmp_path / "a.h5"))) == sensor


@pytest.mark.parametrize(
    ("width", "message"),
    [
        (np.uint16(0), r"events/width and height must be in \[1, 65536\], got 0 and 240"),
        (np.int64(65_537), r"events/width and height must be in \[1, 65536\], got 65537 and 240"),
        (np.int64(-320), r"events/width and height must be in \[1, 65536\], got -320 and 240"),
        (np.float64(320), "/events/width must be one whole number, got "),
        (np.array([320, 240]), "/events/width must be one whole number, got "),
        (np.bytes_(b"320"), "/events/width must be one whole number, got "),
        ("a group", "/events/width must be one whole number, got "),
    ],
)
def test_a_width_that_is_none_is_refused(tmp_path, width, message):
    rvt(tmp_path / "a.h5", EVENTS)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["events/width"]
        if isinstance(width, str):
            file.create_group("events/width")
        else:
            file["events/width"] = width
    with pytest.raises(ValueError, match=message):
        next(read_hdf5(str(tmp_path / "a.h5")))


def test_one_side_alone_states_no_sensor(tmp_path):
    rvt(tmp_path / "a.h5", EVENTS)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        del file["events/height"]
    assert next(read_hdf5(str(tmp_path / "a.h5"))) is None


@pytest.mark.parametrize("dtype", ["i8", [("t", "i8"), ("x", "u2"), ("y", "u2"), ("on", "u1")]])
def test_records_of_other_fields_are_refused(tmp_path, dtype):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["CD/events"] = np.zeros(5, dtype)
    with pytest.raises(ValueError, match=r"CD/events must be records of t, x, y, p, got "):
        next(read_hdf5(str(tmp_path / "a.h5")))


def test_a_geometry_of_more_pixels_than_a_sensor_has_is_refused(tmp_path):
    for side in (65_536, 65_537):
        metavision(tmp_path / "a.h5", EVENTS, (34, side))
        head = read_hdf5(str(tmp_path / "a.h5"))
        if side == 65_536:
            assert next(head) == (34, 65_536)
            head.close()
            continue
        with pytest.raises(ValueError, match=r"^`geometry` must be in \[1, 65536\], got 34 and 6"):
            next(head)
