"""Recordings as `.npy` and `.npz`: their layouts, and headers that are accepted only as far as their bytes go."""

import tracemalloc
import warnings
import zipfile
from io import BytesIO

import numpy as np
import pytest
from recordings.written import columns_of, made_events, table_of

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files import numpy_files
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording
from async_tnt.sources.pixel_masks import load_mask

EVENTS = np.array([(10, 1, 2, 1), (20, 300, 4, 0), (20, 5, 6, 1)], EVENT_DTYPE)
COLUMNS = columns_of(EVENTS)
MANY = made_events(50)
FORMS = {
    "records": {"events": MANY},
    "table": {"events": table_of(MANY)},
    "table, column by column": {"events": np.asfortranarray(table_of(MANY))},
    "columns": columns_of(MANY),
}


def saved(path, *arrays, **named):
    if path.suffix == ".npy":
        np.save(path, *arrays)
    else:
        np.savez(path, *arrays, **named)
    return path


def renamed():
    other = np.empty(3, [("on", "?"), ("x", "i4"), ("timestamp", "u4"), ("y", "u1")])
    for mine, theirs in zip("txyp", ("timestamp", "x", "y", "on"), strict=True):
        other[theirs] = EVENTS[mine]
    return other


SIGNED = table_of(EVENTS)
SIGNED[:, 3] = 2 * SIGNED[:, 3] - 1


@pytest.mark.parametrize(
    "array", [EVENTS, renamed(), renamed().astype([("on", "i8"), ("x", ">u2"), ("ts", "i8"), ("y", "i1")]), SIGNED]
)
def test_npy_with_other_names_orders_and_types(tmp_path, array):
    recording = open_recording(saved(tmp_path / "a.npy", array))
    assert recording.sensor is None
    np.testing.assert_array_equal(recording.read(), EVENTS)


@pytest.mark.parametrize("off", [0, -1])
def test_polarity_is_written_one_way_in_all_blocks(tmp_path, monkeypatch, off):
    """The way is known from the first block that has an OFF, whatever lies between."""
    monkeypatch.setattr(numpy_files, "BLOCK_EVENTS", 4)
    table = np.ones((18, 4), np.int64)
    table[6, 3] = off
    path = saved(tmp_path / "a.npy", table)
    assert open_recording(path).n_events == 18
    table[14, 3] = -1 - off
    saved(path, table)
    with pytest.warns(DamagedRecording, match=f"event 14: p = {-1 - off}, and before it {off}: polarity is 0/1 or -1"):
        assert open_recording(path).n_events == 14


@pytest.mark.parametrize("arrays", [{"events": EVENTS}, {"anything": EVENTS}, COLUMNS])
def test_npz_with_and_without_a_sensor(tmp_path, arrays):
    unknown = open_recording(saved(tmp_path / "a.npz", **arrays))
    known = open_recording(saved(tmp_path / "b.npz", **arrays, sensor=np.array([346, 260])))
    assert unknown.sensor is None and known.sensor == (346, 260)
    np.testing.assert_array_equal(unknown.read(), EVENTS)
    np.testing.assert_array_equal(known.read(), EVENTS)


