"""Class folders -> recordings of one sensor: what they state, what is left out, and what is an error."""

import re
import shutil

import numpy as np
import pytest
from made import events_of
from training.gestures import bar, write, write_set

from async_tnt.config import TNTConfig
from async_tnt.sources.pixel_selection import PixelSelection
from async_tnt.training.data import dataset_data
from async_tnt.training.dataset import read_dataset
from async_tnt.training.recordings import RecordingsWriter

SIZE = (64, 64)
EVERYTHING = PixelSelection()


def write_64(folder, counts, **settings):
    return write_set(folder, counts, side=64, **settings)


@pytest.mark.parametrize(("sensor", "source"), [(None, "flat/00.npz"), (SIZE, "`sensor`")])
def test_recordings_of_two_sensors_are_an_error_that_names_both(sensor, source, tmp_path):
    write_64(tmp_path, {"upright": 3, "flat": 3}, suffixes=(".npz",))
    write(tmp_path / "flat" / "99.npz", bar("flat", 77, side=30), sensor=(80, 60))
    message = f"all recordings must be of one sensor, got 64x64 ({source}) and 80x60 (flat/99.npz)"
    with pytest.raises(ValueError, match=re.escape(message)):
        read_dataset(tmp_path, pixels=PixelSelection(sensor=sensor))


def test_recordings_that_do_not_state_a_sensor_have_that_of_the_others(tmp_path):
    """Also those that were read before the first one that states it."""
    write_64(tmp_path, {"upright": 3, "flat": 3}, suffixes=(".npy", ".csv", ".npz"))
    write(tmp_path / "flat" / "large.csv", events_of([5, 9], [3, 64], [1, 2], [1, 1]))
    for pixels in (EVERYTHING, PixelSelection(sensor=SIZE)):
        dataset = read_dataset(tmp_path, pixels=pixels)
        line = "flat/large.csv: every event must lie on the 64x64 sensor, got x = 64 at event 1."
        assert dataset.left_out == (line,) and dataset.camera == dataset.sensor == SIZE
        assert len(dataset.recordings) == 6
    cropped = read_dataset(tmp_path, pixels=PixelSelection((0, 0, 60, 64), True))
    assert (cropped.camera, cropped.sensor) == (SIZE, (60, 64)) and cropped.recordings.x.max() < 60


def test_a_sensor_that_nothing_states_is_asked_for(tmp_path):
    write_64(tmp_path, {"upright": 2, "flat": 2}, suffixes=(".csv",))
    asked = r"no recording states its sensor; give `sensor` \(flat/00.csv needs at least \d+x\d+\)"
    with pytest.raises(ValueError, match=asked):
        read_dataset(tmp_path, pixels=PixelSelection(roi=(0, 0, 9, 9)))
    mask = np.zeros(SIZE[::-1], bool)
    assert read_dataset(tmp_path, pixels=PixelSelection(mask=mask)).camera == SIZE


def test_what_is_trained_on_is_not_tested_on(tmp_path):
    write_set(tmp_path / "Train", {"upright": 3, "flat": 3}, side=34)
    write_set(tmp_path / "Test", {"upright": 2, "flat": 2}, side=34, seed=1)
    (learned, *_) = sorted((tmp_path / "Train" / "flat").iterdir())
    shutil.copy(learned, tmp_path / "Test" / "flat" / f"again{learned.suffix}")
    data = dataset_data(tmp_path, TNTConfig(), pixels=EVERYTHING, test=True)
    line = f"Test/flat/again{learned.suffix}: the same events as flat/{learned.name}"
    assert data.left_out == (line,) and len(data.tests["test"][0]) == 4
    shutil.move(tmp_path / "Test" / "flat" / f"again{learned.suffix}", tmp_path / "Test" / "upright")
    with pytest.raises(ValueError, match="hold the same events but are in two classes"):
        dataset_data(tmp_path, TNTConfig(), pixels=EVERYTHING, test=True)


