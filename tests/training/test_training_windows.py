"""Recordings in memory -> windows, split by recording."""

from dataclasses import replace

import numpy as np
import pytest
from made import events_of

from async_tnt.training.recordings import BOX_DTYPE, COLUMNS, Recordings, RecordingsWriter
from async_tnt.training.windows import make_windows


def recording(times_us):
    return events_of(times_us, *(np.full(len(times_us), value) for value in (5, 7, 1)))


def test_windows_from_zero_and_from_the_first_event():
    times = [[2_000, 104_999, 105_000, 316_000], [], [212_000]]
    recordings = Recordings.from_events(map(recording, times), [1, 2, 3])
    from_zero = make_windows(recordings, 105_000, duration_us=315_000)
    # none of 0's between 210 and 315 ms
    np.testing.assert_array_equal(from_zero.recording, [0, 0, 2])
    np.testing.assert_array_equal(from_zero.start_us, [0, 105_000, 210_000])
    np.testing.assert_array_equal(from_zero.labels, [1, 1, 3])
    from_first = make_windows(recordings, 105_000, first_event=True, duration_us=315_000)
    np.testing.assert_array_equal(from_first.recording, [0, 0, 2])
    np.testing.assert_array_equal(from_first.start_us, [2_000, 212_000, 212_000])
    assert len(make_windows(recordings, 400_000, which=[0], duration_us=315_000)) == 1


def test_windows_without_a_duration_reach_to_the_last_event():
    events = [recording([3, 102, 103, 2_000_000_003]), recording([50]), recording([])]
    windows = make_windows(Recordings.from_events(events, [0, 1, 1]), 100, first_event=True)
    np.testing.assert_array_equal(windows.recording, [0, 0, 0, 1])
    np.testing.assert_array_equal(windows.start_us, [3, 103, 2_000_000_003, 50])


