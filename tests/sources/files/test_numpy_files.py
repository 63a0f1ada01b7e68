"""Recordings as `.npy` and `.npz`, and their layouts.

A header is accepted only as far as its bytes go.
"""

import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest
from made import random_events
from sources.files.written import columns_of

from async_tnt.sources.files import numpy_files
from async_tnt.sources.files.off_sensor import EventsOffSensor
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording
from async_tnt.sources.pixels.pixel_masks import load_mask
from async_tnt.volume.events import EVENT_DTYPE

EVENTS = np.array([(10, 1, 2, 1), (20, 300, 4, 0), (20, 5, 6, 1)], EVENT_DTYPE)
COLUMNS = columns_of(EVENTS)


def saved(path, arrays):
    """`arrays` : one, or a dict for a `.npz`."""
    np.savez(path, **arrays) if path.suffix == ".npz" else np.save(path, arrays)
    return path


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_tables_of_either_order_are_read_the_same(tmp_path, suffix, order):
    """Rows one after the other, or columns, as NumPy saves what is written in either way."""
    events = random_events(50, seed=1)
    table = np.array([events[name] for name in "txyp"], np.int64).T.copy(order)
    path = saved(tmp_path / f"a{suffix}", {"events": table} if suffix == ".npz" else table)
    np.testing.assert_array_equal(open_recording(path).read(), events)


@pytest.mark.parametrize("off", [0, -1])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_npy_is_read_up_to_an_event_that_is_invalid_or_of_another_polarity(
    tmp_path, monkeypatch, off, order
):
    """How OFF is written is known from the first block that has one, whatever lies between."""
    monkeypatch.setattr(numpy_files, "BLOCK_EVENTS", 4)
    table = np.ones((18, 4), np.int64, order=order)
    table[6, 3] = off
    assert open_recording(saved(tmp_path / "a.npy", table)).n_events == 18
    for column, value, problem in (
        (3, -1 - off, f"p = {-1 - off}, and before it {off}: polarity is 0/1 or -1"),
        (0, -3, "t = -3, x = 1, y = 1, p = 1 is not a valid event"),
    ):
        damaged = table.copy(order)
        damaged[14, column] = value
        with pytest.warns(DamagedRecording, match=f"event 14: {problem}"):
            assert open_recording(saved(tmp_path / "a.npy", damaged)).n_events == 14
    dated = np.zeros(18, [("t", "M8[ms]"), ("x", "<u2"), ("y", "<u2"), ("p", "?")])
    dated["t"][14] = "NaT"
    with pytest.warns(
        DamagedRecording, match="a.npy: .*after 12 events: `t` must be a time, got NaT at event 2"
    ):
        assert open_recording(saved(tmp_path / "a.npy", dated)).n_events == 12


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        (
            COLUMNS | {"t": np.array([1.0, 2.0, 3.0])},
            "`t` must be integer microseconds, got float64",
        ),
        (
            COLUMNS | {"t": np.array([1, -1, 3])},
            "event 1: t = -1, x = 300, y = 4, p = 0 is not a valid event",
        ),
        (COLUMNS | {"t": np.array([1, 2])}, "must have equal lengths, got 2, 3, 3, 3"),
        (
            COLUMNS | {"sensor": np.array([0, 260])},
            r"its array 'sensor' must be two integers .* got \[0, 260\]",
        ),
        (
            COLUMNS | {"sensor": np.array([260, 2**40])},
            r"its array 'sensor' must be two integers .* in \[1, 65536\], got \[260",
        ),
        *(
            (COLUMNS | {"sensor": sensor}, rf"two integers .*, got shape \({shape}\) of {dtype}$")
            for sensor, shape, dtype in (
                (np.array([34.0, 34.0]), "2,", "float64"),
                (np.array([34, 34, 34]), "3,", "int64"),
                (np.array(34), "", "int64"),
            )
        ),
        (COLUMNS | {"x": np.zeros((3, 1), np.uint16)}, "`x` must"),
        (np.array(5), r"an \(N, 4\) array of those columns, got shape \(\) of int64"),
        ({"t": EVENTS["t"], "x": EVENTS["x"]}, r"`events`, or t, x, y and p; got \['t', 'x'\]"),
        (np.zeros((5, 4)), "`t` must be integer microseconds, got float64"),
        (EVENTS.astype([("t", "i8"), ("x", "U5"), ("y", "u2"), ("p", "u1")]), "`x` must be whole"),
        (np.zeros((3, 5), int), r"an \(N, 4\) array of those columns, got shape \(3, 5\) of int64"),
        (
            np.array([[5, 4, 100, 1], [4, 5, 200, 0]]),
            "the columns are not 'txyp'; they look like 'xytp'",
        ),
        (
            EVENTS[["t", "x", "y"]],
            "need a field `p` .one of p, on, polarity, pol., got a structured array with fields",
        ),
    ],
)
def test_other_layouts_and_values_out_of_range_are_refused(tmp_path, arrays, message):
    path = tmp_path / ("a.npz" if isinstance(arrays, dict) else "a.npy")
    with pytest.raises(ValueError, match=rf"{path.name}: .*{message}"):
        open_recording(saved(path, arrays))


def npy(shape, descr="'<i8'", padding=0):
    """A header, and eight bytes for an array."""
    text = (
        f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}{' ' * padding}\n".encode()
    )
    return b"\x93NUMPY\x02\x00" + len(text).to_bytes(4, "little") + text + bytes(8)