def test_a_bin_is_of_34_pixels_without_the_option(tmp_path):
    write_set(tmp_path / "small", {"upright": 4, "flat": 4}, suffixes=(".bin", ".npy", ".npz", ".csv"), side=34)
    assert read_dataset(tmp_path / "small").camera == (34, 34)
    write_64(tmp_path / "large", {"upright": 2, "flat": 2}, suffixes=(".bin",))
    dataset = read_dataset(tmp_path / "large", pixels=PixelSelection(sensor=SIZE))
    assert dataset.camera == SIZE and dataset.left_out == () and len(dataset.recordings) == 4
    with pytest.raises(ValueError, match="or say its sensor if it is of another camera"):
        read_dataset(tmp_path / "large")


def test_the_same_recording_in_two_classes_is_an_error(tmp_path):
    """Whatever its file and the time it begins at; but not recordings that differ only outside of the region."""

    def recorded(far, start_us=0):
        return events_of([start_us, start_us + 10, start_us + 20], [2, 5, far], [2, 5, far], [1, 0, 1])

    for name, far in (("a/0", 40), ("b/0", 42)):
        write(tmp_path / f"{name}.npz", recorded(far), sensor=SIZE)
    dataset = read_dataset(tmp_path, pixels=PixelSelection(roi=(0, 0, 10, 10)))
    assert dataset.left_out == () and dataset.left_out_events == {"left_out_outside": 2}
    write(tmp_path / "a" / "wrong.npy", recorded(42, start_us=5_000_000))
    with pytest.raises(ValueError, match=r"a/wrong\.npy and b/0\.npz hold the same events but are in two classes"):
        read_dataset(tmp_path)


def test_events_older_than_the_first_are_left_out_and_the_others_sorted(tmp_path):
    def recording(times_us):
        return events_of(times_us, *(np.full(len(times_us), value) for value in (5, 7, 1)))

    for k, name in enumerate("ab"):
        write(tmp_path / name / "1.npz", recording([500, 520 + k, 510, 499]), sensor=(9, 9))
    dataset = read_dataset(tmp_path)
    np.testing.assert_array_equal(dataset.recordings.t, [0, 10, 20, 0, 10, 21])
    assert dataset.n_late == 2
    data = dataset_data(tmp_path, TNTConfig(sensor=(9, 9), grid=(9, 9)), pixels=PixelSelection(), validation=0)
    assert data.record["left_out_late"] == 2
    assert "events left out of the recordings: 2 older than the first one of their recording" in data.notes
    assert dataset.sensor == (9, 9) and dataset.recordings.names == ("a/1.npz", "b/1.npz")
    write(tmp_path / "b" / "2.npz", recording([0, 1 << 31]), sensor=(9, 9))
    with pytest.raises(ValueError, match=r"b/2.npz: lasts 36 minutes, more than the 35 that training supports"):
        read_dataset(tmp_path)


def test_what_cannot_be_read_is_left_out_by_name(tmp_path):
    folder = write_64(tmp_path / "set", {"upright": 4, "flat": 4})
    good = np.load(folder / "flat" / "00.npy")
    (folder / "flat" / "torn.npy").write_bytes((folder / "flat" / "00.npy").read_bytes()[:-7])
    write(folder / "flat" / "silent.npz", good[:0])
    write(folder / "flat" / "zz.npy", good)
    (folder / "flat" / "notes.md").write_text("no recording")
    (folder / ".cache").mkdir()
    (folder / "upright" / "text.csv").write_text("t,x,y,p\n1,2,3,1\n2,3,words,0\n")
    (folder / "upright" / "what.raw").write_bytes(b"no recording")
    dataset = read_dataset(folder)
    expected = (
        "flat/silent.npz: no events",
        "flat/torn.npy: not a readable NumPy file: ",
        "flat/zz.npy: the same events as flat/00.npy",
        "upright/text.csv: damaged recording: line 3: ",
        "upright/what.raw: its first bytes are not those of a known format",
    )
    for line, start in zip(dataset.left_out, expected, strict=True):
        assert line.startswith(start) and str(tmp_path) not in line  # a model may be given away
    assert np.bincount(dataset.recordings.labels).tolist() == [4, 4]


