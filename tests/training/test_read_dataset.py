"""Recordings of one sensor from class folders.

The tests say what the folders state, what is left out, and what is an error.
"""

import re
import shutil

import numpy as np
import pytest
from made import events_of
from training.gestures import bar, write, write_set

from async_tnt.sources.files.recording import READERS
from async_tnt.sources.pixels.pixels import Pixels
from async_tnt.training.data import dataset_data
from async_tnt.training.dataset import read_dataset
from async_tnt.training.held_out import Split
from async_tnt.training.volume_choice import VolumeChoice
from async_tnt.training.work import Work
from async_tnt.volume.config import TNTConfig

SIZE = (64, 64)
EVERYTHING = Pixels()


def write_64(folder, counts, **settings):
    return write_set(folder, counts, side=64, **settings)


def test_recordings_that_do_not_state_a_sensor_have_that_of_the_others(tmp_path):
    """This holds also for those that were read before the first one that states it."""
    write_64(tmp_path, {"upright": 3, "flat": 3}, suffixes=(".npy", ".csv", ".npz"))
    write(tmp_path / "flat" / "large.csv", events_of([5, 9, 9], [3, 64, 65], [1, 2, 2], [1, 1, 1]))
    for pixels in (EVERYTHING, Pixels(sensor=SIZE)):
        dataset = read_dataset(tmp_path, pixels=pixels)
        (line,) = dataset.left_out
        assert line.startswith(
            "flat/large.csv: 2 of 3 events lie off the 64 x 64 sensor; the first is event 1 at x ="
        )
        assert dataset.camera == dataset.sensor == SIZE
        assert len(dataset.recordings) == 6
    cropped = read_dataset(tmp_path, pixels=Pixels((0, 0, 60, 64), True))
    assert (cropped.camera, cropped.sensor) == (SIZE, (60, 64)) and cropped.recordings.x.max() < 60


def test_what_is_trained_on_is_not_tested_on(tmp_path):
    write_set(tmp_path / "Train", {"upright": 3, "flat": 3}, side=34)
    write_set(tmp_path / "Test", {"upright": 2, "flat": 2}, side=34, seed=1)
    (learned, *_) = sorted((tmp_path / "Train" / "flat").iterdir())
    shutil.copy(learned, tmp_path / "Test" / "flat" / f"again{learned.suffix}")
    data = dataset_data(tmp_path, TNTConfig(), split=Split(test=True))
    line = f"Test/flat/again{learned.suffix}: the same events as flat/{learned.name}"
    assert data.left_out == (line,) and len(data.tests["test"][0]) == 4
    shutil.move(
        tmp_path / "Test" / "flat" / f"again{learned.suffix}", tmp_path / "Test" / "upright"
    )
    with pytest.raises(ValueError, match="hold the same events but are in two classes"):
        dataset_data(tmp_path, TNTConfig(), split=Split(test=True))


def test_the_part_to_test_on_has_classes_that_were_learned_and_may_lack_some(tmp_path):
    write_64(tmp_path / "Train", {"upright": 2, "flat": 2})
    test = tmp_path / "Test"

    def tested():
        return dataset_data(tmp_path, TNTConfig(), split=Split(0, test=True))

    (test / "flat").mkdir(parents=True)
    with pytest.raises(ValueError, match=rf"{test}: no recordings in any class folder$"):
        tested()
    torn = write(test / "flat" / "torn.npy", bar("flat", 90, side=64))
    content = torn.read_bytes()
    torn.write_bytes(content[:-7])
    with pytest.raises(ValueError, match=r"no recording of class flat, upright is left; .*torn"):
        tested()
    events = bar("flat", 91, side=64)
    events["x"][40] = 300
    write(test / "flat" / "0.npz", events, sensor=SIZE)
    data = tested()
    assert set(data.tests["test"][0].labels) == {0}
    assert "events left out of Test: 1 off the sensor" in data.notes
    assert not any("left out of the recordings" in note for note in data.notes)
    write(test / "slanted" / "0.npy", bar("slanted", 92, side=64))
    with pytest.raises(ValueError, match=r"unknown class slanted; known are flat, upright$"):
        tested()


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
    (folder / "flat" / "gone.npy").symlink_to(tmp_path / "nowhere.npy")
    dataset = read_dataset(folder)
    expected = (
        "flat/gone.npy: No such file or directory.",
        "flat/silent.npz: no events",
        "flat/torn.npy: not a readable NumPy file: ",
        "flat/zz.npy: the same events as flat/00.npy",
        "upright/text.csv: damaged recording: line 3: ",
        "upright/what.raw: its first bytes are not those of a known format",
    )
    for line, start in zip(dataset.left_out, expected, strict=True):
        assert line.startswith(start) and str(tmp_path) not in line  # a model may be given away
    assert np.bincount(dataset.recordings.labels).tolist() == [4, 4]