IMPOSSIBLE = {
    "a long header": npy((1,), padding=20_000),
    "a header of 4 GiB": npy((1,))[:8] + b"\xff" * 4 + npy((1,))[12:],
    "more bytes than numbers": npy((1,)) + b"more",
    "2**62 numbers": npy((2**62,)),
    "sides whose product overflows to the right size": npy((2**32, 2**32, 1)),
    "beyond what Python prints": npy(f"({'9' * 4000}, {'9' * 4000})"),
    "records of nothing": npy((2**62,), "'V0'"),
    "an array in each place": npy((1,), "('<i8', (1,))"),
    "Python objects": npy((1,), "'O'"),
    "no literal": npy("(1,) if 1else (2,)"),
}


@pytest.mark.parametrize(
    ("name", "what"),
    [
        *(("a.npy", what) for what in IMPOSSIBLE),
        ("a.npz", "2**62 numbers"),
        ("mask.npy", "a header of 4 GiB"),
    ],
)
def test_an_impossible_header_takes_no_memory_and_is_refused_in_one_line_of_ours(
    tmp_path, name, what
):
    path = tmp_path / name
    if name == "a.npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("events.npy", IMPOSSIBLE[what])
    else:
        path.write_bytes(IMPOSSIBLE[what])
    tracemalloc.start()
    try:
        with warnings.catch_warnings(record=True) as warned, pytest.raises(ValueError) as raised:
            warnings.simplefilter("always")
            (load_mask if name == "mask.npy" else open_recording)(path)
        assert tracemalloc.get_traced_memory()[1] < 5e6
    finally:
        tracemalloc.stop()
    assert not warned
    text = str(raised.value)
    assert text.startswith(f"{path}: not a ") and "not a readable NumPy file: " in text
    assert len(text) < len(str(path)) + 300
    assert "\n" not in text and "allow_pickle" not in text


def test_an_archive_that_overstates_its_sizes_takes_no_memory(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    data = npy((10**8,), EVENT_DTYPE.descr)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("events.npy", data)
    archive = bytearray(path.read_bytes())
    place = archive.rindex(b"PK\x01\x02") + 24  # the central directory: size when unpacked
    archive[place : place + 4] = (len(data) - 8 + 10**8 * EVENT_DTYPE.itemsize).to_bytes(
        4, "little"
    )
    path.write_bytes(archive)
    with pytest.raises(
        ValueError,
        match=r"a\.npz: not a readable NumPy file: events\.npy ends before its array does$",
    ):
        open_recording(path)
    monkeypatch.setattr(numpy_files, "MAX_NPZ_BYTES", 1 << 20)
    with pytest.raises(
        ValueError, match=r"events\.npy takes 1,300,000,\d+ bytes; more than 1,048,576 can be read"
    ):
        open_recording(path)


def test_events_are_read_and_other_arrays_are_not(tmp_path):
    others = {"labels": np.zeros(3), "t": np.zeros(5), "objects": np.array([None])}
    path = tmp_path / "a.npz"
    np.savez(path, events=EVENTS, **others, allow_pickle=True)
    np.testing.assert_array_equal(open_recording(path).read(), EVENTS)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_array_that_is_there_twice_is_refused(tmp_path):
    path = saved(tmp_path / "a.npz", {"events": EVENTS})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("events.npy", npy((1,)))
    with pytest.raises(ValueError, match="holds the array 'events' more than once; leave out all"):
        open_recording(path)


def test_the_largest_array_of_an_archive(tmp_path, monkeypatch):
    path = saved(tmp_path / "a.npz", {"events": EVENTS})
    n_bytes = zipfile.ZipFile(path).getinfo("events.npy").file_size
    monkeypatch.setattr(numpy_files, "MAX_NPZ_BYTES", n_bytes)
    assert open_recording(path).n_events == 3
    monkeypatch.setattr(numpy_files, "MAX_NPZ_BYTES", n_bytes - 1)
    with pytest.raises(ValueError, match=f"events.npy takes {n_bytes} bytes; more than "):
        open_recording(path)


def test_the_last_time_that_is_valid(tmp_path):
    table = np.array([[5, 1, 2, 1], [(1 << 62) - 1, 1, 2, 1], [1 << 62, 1, 2, 1]])
    with pytest.warns(DamagedRecording, match="event 2: t = 4611686018427387904, .* not a valid"):
        times = open_recording(saved(tmp_path / "a.npy", table)).read()["t"]
    assert times.tolist() == [5, (1 << 62) - 1]


@pytest.mark.parametrize(
    ("dtype", "pixel", "told"),
    [
        ("<u4", (1 << 32) - 1, (1 << 32) - 1),
        ("<i4", -1, -1),
        ("<i8", 1 << 16, 1 << 16),
        ("<u8", (1 << 64) - 1, 1 << 62),  # as int64 it would be -1
    ],
)
@pytest.mark.parametrize("other", ["u1", "<u2", "<i4", "<u8"])
def test_a_pixel_beyond_16_bits_is_off_every_sensor_whatever_the_types(
    tmp_path, dtype, pixel, told, other
):
    for names, where in (("xy", f"x = {told}, y = 3"), ("yx", f"x = 3, y = {told}")):
        types = [("t", "<i8"), (names[0], dtype), (names[1], other), ("p", "u1")]
        records = np.full(3, 1, types)
        records[1] = (1, pixel, 3, 1)
        with pytest.warns(EventsOffSensor, match=f"it is event 1 at {where}; it is left out"):
            assert open_recording(saved(tmp_path / "a.npy", records)).n_events == 2