def test_events_in_a_folder_are_the_same_as_in_memory(tmp_path):
    """They are mapped from files without names, which nothing has to remove."""
    folder = write_64(tmp_path / "set", {"upright": 4, "flat": 4})
    store = tmp_path / "store"
    store.mkdir()
    mapped, held = read_dataset(folder, store=store).recordings, read_dataset(folder).recordings
    for name in ("t", "x", "y", "p", "offsets", "labels"):
        ours, theirs = getattr(mapped, name), getattr(held, name)
        np.testing.assert_array_equal(ours, theirs)
        assert type(ours) is np.ndarray and ours.dtype == theirs.dtype
    assert mapped.names == held.names and not list(store.iterdir())
    with RecordingsWriter(store) as writer:
        assert len(writer.finish()) == 0  # an empty file cannot be mapped


def test_windows_counts_and_the_held_out(tmp_path):
    for k in range(5):
        write(tmp_path / "upright" / f"{k}.npz", bar("upright", k, duration_us=500_000, start_us=7_000_000_000))
        write(tmp_path / "flat" / f"{k}.npz", bar("flat", k, duration_us=20_000))
    write(tmp_path / "single" / "0.npz", bar("slanted", 0))
    data = dataset_data(tmp_path, TNTConfig(), pixels=EVERYTHING)
    # one of five is held out of each class: 4 x 5 windows of 105 ms and 4 partial ones, and the single one
    assert (len(data.training), len(data.validation), data.config.sensor) == (25, 6, (128, 128))
    assert data.record["classes"] == {"flat": 5, "single": 1, "upright": 5}
    assert "not held out, as there is only one recording, or one group of them: single" in data.notes


def test_who_was_seen_in_training_is_not_held_out(tmp_path):
    """By a pattern, by a table; and by recording where nothing is known."""
    rows = ["recording,group"]
    for kind in ("upright", "flat"):
        for k in range(10):
            write(tmp_path / kind / f"{'abcde'[k % 5]}{k}.npz", bar(kind, k, n=50))
            rows.append(f"{kind}/{'abcde'[k % 5]}{k}.npz,{'abcde'[k % 5]}")

    def held_out_by(**how):
        data = dataset_data(tmp_path, TNTConfig(), pixels=EVERYTHING, **how)
        names = data.training.recordings.names
        sides = [{names[r].split("/")[1][0] for r in windows.recording} for windows in (data.training, data.validation)]
        return data.record["source"].removeprefix("recordings of own classes, held out by "), sides

    assert held_out_by()[0] == "recording"
    by_pattern = held_out_by(groups="/(.)")
    (tmp_path / "groups.csv").write_text("\n".join(rows))
    for (how, (train, held_out)), expected in ((by_pattern, "group (/(.))"), (held_out_by(), "group (groups.csv)")):
        assert how == expected and len(held_out) == 1 and not train & held_out


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (["upright/a.npy", "upright/b.npy"], "there must be at least two class folders, got upright"),
        (["upright/a.npy", "flat/a.npy", "slanted/notes.md"], "no recordings in the class folder slanted; expected"),
        (["a.npy"], "no class folders; expected set/<class name>/<recording>"),
    ],
)
def test_a_folder_without_a_dataset_is_refused(files, message, tmp_path):
    for path in (tmp_path / "set" / name for name in files):
        write(path.with_suffix(".npy"), bar("flat", len(path.name))).rename(path)
    with pytest.raises(ValueError, match=re.escape(message)):
        read_dataset(tmp_path / "set")
