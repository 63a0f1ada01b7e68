"""Times that a cable garbled: left out and counted; what a camera may send stays."""

from itertools import islice

import numpy as np
import pytest
from cameras.made_devices import RECORD, PlayedDevice, drivers, found, made_events
from hypothesis import given, settings
from hypothesis import strategies as st

import async_tnt
from async_tnt.sources.camera_opening import open_camera
from async_tnt.sources.clock import RESTART_US
from async_tnt.sources.files.recording import open_recording, sample_recordings
from async_tnt.sources.garbled_times import LATEST_US, SILENCE_US, without_garbled_times

SIGNED = np.dtype({"names": ["timestamp", "x"], "formats": ["<i8", "<i2"], "offsets": [0, 8], "itemsize": 16})
S = 1_000_000


def kept_of(times, newest_us=None, dtype=RECORD):
    events = np.zeros(len(times), dtype)
    events[dtype.names[0]] = times
    kept = without_garbled_times(events, dtype.names[0], newest_us)
    return kept[dtype.names[0]].tolist(), kept is events


def decided(packets):
    """What a processor decides of a camera's packets, and what both counted."""
    device = PlayedDevice([packet.copy() for packet in packets])
    processor = async_tnt.Processor(async_tnt.load_model("digits"))
    with open_camera(drivers=drivers(found(device))) as camera:
        decisions = [decision for packet in islice(camera, len(packets)) for decision in processor.push(packet)]
    decisions += processor.finish()
    said = [(decision.label, decision.time_us, decision.logits.tobytes()) for decision in decisions]
    return said, camera.counts, processor.counts


@pytest.mark.parametrize("bit", [30, 40, 52, 53, 62, 63])
@pytest.mark.parametrize("number", [0, 3, 19])
@pytest.mark.parametrize("place", [0, 10, -1])
def test_one_garbled_time_costs_its_event_and_no_more(number, place, bit):
    """In the first packet, a middle one and the last, wherever in it, and whichever bit flipped."""
    ours = open_recording(sample_recordings()[3]).read()
    events = np.empty(len(ours), RECORD)
    for field, name in (("t", "t"), ("x", "x"), ("y", "y"), ("on", "p")):
        events[field] = ours[name]
    packets = np.array_split(events, 20)
    without = list(packets)
    without[number] = np.delete(packets[number], place)
    packets[number]["t"][place] |= np.uint64(1 << bit)
    expected, _, _ = decided(without)
    said, camera, processor = decided(packets)
    assert said == expected and len(said) == 3
    assert (camera.garbled_times, camera.clock_restarts) == (1, 0)
    assert camera.events == processor.received == len(events) - 1


def test_counted_and_told():
    packets = [made_events([1, 1 << 63]), made_events([1 << 60]), made_events([3])]
    with open_camera(drivers=drivers(found(PlayedDevice([*packets, RuntimeError()])))) as camera:
        assert next(iter(camera))["t"].tolist() == [1]
        assert next(iter(camera)) is packets[2]
        assert camera.counts.packets == 2  # the packet between had no other event
        assert camera.summary() == "2 packets, 2 events (garbled times: 2, lost: unknown)"


@pytest.mark.parametrize(
    ("newest_us", "times", "kept"),
    [
        (None, [5 * S, 9 * S, 5 * S], [5 * S, 5 * S]),
        (None, [90 * S, 5 * S, 5 * S], [5 * S, 5 * S]),
        (None, [5 * S, 5 * S, 90 * S], [5 * S, 5 * S]),
        (5 * S, [90 * S, 5 * S], [5 * S]),
        (5 * S, [90 * S, 92 * S, 5 * S, 6 * S], [5 * S, 6 * S]),
        (90 * S, [90 * S, 200 * S, 3, 4, 5], [90 * S, 3, 4, 5]),  # and the clock restarts
        (None, [5 * S, LATEST_US, LATEST_US - 1], [5 * S]),
        (None, [LATEST_US], []),
        (LATEST_US - 5, [LATEST_US - 4, LATEST_US], [LATEST_US - 4]),
    ],
)
def test_left_out(newest_us, times, kept):
    assert kept_of(times, newest_us) == (kept, False)
    assert kept_of(times, newest_us, SIGNED) == (kept, False)


def test_below_zero_is_no_time():
    assert kept_of([5, -1, 7], 4, SIGNED) == ([5, 7], False)
    assert kept_of([5, -(1 << 63), 7], None, SIGNED) == ([5, 7], False)


@pytest.mark.parametrize(
    ("newest_us", "times"),
    [
        (None, [5 * S, 5 * S + RESTART_US, 5 * S]),  # just the limit
        (5 * S, [6 * S, 5 * S]),
        (5 * S, [3600 * S]),  # a long silence between packets
        (5 * S, [3600 * S, 3600 * S - 1, 3601 * S]),
        (None, [5 * S, 5 * S, 5 * S + SILENCE_US]),  # and within one
        (5 * S, [5 * S, 10 * S, 30 * S]),
        (90 * S, [90 * S, 90 * S + 5, 3, 4, 5, 6]),  # the clock restarts
        (None, [LATEST_US - 1]),
    ],
)
def test_kept_uncopied(newest_us, times):
    assert kept_of(times, newest_us) == (times, True)
    assert kept_of(times, newest_us, SIGNED) == (times, True)


def test_after_a_restart_the_new_times_are_what_counts():
    """The clock has shifted them by hours: a time in between is garbled all the same."""
    packets = [made_events([7200 * S]), made_events([10, 20]), made_events([30, 3600 * S, 40])]
    with open_camera(drivers=drivers(found(PlayedDevice(packets)))) as camera:
        came = [packet["t"].tolist() for packet in islice(camera, 3)]
    assert came == [[7200 * S], [7200 * S, 7200 * S + 10], [7200 * S + 20, 7200 * S + 30]]
    assert (camera.counts.garbled_times, camera.counts.clock_restarts) == (1, 1)


@settings(deadline=None)
@given(
    st.lists(st.integers(0, RESTART_US // 2), min_size=3, max_size=40),
    st.integers(0, 1 << 52),
    st.data(),
)
def test_a_minority_garbled_anyhow_is_found(jitter, start_us, data):
    times = start_us + np.array(jitter)
    places = data.draw(st.sets(st.integers(0, len(times) - 1), max_size=(len(times) - 1) // 2))
    ahead = st.integers(SILENCE_US + 2 * RESTART_US, (1 << 64) - 1 - int(times.max()))
    garbled = times.astype(np.uint64)
    for place in places:
        garbled[place] += np.uint64(data.draw(ahead))
    newest_us = data.draw(st.sampled_from([None, start_us]))
    assert kept_of(garbled, newest_us)[0] == np.delete(times, list(places)).tolist()
