"""Recordings on disk -> recordings in memory -> windows."""

import numpy as np
import pytest

from async_tnt.events import EVENT_DTYPE
from async_tnt.sources.files.nmnist import write_nmnist
from async_tnt.training.digits import FIRST_INDEX, read_nmnist_folder, read_samples
from async_tnt.training.windows import Recordings, make_windows, split_recordings


def recording(times_us, x=5):
    events = np.zeros(len(times_us), EVENT_DTYPE)
    events["t"], events["x"], events["y"], events["p"] = times_us, x, 7, 1
    return events


def write_folder(folder, n=3):
    for digit in (0, 4):
        (folder / str(digit)).mkdir(parents=True)
        for k in range(n):
            write_nmnist(folder / str(digit) / f"{k:05d}.bin", recording([1_000 * k, 120_000], x=digit + k))
    return folder


def test_a_folder_is_read_in_order_with_its_labels(tmp_path):
    recordings = read_nmnist_folder(write_folder(tmp_path))
    assert recordings.names[:4] == ("0/00000.bin", "0/00001.bin", "0/00002.bin", "4/00000.bin")
    np.testing.assert_array_equal(recordings.labels, [0, 0, 0, 4, 4, 4])
    np.testing.assert_array_equal(recordings.offsets, [0, 2, 4, 6, 8, 10, 12])
    np.testing.assert_array_equal(recordings.x, np.repeat([0, 1, 2, 4, 5, 6], 2))
    np.testing.assert_array_equal(recordings.t[:4], [0, 120_000, 1_000, 120_000])
    assert len(read_nmnist_folder(tmp_path, per_digit=1)) == 2


def test_a_damaged_file_is_refused_by_name_or_left_out_by_name(tmp_path):
    folder = write_folder(tmp_path)
    with (folder / "4" / "00001.bin").open("ab") as file:
        file.write(b"\x01")
    with pytest.raises(ValueError, match=r"4/00001.bin: damaged .* --skip-damaged"):
        read_nmnist_folder(folder)
    with pytest.warns(UserWarning, match=r"left out: .*4/00001.bin"):
        recordings = read_nmnist_folder(folder, skip_damaged=True)
    assert "4/00001.bin" not in recordings.names and len(recordings) == 5
    np.testing.assert_array_equal(recordings.labels, [0, 0, 0, 4, 4])


def test_a_missing_or_empty_folder_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no folder .*nowhere.*<digit>/<number>.bin"):
        read_nmnist_folder(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="no recordings; expected N-MNIST's layout"):
        read_nmnist_folder(tmp_path)


def test_windows_from_zero_and_from_the_first_event():
    recordings = Recordings.from_events(
        [recording([2_000, 104_999, 105_000, 316_000]), recording([]), recording([212_000])], [1, 2, 3]
    )
    from_zero = make_windows(recordings, 105_000)
    np.testing.assert_array_equal(from_zero.recording, [0, 0, 2])  # none of 0's between 210 and 315 ms
    np.testing.assert_array_equal(from_zero.start_us, [0, 105_000, 210_000])
    np.testing.assert_array_equal(from_zero.labels, [1, 1, 3])
    from_first = make_windows(recordings, 105_000, first_event=True)
    np.testing.assert_array_equal(from_first.recording, [0, 0, 2])
    np.testing.assert_array_equal(from_first.start_us, [2_000, 212_000, 212_000])
    assert len(make_windows(recordings, 400_000, which=[0])) == 1


def test_recordings_add_up():
    first = Recordings.from_events([recording([1, 2]), recording([3])], [0, 1])
    second = Recordings.from_events([recording([4, 5, 6])], [2], ["last"])
    both = first + second
    np.testing.assert_array_equal(both.t, [1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(both.offsets, [0, 2, 3, 6])
    assert len(both) == 3 and both.names == ("0", "1", "last")


def test_times_must_be_in_order_and_short():
    with pytest.raises(ValueError, match=r"mine: times must be in order"):
        Recordings.from_events([recording([5, 4])], [0], ["mine"])
    with pytest.raises(ValueError, match=r"in \[0, 2\*\*31\) us, got 0 to 2147483648"):
        Recordings.from_events([recording([0, 1 << 31])], [0])


def test_a_split_is_by_recording_and_even_over_the_classes():
    labels = [0] * 40 + [1] * 20
    recordings = Recordings.from_events([recording([1])] * 60, labels)
    train, held_out = split_recordings(recordings, 0.25, np.random.default_rng(0))
    np.testing.assert_array_equal(np.sort(np.concatenate([train, held_out])), np.arange(60))
    np.testing.assert_array_equal(np.bincount(recordings.labels[held_out]), [10, 5])
    again = split_recordings(recordings, 0.25, np.random.default_rng(0))[1]
    np.testing.assert_array_equal(held_out, again)
    assert len(split_recordings(recordings, 0.0, np.random.default_rng(0))[1]) == 0
    with pytest.raises(ValueError, match=r"`fraction` must be in \[0, 1\), got 1"):
        split_recordings(recordings, 1, np.random.default_rng(0))


def test_the_samples_are_ten_digits_of_images_that_training_leaves_out():
    samples = read_samples()
    np.testing.assert_array_equal(samples.labels, range(10))
    assert len(make_windows(samples, 105_000)) == 30
    assert FIRST_INDEX == 5_000