@pytest.mark.parametrize(
    "error", [ValueError("torn at byte 9"), OSError("the disk is gone")], ids=repr
)
def test_a_recording_whose_reader_fails_is_left_out_by_name(error, tmp_path, monkeypatch):
    def read(path, options):
        raise error

    monkeypatch.setitem(READERS, ".own", read)
    folder = write_64(tmp_path / "set", {"upright": 4, "flat": 4})
    (folder / "flat" / "a.own").touch()
    dataset = read_dataset(folder)
    (line,) = dataset.left_out
    assert line.startswith("flat/a.own: ") and str(error) in line
    assert np.bincount(dataset.recordings.labels).tolist() == [4, 4]


def test_windows_counts_and_the_held_out(tmp_path):
    for k in range(5):
        write(
            tmp_path / "upright" / f"{k}.npz",
            bar("upright", k, duration_us=500_000, start_us=7_000_000_000),
        )
        write(tmp_path / "flat" / f"{k}.npz", bar("flat", k, duration_us=20_000))
    write(tmp_path / "single" / "0.npz", bar("slanted", 0))
    data = dataset_data(tmp_path, TNTConfig())
    # one of five is held out of each class: 4 x 5 windows of 105 ms and 4 partial ones, and the
    # single one
    assert (len(data.training), len(data.validation), data.config.sensor) == (25, 6, (128, 128))
    assert data.record["classes"] == {"flat": 5, "single": 1, "upright": 5}
    assert (
        "not held out, as there is only one short recording, picture or group: single" in data.notes
    )


def test_of_a_single_session_the_last_windows_are_held_out(tmp_path):
    """One window lies between both sides.

    The order is that of time, also where a session is cut into parts.
    """
    for k in range(4):
        write(tmp_path / "upright" / f"{k}.npz", bar("upright", k, duration_us=500_000))
    write(tmp_path / "flat" / "only.npz", bar("flat", 0, n=4_000, duration_us=2_000_000))
    data = dataset_data(tmp_path, TNTConfig(window_us=100_000))
    learned, held_out = [
        some.start_us[some.labels == 0] // 100_000 for some in (data.training, data.validation)
    ]
    assert learned.tolist() == list(range(15)) and held_out.tolist() == [16, 17, 18, 19]
    assert data.record["held_out_in_time"] == ["flat"] and len(data.validation) == 4 + 5
    (note,) = [line for line in data.notes if "the last windows of flat" in line]
    assert note.endswith("only another session tells more")
    (tmp_path / "flat" / "only.npz").rename(tmp_path / "flat" / "take9.npz")
    # of the same group, later
    write(tmp_path / "flat" / "take10.npz", bar("flat", 1, n=4_000, duration_us=2_000_000))
    split = Split(groups="flat|[0-3]")
    data = dataset_data(tmp_path, TNTConfig(window_us=100_000), split=split)
    names = data.training.recordings.names
    for some, windows in (
        (data.training, {"take9": 20, "take10": 11}),
        (data.validation, {"take10": 8}),
    ):
        of_flat = some.recording[some.labels == 0]
        assert {name: sum(name in names[r] for r in of_flat) for name in windows} == windows
        assert len(of_flat) == sum(windows.values())


@pytest.mark.parametrize(("events_a_pixel", "volume"), [(2, ("count", 1)), (3, ("volume", 5))])
def test_where_pixels_fire_often_the_default_volume_has_time_bins(tmp_path, events_a_pixel, volume):
    """Only events of one polarity in one window count as often."""
    n = 40 * events_a_pixel
    x = np.tile(np.arange(40), 3 * events_a_pixel)
    is_on = np.repeat([True, False, True], n)
    t = np.arange(3 * n) + np.repeat([0, 0, 100_000], n)
    for k, name in enumerate("aabb"):
        write(tmp_path / name / f"{k}.npz", events_of(t, x, np.full(3 * n, k), is_on))
    data = dataset_data(tmp_path, VolumeChoice.of(window_us=100_000))
    assert (
        data.config.representation,
        data.config.bins,
    ) == volume and data.config.polarity == "split"
    assert any("time bins, as an active pixel fires" in line for line in data.notes) == (
        volume[1] == 5
    )


