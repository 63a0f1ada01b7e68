"""Times of a camera's clock, before and after it starts anew."""

import numpy as np
import pytest
from cameras.made_devices import RECORD
from hypothesis import example, given, settings
from hypothesis import strategies as st

from async_tnt.sources.clock import RESTART_US, ContinuousTime

DV = np.dtype({"names": ["timestamp", "x"], "formats": ["<i8", "<i2"], "offsets": [0, 8], "itemsize": 16})
EPOCH = 1_700_000_000_000_000  # dv-processing counts from 1970


def packets_of(cuts, times, dtype=RECORD):
    events = np.zeros(len(times), dtype)
    events[dtype.names[0]] = times
    return [packet.copy() for packet in np.split(events, cuts) if len(packet)]


def shifted(packets, field="t"):
    clock = ContinuousTime(field)
    return np.concatenate([clock(packet)[field].astype(np.int64) for packet in packets]), clock


def times_of(draws):
    """Runs of a clock, each from anywhere: below the end of the last one, by much or by little, or above it."""
    times = []
    for start, steps in draws:
        times.extend((start + np.cumsum(steps)).tolist())
    return times


run = st.tuples(st.integers(0, 10_000_000), st.lists(st.integers(0, 5_000), min_size=1, max_size=12))


@settings(deadline=None)
@given(st.lists(run, min_size=1, max_size=5), st.sets(st.integers(1, 60), max_size=8))
@example([(995_001, [5_000]), (0, [1, 0]), (0, [0])], {1, 2})  # it falls twice by little, and does not in between
def test_it_never_falls_far_and_runs_keep_their_steps(draws, cuts):
    times = times_of(draws)
    cuts = sorted(cut for cut in cuts if cut <= len(times))
    went_on, clock = shifted(packets_of(cuts, times))
    ends = np.cumsum([len(packet) for packet in packets_of(cuts, times)]) - 1
    newest = np.maximum.accumulate(went_on[ends])
    changed = np.flatnonzero(np.diff(went_on) != np.diff(times)) + 1
    assert len(changed) == clock.restarts
    for i in changed:
        before = newest[ends.searchsorted(i - 1)] if i - 1 in ends else went_on[i - 1]
        # at a packet's start it falls from the newest event, which may be an earlier one than the event before
        assert went_on[i] == before and (times[i] < times[i - 1] or i - 1 in ends)
    assert (went_on[ends] >= newest - RESTART_US).all()


@settings(deadline=None)
@given(st.lists(st.integers(-RESTART_US // 2, RESTART_US // 2), min_size=1, max_size=30), st.data())
def test_jitter_is_left_alone(jitter, data):
    times = (5 * RESTART_US + np.arange(len(jitter)) + np.array(jitter)).tolist()
    cuts = sorted(data.draw(st.sets(st.integers(1, len(times)), max_size=5)))
    went_on, clock = shifted(packets_of(cuts, times))
    assert went_on.tolist() == times and clock.restarts == 0


@pytest.mark.parametrize(("dtype", "field"), [(RECORD, "t"), (DV, "timestamp")])
def test_by_hand(dtype, field):
    """A restart between packets, one within a packet, and times that go on in between."""
    runs = [[EPOCH, EPOCH + 10], [4, 9], [15, EPOCH], [EPOCH + 5, 0, 7]]
    packets = [packets_of([], times, dtype)[0] for times in runs]
    went_on, clock = shifted(packets, field)
    offset = EPOCH + 10 - 4
    far = EPOCH + offset
    assert went_on.tolist() == [EPOCH, EPOCH + 10, EPOCH + 10, EPOCH + 15, EPOCH + 21, far, far + 5, far + 5, far + 12]
    assert clock.restarts == 2


def test_a_fall_of_just_the_limit_is_none():
    for fall, restarts in ((RESTART_US, 0), (RESTART_US + 1, 1)):
        _, clock = shifted(packets_of([1], [2 * RESTART_US, 2 * RESTART_US - fall]))
        assert clock.restarts == restarts


def test_falls_count_from_the_newest_event():
    """Not from the end of the packet before: two falls of 0.6 s are one of 1.2 s."""
    packets = packets_of([1, 2], [10_000_000, 9_400_000, 8_800_000])
    went_on, clock = shifted(packets)
    assert went_on.tolist() == [10_000_000, 9_400_000, 10_000_000] and clock.restarts == 1


def test_two_restarts_within_a_packet():
    packet = packets_of([], [10_000_000, 12_000_000, 4_000_000, 6_000_000, 500_000])
    went_on, clock = shifted(packet)
    assert went_on.tolist() == [10_000_000, 12_000_000, 12_000_000, 14_000_000, 14_000_000] and clock.restarts == 2


def test_it_is_the_same_memory():
    packet = packets_of([], [1, 2])[0]
    assert ContinuousTime("t")(packet) is packet