def test_the_last_window_reaches_the_end_of_what_a_column_of_times_holds():
    """Times have 32 bits with a sign, and the window's end is beyond the last one."""
    last_us = (1 << 31) - 1
    windows = make_windows(Recordings.from_events([recording([0, last_us])], [0]), 100_000)
    assert windows.start_us.tolist() == [0, last_us // 100_000 * 100_000]
    for k, since_us in ((0, 0), (1, last_us % 100_000)):
        t, x, y, p = windows.events(k, 100_000, (50_000, 50_000))
        assert t.tolist() == [since_us]
        assert (x.tolist(), y.tolist(), p.tolist()) == ([5], [7], [1])


def test_times_that_a_column_does_not_hold_are_refused():
    """The first time after the last one that it holds would become a negative one."""
    for last_us in (1 << 31, 1 << 32):
        with pytest.raises(ValueError, match=rf"^one: times must be in order .* 0 to {last_us}$"):
            Recordings.from_events([recording([0, last_us])], [0], ["one"])


@pytest.mark.parametrize("times_us", [[-1, 5], [3, 9, 8, 20]], ids=str)
def test_times_before_the_start_or_out_of_order_are_refused(times_us):
    rule = r"^one: times must be in order and in \[0, 2\*\*31\) us, got "
    with RecordingsWriter() as writer, pytest.raises(ValueError, match=rule):
        writer.add(recording(times_us), 0, "one")


def test_recordings_in_memory_have_a_label_and_a_name_each():
    with pytest.raises(ValueError, match=r"^`labels` must have one per recording, got 2 for 1$"):
        Recordings.from_events([recording([1])] * 2, [0, 1], ["one"])
    assert Recordings.from_events([recording([1])] * 2, [0, 1]).names == ("0", "1")


@pytest.mark.parametrize("is_mapped", [False, True])
def test_recordings_that_are_appended_in_blocks_stay_as_they_are(is_mapped, monkeypatch, tmp_path):
    """Also those without an event, in memory and in files."""
    monkeypatch.setattr("async_tnt.training.recordings.BLOCK", 3)
    made = Recordings.from_events(map(recording, [[1, 2, 3, 4], [], [5, 6, 7]]), [2, 0, 1])
    folder = tmp_path if is_mapped else None
    with RecordingsWriter(folder) as writer:
        writer.extend(made)
        writer.add(recording([9]), 5, "last")
        found = writer.finish()
    assert found.t.tolist() == [1, 2, 3, 4, 5, 6, 7, 9]
    assert found.offsets.tolist() == [0, 4, 4, 7, 8]
    assert (found.labels.tolist(), found.names) == ([2, 0, 1, 5], ("0", "1", "2", "last"))
    with RecordingsWriter(folder) as writer:
        writer.extend(Recordings.from_events([recording([])], [4]))
        empty = writer.finish()
    assert len(empty) == 1 and len(empty.t) == 0 and empty.t.dtype == np.int32


def test_recordings_are_added_as_if_they_had_been_made_together():
    times = [[1, 2, 3], [], [4], [5, 6]]
    names = ["a", "b", "c", "d"]
    first, second = (
        Recordings.from_events(map(recording, times[part]), [2, 0, 1, 2][part], names[part])
        for part in (slice(3), slice(3, None))
    )
    whole = Recordings.from_events(map(recording, times), [2, 0, 1, 2], names)
    added = first + second
    assert added.names == whole.names
    for name in (*COLUMNS, "offsets", "labels"):
        np.testing.assert_array_equal(getattr(added, name), getattr(whole, name))


@pytest.mark.parametrize("known", ["boxes", "outlines"])
@pytest.mark.parametrize("sides", [(True, False), (False, True), (True, True)])
def test_recordings_with_boxes_or_outlines_are_not_added(known, sides):
    """Whichever side has them: they would be lost, or belong to other recordings."""
    plain = Recordings.from_events([recording([1])], [0])
    if known == "boxes":
        with_them = replace(plain, boxes=np.zeros(1, BOX_DTYPE))
    else:
        outlines = np.zeros((1, 2, 4, 2), np.float32)
        with_them = replace(plain, outlines=outlines, outlined_us=np.array([9]))
    first, second = (with_them if has_them else plain for has_them in sides)
    with pytest.raises(ValueError, match=f"^recordings with {known} cannot be added$"):
        first + second


def test_recordings_with_boxes_are_not_appended():
    plain = Recordings.from_events([recording([1])], [0])
    with RecordingsWriter() as writer:
        with pytest.raises(ValueError, match=r"^recordings with boxes cannot be added$"):
            writer.extend(replace(plain, boxes=np.zeros(1, BOX_DTYPE)))
        writer.extend(plain)
        assert len(writer.finish()) == 1


def test_boxes_are_those_of_each_recording_that_is_asked_for():
    boxes = np.zeros(5, BOX_DTYPE)
    boxes["recording"] = [0, 0, 2, 2, 2]
    boxes["label"] = range(5)
    made = Recordings.from_events(map(recording, [[1], [2], [3]]), [0, 0, 2])
    places, found = replace(made, boxes=boxes).boxes_of(np.array([2, 1, 0, 2]))
    assert places.tolist() == [0, 0, 0, 2, 2, 3, 3, 3]
    assert found["label"].tolist() == [2, 3, 4, 0, 1, 2, 3, 4]


def test_windows_that_are_cut_out_keep_their_events_classes_and_names():
    """Each on a recording of its own, with what is in the margins around it."""
    times = [[0, 40, 99, 100, 149, 150, 260], [5], [120]]
    recordings = Recordings.from_events(map(recording, times), [2, 1, 0], ["a", "b", "c"])
    windows = make_windows(recordings, 100)[[4, 1, 0]]
    cut = windows.cut(100, margin_us=50)
    assert cut.recordings.names == ("c", "a", "a")
    assert cut.labels.tolist() == [0, 2, 2] and cut.recording.tolist() == [0, 1, 2]
    assert np.diff(cut.recordings.offsets).tolist() == [1, 4, 5]
    around = [[20], [-1, 0, 49, 50], [0, 40, 99, 100, 149]]
    for k, expected in enumerate(around):
        for windows_of_them in (windows, cut):
            assert windows_of_them.events(k, 100, (50, 50))[0].tolist() == expected
            inside = [t for t in expected if 0 <= t < 100]
            assert windows_of_them.events(k, 100)[0].tolist() == inside


def test_events_of_a_pixel_are_a_mean_over_pixels_and_a_median_over_windows():
    """Each polarity counts by itself: a pixel that fires ON and OFF counts twice."""
    rows = [
        *[(t, 1, 1, t % 2) for t in range(4)],  # two ON, two OFF
        *[(100 + t, 1, 1, 1) for t in range(5)],  # 5 at a pixel and 1 at another: 3
        (105, 2, 1, 1),
        *[(200 + t, 1, 1, 1) for t in range(90)],
    ]
    windows = make_windows(Recordings.from_events([events_of(*np.array(rows).T)], [0]), 100)
    assert [windows[k : k + 1].events_a_pixel(100) for k in range(3)] == [2, 3, 90]
    assert windows.events_a_pixel(100) == 3
    assert windows[:0].events_a_pixel(100) == 0