def test_empty_arrays_are_empty_recordings(tmp_path):
    assert open_recording(saved(tmp_path / "a.npy", EVENTS[:0])).n_events == 0
    assert open_recording(saved(tmp_path / "b.npy", np.zeros((0, 4), int))).n_events == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": np.array([1.0, 2.0, 3.0])}, "`t` must be integer microseconds, got float64"),
        ({"x": np.array([1, -1, 3])}, "event 1: t = 20, x = -1, y = 4, p = 0 is not a valid event"),
        ({"y": np.array([1, 2, 65536])}, "event 2: t = 20, x = 5, y = 65536, p = 1 is not a valid event"),
        ({"p": np.array([1, 2, 0])}, "event 1: t = 20, x = 300, y = 4, p = 2 is not a valid event"),
        ({"p": np.array([1, 2, 0], np.uint8)}, "event 1: t = 20, x = 300, y = 4, p = 2 is not a valid event"),
        ({"p": np.array([1, -1, 0])}, "event 2: p = 0, and before it -1: polarity is 0/1 or -1/\\+1, not both"),
        ({"t": np.array([1, 2])}, "must have equal lengths, got 2, 3, 3, 3"),
        (
            {"t": np.array([1, 2, 1 << 63], np.uint64)},
            "event 2: t = 9223372036854775808, x = 5, y = 6, p = 1 is not a valid event",
        ),
        (
            {"sensor": np.array([300, 260])},
            "event 1 at x = 300, y = 4 is off the 300 x 260 sensor",
        ),
        (
            {"sensor": np.array([346, 6])},
            "event 2 at x = 5, y = 6 is off the 346 x 6 sensor",
        ),
        ({"sensor": np.array([346.0, 260.0])}, "`sensor` must be two positive integers"),
        ({"sensor": np.array([0, 260])}, "`sensor` must be two positive integers"),
    ],
)
def test_columns_out_of_their_range_are_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        open_recording(saved(tmp_path / "a.npz", **(COLUMNS | change)))


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((3, 5), int), r"an \(N, 4\) array of those columns, got shape \(3, 5\) of int64"),
        (
            np.zeros(3, [("t", "i8"), ("x", "u2"), ("y", "u2")]),
            "need a field `p` .one of p, on, polarity, pol., got a structured array with fields t, x, y",
        ),
        (EVENTS.reshape(3, 1), r"must have one dimension, got shape \(3, 1\)"),
    ],
)
def test_other_layouts_are_refused(tmp_path, array, message):
    with pytest.raises(ValueError, match=message):
        open_recording(saved(tmp_path / "a.npy", array))


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"t": EVENTS["t"], "x": EVENTS["x"]}, r"`events`, or t, x, y and p; got \['t', 'x'\]"),
        (COLUMNS | {"ts": EVENTS["t"]}, "events need one field `t`, got t and ts in the archive; leave out all but"),
        ({"events": np.zeros(2, "V70000")}, r"events\.npy: an event must take at most 65536 bytes, got 70000"),
    ],
)
def test_other_archives_are_refused(tmp_path, arrays, message):
    with pytest.raises(ValueError, match=rf"a\.npz: .*{message}"):
        open_recording(saved(tmp_path / "a.npz", **arrays))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_unpacked_block_by_block_the_events_are_the_same(tmp_path, monkeypatch, form, save):
    save(tmp_path / "a.npz", **FORMS[form], sensor=np.array([320, 240]))
    monkeypatch.setattr(numpy_files, "BLOCK_EVENTS", 7)
    monkeypatch.setattr(numpy_files, "KEPT_EVENTS", 49)
    recording = open_recording(tmp_path / "a.npz")
    for _ in range(2):
        np.testing.assert_array_equal(recording.read(), MANY)
    assert recording.sensor == (320, 240)


@pytest.mark.parametrize("form", ["records", "table, column by column", "columns"])
def test_memory_does_not_grow_with_what_is_unpacked(tmp_path, monkeypatch, form):
    monkeypatch.setattr(numpy_files, "KEPT_EVENTS", 0)
    arrays = {name: np.zeros((20_000 * len(a), *a.shape[1:]), a.dtype, "F") for name, a in FORMS[form].items()}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    unpacked = sum(array.nbytes for array in arrays.values())
    del arrays
    tracemalloc.start()
    try:
        assert open_recording(tmp_path / "a.npz").n_events == 1_000_000
        assert tracemalloc.get_traced_memory()[1] < 9e6 < unpacked
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("form", FORMS)
def test_only_what_is_named_is_unpacked(tmp_path, monkeypatch, form):
    np.savez_compressed(tmp_path / "a.npz", **FORMS[form], sensor=np.array([320, 240]), frames=np.zeros(10**6))
    opened = set()
    open_member = zipfile.ZipFile.open
    monkeypatch.setattr(
        zipfile.ZipFile, "open", lambda archive, info: opened.add(info.filename) or open_member(archive, info)
    )
    np.testing.assert_array_equal(open_recording(tmp_path / "a.npz").read(), MANY)
    assert opened == {f"{name}.npy" for name in ("sensor", *FORMS[form])}


