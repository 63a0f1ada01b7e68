"""Recordings as `.npy` and `.npz`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files import numpy_files
from async_tnt.sources.files.damage import DamagedRecording
from async_tnt.sources.files.recording import open_recording

EVENTS = np.array([(10, 1, 2, 1), (20, 300, 4, 0), (20, 5, 6, 1)], EVENT_DTYPE)
COLUMNS = {name: EVENTS[name] for name in "txyp"}


def saved(path, *arrays, **named):
    if path.suffix == ".npy":
        np.save(path, *arrays)
    else:
        np.savez(path, *arrays, **named)
    return path


def test_structured_npy(tmp_path):
    recording = open_recording(saved(tmp_path / "a.npy", EVENTS))
    assert recording.sensor is None
    np.testing.assert_array_equal(recording.read(), EVENTS)


@pytest.mark.parametrize("polarity", ["?", "u1", "i8"])
def test_structured_npy_with_other_names_orders_and_types(tmp_path, polarity):
    other = np.empty(3, [("on", polarity), ("x", "i4"), ("timestamp", "u4"), ("y", "u1")])
    for mine, theirs in zip("txyp", ("timestamp", "x", "y", "on"), strict=True):
        other[theirs] = EVENTS[mine]
    np.testing.assert_array_equal(open_recording(saved(tmp_path / "a.npy", other)).read(), EVENTS)


@pytest.mark.parametrize("signed", [False, True])
def test_npy_of_four_columns(tmp_path, signed):
    table = np.stack([EVENTS[name].astype(np.int64) for name in "txyp"], axis=1)
    if signed:
        table[:, 3] = 2 * table[:, 3] - 1
    np.testing.assert_array_equal(open_recording(saved(tmp_path / "a.npy", table)).read(), EVENTS)


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
    ("change", "complaint"),
    [
        ({"t": np.array([1.0, 2.0, 3.0])}, "`t` must be integer microseconds, got float64"),
        ({"x": np.array([1, -1, 3])}, "event 1: t = 20, x = -1, y = 4, p = 0 is no event"),
        ({"y": np.array([1, 2, 65536])}, "event 2: t = 20, x = 5, y = 65536, p = 1 is no event"),
        ({"p": np.array([1, 2, 0])}, "event 1: t = 20, x = 300, y = 4, p = 2 is no event"),
        ({"p": np.array([1, 2, 0], np.uint8)}, "event 1: t = 20, x = 300, y = 4, p = 2 is no event"),
        ({"p": np.array([1, -1, 0])}, "event 2: p = 0, and before it -1: polarity is 0/1 or -1/\\+1, not both"),
        ({"t": np.array([1, 2])}, "must have equal lengths, got 2, 3, 3, 3"),
        (
            {"t": np.array([1, 2, 1 << 63], np.uint64)},
            "event 2: t = 9223372036854775808, x = 5, y = 6, p = 1 is no event",
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
def test_columns_out_of_their_range_are_refused(tmp_path, change, complaint):
    with pytest.raises(ValueError, match=complaint):
        open_recording(saved(tmp_path / "a.npz", **(COLUMNS | change)))


@pytest.mark.parametrize(
    ("array", "complaint"),
    [
        (np.zeros((3, 5), int), r"an \(N, 4\) array of those columns, got shape \(3, 5\) of int64"),
        (
            np.zeros(3, [("t", "i8"), ("x", "u2"), ("y", "u2")]),
            "need a field `p` .one of p, on, polarity, pol., got a structured array with fields t, x, y",
        ),
        (EVENTS.reshape(3, 1), r"must have one dimension, got shape \(3, 1\)"),
    ],
)
def test_other_layouts_are_refused(tmp_path, array, complaint):
    with pytest.raises(ValueError, match=complaint):
        open_recording(saved(tmp_path / "a.npy", array))


def test_npz_without_events_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"`events`, or t, x, y and p; got \['t', 'x'\]"):
        open_recording(saved(tmp_path / "a.npz", t=EVENTS["t"], x=EVENTS["x"]))


def test_one_kind_of_file_under_the_other_suffix_is_refused(tmp_path):
    saved(tmp_path / "a.npz", events=EVENTS).rename(tmp_path / "a.npy")
    saved(tmp_path / "b.npy", EVENTS).rename(tmp_path / "b.npz")
    with pytest.raises(ValueError, match=r"a\.npy: .*got a zip archive; rename it to \.npz"):
        open_recording(tmp_path / "a.npy")
    with pytest.raises(ValueError, match=r"b\.npz: .*got a single \.npy array"):
        open_recording(tmp_path / "b.npz")


def test_nothing_is_unpickled(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{"t": 1}], object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy file"):
        open_recording(tmp_path / "a.npy")


@settings(max_examples=150, deadline=None)
@given(suffix=st.sampled_from([".npy", ".npz"]), data=st.data())
def test_damage_gives_an_error_that_names_the_file_or_valid_events(tmp_path_factory, suffix, data):
    path = tmp_path_factory.getbasetemp() / f"fuzz{suffix}"
    raw = bytearray(saved(path, EVENTS).read_bytes())
    if data.draw(st.booleans()):
        del raw[data.draw(st.integers(0, len(raw) - 1)) :]
    else:
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw)
    try:
        events = open_recording(path, strict=True).read()
    except ValueError as error:
        assert path.name in str(error)
    else:
        assert events.dtype == EVENT_DTYPE and (events["p"] <= 1).all()