def recording(times_us, pixels=None):
    return events_of(
        times_us,
        *([5] * len(times_us) if pixels is None else pixels for _ in "xy"),
        [1] * len(times_us),
    )


def test_what_differs_only_outside_of_the_region_or_is_late_is_left_out_by_event(tmp_path):
    """Events older than their recording's first one are late; the others are sorted.

    In files or in memory.
    """
    folder = tmp_path / "set"
    store = tmp_path / "store"
    store.mkdir()
    for k, name in enumerate("ab"):
        write(folder / name / "1.npz", recording([500, 520 + k, 510, 499]), sensor=SIZE)
        write(folder / name / "2.npz", recording([0, 10, 20 + k], [2, 5, 40 + k]), sensor=SIZE)
    pixels = Pixels(roi=(0, 0, 10, 10))
    held = read_dataset(folder, pixels=pixels)
    mapped = read_dataset(folder, pixels=pixels, work=Work(store))
    np.testing.assert_array_equal(held.recordings.t, [0, 10, 20, 0, 10, 0, 10, 21, 0, 10])
    assert (
        held.left_out == () and held.left_out_events == {"left_out_outside": 2} and held.n_late == 2
    )
    for name in ("t", "x", "y", "p", "offsets", "labels"):
        ours = getattr(mapped.recordings, name)
        theirs = getattr(held.recordings, name)
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype
    assert not list(store.iterdir())  # files without names, which nothing has to remove
    data = dataset_data(folder, TNTConfig(), pixels=pixels, split=Split(0))
    line = (
        "events left out of the recordings: 2 outside of the region, 2 older than the first one of "
        "their recording"
    )
    assert data.record["left_out_late"] == 2 and line in data.notes


REFUSED = [  # files and their sensors, what is refused, settings
    (
        {"flat/a.npz": SIZE, "up/b.npz": (80, 60)},
        "of one sensor, got 64x64 (flat/a.npz) and 80x60 (up/b.npz)",
        {},
    ),
    (
        {"flat/a.npz": (80, 60), "up/b.npz": SIZE},
        "`sensor` must be of the recordings' sensor, 80x60 (flat/a.npz), got 64x64",
        {"sensor": SIZE},
    ),
    (
        {"flat/a.csv": None, "up/b.csv": None},
        "set states its sensor (flat/a.csv needs at least ",
        {},
    ),
    ({"flat/a.bin": None, "up/b.bin": None}, "unless `sensor` says another", {}),
    (
        {"flat/a.npz": SIZE, "up/b.npz": SIZE},
        "flat/a.npz and up/b.npz hold the same events but are in two classes",
        {},
    ),
    ({"up/a.npz": SIZE, "up/b.npz": SIZE}, "there must be at least two class folders, got up", {}),
    (
        {"up/a.npz": SIZE, "flat/notes.md": None},
        "no recordings in the class folder flat; expected",
        {},
    ),
    ({"a.npz": SIZE}, "no class folders; expected set/<class name>/<recording>", {}),
]


@pytest.mark.parametrize(("files", "message", "settings"), REFUSED)
def test_a_folder_without_a_dataset_of_one_sensor_is_refused(files, message, settings, tmp_path):
    same = "the same events" in message
    for k, (name, sensor) in enumerate(files.items()):
        path = tmp_path / "set" / name
        if path.suffix == ".md":
            path.parent.mkdir(parents=True)
            path.touch()
        else:  # whatever time it begins at
            write(
                path, bar("flat", 0 if same else k, side=60, start_us=5_000_000 * k), sensor=sensor
            )
    with pytest.raises(ValueError, match=re.escape(message)):
        read_dataset(tmp_path / "set", pixels=Pixels(**settings))


def test_a_recording_longer_than_35_minutes_is_refused(tmp_path):
    for name in "ab":
        write(tmp_path / name / "1.npz", recording([0, 1 << 31]), sensor=SIZE)
    with pytest.raises(
        ValueError, match=r"a/1.npz: lasts 36 minutes, more than the 35 that training supports"
    ):
        read_dataset(tmp_path)


