"""What a `.npz` or `.npy` claims is believed only as far as its bytes go, and only what is named is read."""

import tracemalloc
import warnings
import zipfile

import numpy as np
import pytest
from recordings.written import made_events

from async_tnt.sources.files import numpy_files
from async_tnt.sources.files.recording import open_recording
from async_tnt.sources.pixel_masks import load_mask

EVENTS = made_events(50)
TABLE = np.stack([EVENTS[name].astype(np.int64) for name in "txyp"], axis=1)
FORMS = {
    "records": {"events": EVENTS},
    "table": {"events": TABLE},
    "table, column by column": {"events": np.asfortranarray(TABLE)},
    "columns": {name: EVENTS[name] for name in "txyp"},
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_unpacked_block_by_block_the_events_are_the_same(tmp_path, monkeypatch, form, save):
    save(tmp_path / "a.npz", **FORMS[form], sensor=np.array([320, 240]))
    monkeypatch.setattr(numpy_files, "BLOCK_EVENTS", 7)
    monkeypatch.setattr(numpy_files, "KEPT_EVENTS", 49)
    recording = open_recording(tmp_path / "a.npz")
    for _ in range(2):
        np.testing.assert_array_equal(recording.read(), EVENTS)
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
    np.testing.assert_array_equal(open_recording(tmp_path / "a.npz").read(), EVENTS)
    assert opened == {f"{name}.npy" for name in ("sensor", *FORMS[form])}


def test_a_column_under_two_names_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", **FORMS["columns"], ts=EVENTS["t"])
    with pytest.raises(ValueError, match="events need one field `t`, got t and ts in the archive; leave out all but"):
        open_recording(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", events=EVENTS)
    with zipfile.ZipFile(tmp_path / "b.npz", "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("events.npy", b"")
    with pytest.raises(ValueError, match="the archive holds `events` twice"):
        open_recording(tmp_path / "b.npz")


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
    with warnings.catch_warnings(record=True) as warned, pytest.raises(ValueError) as told:
        warnings.simplefilter("always")
        opened(path)
    assert not warned
    text = str(told.value)
    assert text.startswith(f"{path}: not a readable NumPy file: ") and len(text) < len(str(path)) + 300
    assert "\n" not in text and "allow_pickle" not in text