def test_a_name_that_is_there_twice_is_refused(tmp_path):
    path = saved(tmp_path / "a.npz", events=EVENTS)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("events.npy", b"")
    with pytest.raises(ValueError, match="the archive holds `events` twice"):
        open_recording(tmp_path / "a.npz")


def npy(shape, descr="'<i8'", padding=0):
    """A header, and eight bytes for an array."""
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}{' ' * padding}\n".encode()
    return b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text + bytes(8)


IMPOSSIBLE = {
    "a long header": npy((1,), padding=20_000),
    "a longer header than file": npy((1,), padding=20_000)[:500],
    "a header of 4 GiB": npy((1,))[:8] + b"\xff" * 4 + npy((1,))[12:],
    "2**62 numbers": npy((2**62,)),
    "2**61 numbers of 13 bytes": npy((2**61,), "[('t', '<i8'), ('x', '<u2'), ('y', '<u2'), ('p', '|u1')]"),
    "sides whose product overflows": npy((2**31, 2**31, 4)),
    "sides whose product overflows to the right size": npy((2**32, 2**32, 1)),
    "no numbers, but sides that overflow": npy((0, 2**40, 2**40)),
    "beyond int64": npy((2**64,)),
    "beyond what Python prints": npy(f"({'9' * 4000}, {'9' * 4000})"),
    "negative sides": npy((-1, -1)),
    "a hundred sides": npy((1,) * 100),
    "records of nothing": npy((2**62,), "'V0'"),
    "Python objects": npy((1,), "'O'"),
    "no literal": npy("(1,) if 1else (2,)"),
    "no type": npy((1,), "'?!'"),
}


@pytest.mark.parametrize("what", IMPOSSIBLE)
@pytest.mark.parametrize(
    ("name", "opened"), [("a.npy", open_recording), ("a.npz", open_recording), ("m.npy", load_mask)]
)
def test_an_impossible_header_is_refused_in_one_line_of_ours(tmp_path, what, name, opened):
    path = tmp_path / name
    if path.suffix == ".npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("events.npy", IMPOSSIBLE[what])
    else:
        path.write_bytes(IMPOSSIBLE[what])
    with warnings.catch_warnings(record=True) as warned, pytest.raises(ValueError) as raised:
        warnings.simplefilter("always")
        opened(path)
    assert not warned
    text = str(raised.value)
    assert text.startswith(f"{path}: not a readable NumPy file: ") and len(text) < len(str(path)) + 300
    assert "\n" not in text and "allow_pickle" not in text


def header_of(n):
    """A .npy header that claims n events."""
    out = BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": EVENT_DTYPE.descr, "fortran_order": False, "shape": (n,)})
    return out.getvalue()


@pytest.mark.parametrize("n", [10**6, 10**9, 10**12, 10**17, 10**30])
@pytest.mark.parametrize("name", ["a.npy", "stored.npz", "deflated.npz"])
def test_a_header_that_claims_too_much_takes_no_memory(tmp_path, name, n):
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


def test_an_archive_that_overstates_its_sizes_takes_no_memory(tmp_path):
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
def test_a_npy_of_another_size_than_it_claims_is_refused(tmp_path, n_lost):
    path = tmp_path / "a.npy"
    np.save(path, MANY)
    data = path.read_bytes()
    path.write_bytes(data[:-n_lost] if n_lost > 0 else data + bytes(-n_lost))
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy file"):
        open_recording(path)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_npy_is_read_up_to_an_invalid_event(tmp_path, order):
    """In the second block of 65,536."""
    table = np.zeros((70_000, 4), np.int64, order=order)
    table[:, 0] = np.arange(70_000)
    table[66_000, 1] = -3
    np.save(tmp_path / "a.npy", table)
    with pytest.warns(DamagedRecording, match="event 66000: t = 66000, x = -3, y = 0, p = 0 is not a valid event"):
        assert open_recording(tmp_path / "a.npy").read()["t"].tolist() == list(range(66_000))
    table[66_000, 1] = 3
    table[67_000, 3] = -1
    np.save(tmp_path / "a.npy", table)
    with pytest.warns(DamagedRecording, match=r"event 67000: p = -1, and before it 0: polarity is 0/1 or -1/\+1"):
        assert open_recording(tmp_path / "a.npy").n_events == 67_000
