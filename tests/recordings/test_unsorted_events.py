"""Events older than one before them: counted, and taken, dropped or refused."""

import numpy as np
import pytest
from recordings.written import csv, made_events

from async_tnt.sources.files.recording import open_recording

T_US = [10, 30, 20, 30, 29, 50, 40, 45, 60]
LATE = [2, 4, 6, 7]


@pytest.fixture(params=["a.csv", "a.npy"])
def path(request, tmp_path):
    events = made_events(len(T_US))
    events["t"] = T_US
    if request.param == "a.npy":
        np.save(tmp_path / "a.npy", events)
    else:
        (tmp_path / "a.csv").write_bytes(csv(events))
    return tmp_path / request.param


def test_accepted_and_counted(path):
    recording = open_recording(path)
    assert recording.read()["t"].tolist() == T_US
    assert (recording.n_unsorted, recording.n_events, recording.duration_us) == (4, 9, 50)


def test_dropped_and_counted(path):
    recording = open_recording(path, packet_events=2, unsorted="drop")
    assert np.concatenate(list(recording))["t"].tolist() == [10, 30, 30, 50, 60]
    assert (recording.n_unsorted, recording.n_events, len(recording)) == (4, 5, 3)


def test_refused(path):
    with pytest.raises(ValueError, match=r'got 20 after 30 us at event 2; unsorted="accept" takes such events'):
        open_recording(path, unsorted="raise").read()


def test_counted_across_blocks(tmp_path):
    events = made_events(100_000, step_us=3)
    events["t"][65_536] -= 1_000  # the first of a block
    events["t"][70_000:70_003] -= 500
    np.save(tmp_path / "a.npy", events)
    late = np.flatnonzero(events["t"][1:] < np.maximum.accumulate(events["t"])[:-1]) + 1
    recording = open_recording(tmp_path / "a.npy", unsorted="drop")
    np.testing.assert_array_equal(recording.read(), np.delete(events, late))
    assert recording.n_unsorted == len(late) >= 4


def test_unknown_policy(path):
    with pytest.raises(ValueError, match="`unsorted` must be one of accept, drop, raise, got 'sort'"):
        open_recording(path, unsorted="sort")
