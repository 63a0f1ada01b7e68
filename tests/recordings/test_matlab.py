"""MATLAB files: which variables are events, and what cannot be."""

import numpy as np
import pytest
from recordings.written import made_events

from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.files.source import DamagedRecording

io = pytest.importorskip("scipy.io", reason="MATLAB files need SciPy")
EVENTS = made_events(5)
COLUMNS = {name: EVENTS[name].astype(float) for name in "txyp"}


def test_doubles_of_any_shape_of_a_vector_and_minus_one_for_off(tmp_path):
    p = 2 * EVENTS["p"].astype(float) - 1
    vectors = COLUMNS | {"x": COLUMNS["x"][None], "y": COLUMNS["y"][:, None], "p": p, "other": np.eye(3)}
    io.savemat(tmp_path / "a.mat", vectors)
    np.testing.assert_array_equal(open_recording(tmp_path / "a.mat").read(), EVENTS)


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"t": 1, "x": 2}, r"expected x, y, t or ts, p or pol, .*; got t \(int64\), x \(int64\)"),
        ({"a": {"x": 1}, "b": {"x": 1}}, r".* fields of one structure; got a \(struct\), b \(struct\)"),
        (COLUMNS | {"ts": [1]}, "events need one of t and ts, got both"),
        (COLUMNS | {"y": np.zeros(4)}, r"t, x, y, p must have equal lengths, got \[5, 5, 4, 5\]"),
        (COLUMNS | {"y": np.zeros((5, 2))}, r"y must be a vector of numbers, got float64 of shape \(5, 2\)"),
        (COLUMNS | {"x": "word"}, "x must be a vector of numbers, got <U4"),
    ],
)
def test_other_variables_are_refused(tmp_path, variables, message):
    io.savemat(tmp_path / "a.mat", variables)
    with pytest.raises(ValueError, match=f"a.mat: not a readable MATLAB file: {message}"):
        open_recording(tmp_path / "a.mat")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.5, "after event 3: t must be whole numbers, got 0.5"),
        (np.nan, "after event 3: t must be whole numbers, got nan"),
        (1e300, r"event 3: t = -46\d+, x = "),
        (-3.0, "event 3: t = -3, x = "),
    ],
)
def test_times_that_cannot_be_are_damage(tmp_path, value, message):
    io.savemat(tmp_path / "a.mat", COLUMNS | {"t": np.array([*EVENTS["t"][:3], value, 9e5])})
    with pytest.warns(DamagedRecording, match=message):
        np.testing.assert_array_equal(open_recording(tmp_path / "a.mat").read(), EVENTS[:3])


def test_an_empty_array_of_version_7_3_has_no_events(tmp_path):
    """MATLAB writes its dimensions in the place of values."""
    h5py = pytest.importorskip("h5py", reason="MATLAB 7.3 files need h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name in ("t", "x", "y", "p"):
            file[name] = np.zeros(2, np.uint64)
            file[name].attrs["MATLAB_empty"] = np.uint8(1)
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert open_recording(tmp_path / "a.mat").n_events == 0


@pytest.mark.parametrize("place", [0, 1 << 16])
def test_damage_at_the_beginning_of_a_block_is_not_the_end_of_the_file(tmp_path, place):
    events = made_events(70_000)
    columns = {name: events[name].astype(float) for name in "txyp"}
    columns["t"][place] += 0.5
    io.savemat(tmp_path / "a.mat", columns)
    io.savemat(tmp_path / "next.mat", COLUMNS)
    with pytest.warns(DamagedRecording, match=f"after event {place}: t must be whole numbers"):
        assert open_recording(tmp_path / "a.mat").n_events == place
    np.testing.assert_array_equal(open_recording(tmp_path / "next.mat").read(), EVENTS)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_that_is_cut_off_is_called_so(tmp_path, compressed):
    io.savemat(tmp_path / "a.mat", COLUMNS, do_compression=compressed)
    data = (tmp_path / "a.mat").read_bytes()
    for n_missing in (1, len(data) // 3):
        (tmp_path / "a.mat").write_bytes(data[:-n_missing])
        with pytest.raises(ValueError, match="it is cut off: a variable's last"):
            open_recording(tmp_path / "a.mat")


def test_polarity_is_of_one_kind(tmp_path):
    io.savemat(tmp_path / "a.mat", {"x": [1, 2, 3], "y": [1, 2, 3], "t": [5, 6, 7], "p": [0, 1, -1]})
    with pytest.warns(DamagedRecording, match="event 2: p = -1, and before it 0: polarity is 0/1 or"):
        assert open_recording(tmp_path / "a.mat").n_events == 2