def test_a_recording_of_just_under_35_minutes_is_read(tmp_path):
    for name in "ab":
        write(tmp_path / name / "1.npz", recording([7, 7 + (1 << 31) - 1]), sensor=SIZE)
        write(tmp_path / name / "2.npz", recording([0, 1, ord(name)]), sensor=SIZE)
    with pytest.raises(ValueError, match="hold the same events but are in two classes"):
        read_dataset(tmp_path)
    (tmp_path / "b" / "1.npz").unlink()
    assert read_dataset(tmp_path).recordings.t.max() == (1 << 31) - 1


@pytest.mark.parametrize("column", ["t", "x", "y", "p"])
def test_recordings_that_differ_in_one_number_are_two(column, tmp_path):
    """In whichever column."""
    events = bar("flat", 0, side=60, n=50)
    other = events.copy()
    other[column][30] ^= 1
    for k, one in enumerate((events, other)):
        write(tmp_path / "flat" / f"{k}.npz", one, sensor=SIZE)
    write(tmp_path / "upright" / "0.npz", bar("upright", 0, side=60), sensor=SIZE)
    dataset = read_dataset(tmp_path)
    assert (len(dataset.recordings), dataset.left_out) == (3, ())


def test_late_events_are_sorted_and_those_of_one_time_keep_their_order(tmp_path):
    t = np.repeat(np.arange(100), 20)
    events = events_of(t, np.arange(2_000) % 64, np.arange(2_000) // 64, t % 2)
    late = np.concatenate([events[:1_000], events[1_500:], events[1_000:1_500]])
    write(tmp_path / "a" / "1.npz", late, sensor=SIZE)
    write(tmp_path / "b" / "1.npz", events[:900], sensor=SIZE)
    found = read_dataset(tmp_path).recordings
    for name in "txyp":
        np.testing.assert_array_equal(getattr(found, name)[:2_000], events[name])


def test_a_sensor_that_does_not_fit_is_named_by_what_states_it(tmp_path):
    """By a mask alone, or by the option; the sides that a recording needs are width and height."""
    for k, name in enumerate("ab"):
        write(tmp_path / name / "1.npz", events_of([1, 2], [5, 9], [k, 3], [1, 1]), sensor=(80, 60))
    mask = np.zeros((60, 70), bool)
    with pytest.raises(ValueError, match=r"^`mask` must be of the recordings' sensor, 80x60 "):
        read_dataset(tmp_path, pixels=Pixels(mask=mask))
    with pytest.raises(ValueError, match=r"^`sensor` must be of the recordings' sensor, 80x60 "):
        read_dataset(tmp_path, pixels=Pixels(mask=mask, sensor=(70, 60)))
    for k, name in enumerate("ab"):
        (tmp_path / name / "1.npz").unlink()
        x = np.repeat(np.arange(50), 4)
        y = np.repeat(np.arange(20), 10)
        write(tmp_path / name / "1.npy", events_of(np.arange(200) + k, x, y, x % 2))
    with pytest.raises(ValueError, match=r"\(a/1.npy needs at least 50x20\)"):
        read_dataset(tmp_path)


def test_a_class_of_which_nothing_is_left_is_told_with_its_own_reasons(tmp_path):
    for name in ("a/1.npz", "b/1.npz", "b/2.npz", "b/3.npz"):
        path = write(tmp_path / name, recording([1, 2]), sensor=SIZE)
        path.write_bytes(b"torn")
    write(tmp_path / "a" / "2.npz", recording([1, 3]), sensor=SIZE)
    message = r"no recording of class b is left; .*\(left out: b/1.npz: .*; and 2 more\)$"
    with pytest.raises(ValueError, match=message):
        read_dataset(tmp_path)


def test_windows_of_a_fitted_length_hold_the_last_event_of_the_longest_recording(tmp_path):
    """At 20,000 us since the first one: windows of 20 ms would end before it."""
    for k, name in enumerate("ab"):
        write(tmp_path / name / "1.npz", recording([5, 90 + k, 20_005 - 300 * k]), sensor=SIZE)
    data = dataset_data(tmp_path, VolumeChoice.of(), split=Split(0))
    assert data.config.window_us == 21_000 and len(data.training) == 2
    assert "windows of 21000 us, as no recording is longer" in data.notes


def test_the_record_and_the_notes_count_what_is_learned_and_what_is_held_out(tmp_path):
    for k in range(10):
        write(tmp_path / "a" / f"{k}.npz", recording([1, 2, 3 + k]), sensor=SIZE)
        write(tmp_path / "b" / f"{k}.npz", recording([1, 2, 50 + k]), sensor=SIZE)
    strayed = events_of([1, *range(60, 2_000)], [5] * 1_941, [5] * 1_941, [1] * 1_941)
    strayed["x"][7] = 3_000
    write(tmp_path / "a" / "10.npz", strayed, sensor=SIZE)
    data = dataset_data(tmp_path, TNTConfig(), split=Split(0.3))
    record = data.record
    assert (record["real_recordings"], record["held_out_recordings"]) == (15, 6)
    assert (record["left_out_off_sensor"], record["sensor"]) == (1, [64, 64])
    assert record["source"].endswith("held out by number, the last ones")
    assert set(data.held_out) == SIX_LAST
    assert "recordings: a 11, b 10" in data.notes
    assert "held out by number, the last ones: 6 of 21 recordings" in data.notes
    assert "events left out of the recordings: 1 off the sensor" in data.notes
    assert any("may follow the last learned ones within seconds" in note for note in data.notes)
    data = dataset_data(tmp_path, TNTConfig(), split=Split(0))
    assert (data.record["real_recordings"], data.record["held_out_recordings"]) == (21, 0)
    assert len(data.validation) == 0 and len(data.notes) == 3


SIX_LAST = {"a/8.npz", "a/9.npz", "a/10.npz", "b/7.npz", "b/8.npz", "b/9.npz"}
"""The three recordings with the highest numbers, of eleven and of ten numbered recordings."""


def test_masked_pixels_are_those_of_the_sensor_that_is_left(tmp_path):
    """In the coordinates of the region that it is cut to, for motions that are made again."""
    for k, name in enumerate("ab"):
        write(tmp_path / name / "1.npz", recording([1, 2 + k], [12]), sensor=SIZE)
    mask = np.zeros((64, 64), bool)
    mask[13, 31] = True
    mask[60, 60] = True
    for pixels, shape, masked in (
        (Pixels(), None, None),
        (Pixels(mask=mask), (64, 64), [(13, 31), (60, 60)]),
        (Pixels((30, 11, 20, 30), True, mask), (30, 20), [(2, 1)]),
        # a region that is not cropped: the sensor is still the camera
        (Pixels((30, 11, 20, 30), False, mask), (64, 64), [(13, 31), (60, 60)]),
    ):
        if pixels.roi is not None:
            for k, name in enumerate("ab"):
                write(tmp_path / name / "1.npz", recording([1, 2 + k], [35]), sensor=SIZE)
        found = dataset_data(tmp_path, TNTConfig(), pixels=pixels, split=Split(0)).masked
        if masked is None:
            assert found is None
        else:
            assert found.shape == shape and list(zip(*np.nonzero(found), strict=True)) == masked


def test_nanoseconds_read_as_microseconds_are_warned_of_before_they_are_learned(tmp_path):
    for k, name in enumerate("ab"):
        t = np.arange(60) * 1_000_000
        write(tmp_path / name / "1.npz", events_of(t, t % 60, t % (7 + k), t % 2), sensor=SIZE)
    with pytest.warns(UserWarning, match="divide nanoseconds by 1000"):
        dataset_data(tmp_path, TNTConfig(), split=Split(0))


def test_who_was_seen_in_training_is_not_held_out(tmp_path):
    """Groups are found by a pattern. Where nothing is known, each recording is a group."""
    files = [f"{kind}/{'abcde'[k % 5]}{k}.npz" for kind in ("upright", "flat") for k in range(10)]
    for k, name in enumerate(files):
        write(tmp_path / name, bar("flat", k, n=50))

    def held_out_by(n_groups, **how):
        data = dataset_data(tmp_path, TNTConfig(), split=Split(**how))
        names = data.training.recordings.names
        train, held_out = [
            {names[r].split("/")[1][0] for r in windows.recording}
            for windows in (data.training, data.validation)
        ]
        assert not n_groups or (len(held_out) == n_groups and not train & held_out)
        return data.record["source"].removeprefix("recordings of own classes, held out by ")

    assert held_out_by(0) == "recording"
    assert held_out_by(1, groups="/(.)") == "group (/(.))"
    for share in (1, -0.1):
        with pytest.raises(ValueError, match=rf"`validation` must be in \[0, 1\), got {share}"):
            held_out_by(0, validation=share)
    # the seed decides which ones
    sides = {dataset_data(tmp_path, TNTConfig(), split=Split(seed=k)).held_out for k in range(4)}
    assert len(sides) > 1
