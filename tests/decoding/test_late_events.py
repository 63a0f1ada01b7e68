"""Events that come after newer ones: accepted, dropped and counted, or refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of

from async_tnt import Processor, TNTConfig, TNTVolume
from async_tnt.events import EventDecoder

SENSOR = (34, 34)
T = [5, 7, 6, 7, 9, 8, 8, 9, 3]  # 6, 8, 8 and 3 are late
KEPT = [0, 1, 3, 4, 7]


def packet(times):
    n = len(times)
    return events_of(times, np.arange(n) % 34, np.arange(n) % 31, np.arange(n) % 2)


def forms(times):
    """The same packet by the fast way in, as columns as they are, and by the slow way."""
    events = packet(times)
    yield events
    yield tuple(np.array(events[name], dtype) for name, dtype in zip("txyp", ("i8", "u2", "u2", "u1"), strict=True))
    yield tuple(events[name].tolist() for name in "txyp")
    other = np.empty(len(times), [("p", ">i2"), ("y", ">u2"), ("x", ">u2"), ("t", ">u8")])
    for name in "txyp":
        other[name] = events[name]
    yield other


def rows(columns):
    return list(zip(*(column[: columns.n].tolist() for column in columns[:4]), strict=True))


@pytest.mark.parametrize("form", range(4))
def test_accept_takes_them_in_the_order_of_arrival(form):
    events = list(forms(T))[form]
    decoder = EventDecoder(SENSOR, "accept")
    assert rows(decoder.decode(events)) == packet(T).tolist()
    assert rows(decoder.decode(events)) == packet(T).tolist()
    assert decoder.n_dropped == 0


@pytest.mark.parametrize("form", range(4))
def test_drop_drops_and_counts_them(form):
    events = list(forms(T))[form]
    decoder = EventDecoder(SENSOR, "drop")
    assert rows(decoder.decode(events)) == packet(T)[KEPT].tolist()
    assert (decoder.n_dropped, decoder.newest_us) == (4, 9)
    assert rows(decoder.decode(events)) == [row for row in packet(T).tolist() if row[0] == 9]  # 9 is not older than 9
    assert (decoder.n_dropped, decoder.newest_us) == (11, 9)
    decoder.reset()
    assert (decoder.n_dropped, decoder.newest_us) == (0, -1)
    assert rows(decoder.decode(events)) == packet(T)[KEPT].tolist()


def test_drop_at_the_border_of_two_packets():
    decoder = EventDecoder(SENSOR, "drop")
    assert [row[0] for row in rows(decoder.decode(packet([10, 20])))] == [10, 20]
    assert [row[0] for row in rows(decoder.decode(packet([19, 20, 21])))] == [20, 21]
    assert rows(decoder.decode(packet([0, 20]))) == []
    assert [row[0] for row in rows(decoder.decode(packet([21])))] == [21]
    assert decoder.n_dropped == 3


@pytest.mark.parametrize("form", range(4))
@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ([], [5, 7, 6, 3], "got 6 after 7 at event 2"),
        ([8], [8, 9, 5, 6], "got 5 after 9 at event 2"),
        ([8], [7, 9], "got 7 after 8 at event 0"),
        ([2**62 - 1], [2**62 - 1, 2**62 - 2], f"got {2**62 - 2} after {2**62 - 1} at event 1"),
    ],
)
def test_raise_names_the_first_late_event_and_takes_nothing(form, first, second, message):
    decoder = EventDecoder(SENSOR, "raise")
    decoder.decode(packet(first))
    newest_us = decoder.newest_us
    with pytest.raises(ValueError, match=rf"^`t` must not run backwards \(late=\"raise\"\), {message}; .*drops and"):
        decoder.decode(list(forms(second))[form])
    assert (decoder.newest_us, decoder.n_dropped) == (newest_us, 0)
    assert rows(decoder.decode(packet([first[-1] if first else 0])))


def test_a_policy_that_is_none():
    message = "^`late` must be one of accept, drop, raise, got 'ignore'$"
    with pytest.raises(ValueError, match=message):
        EventDecoder(SENSOR, "ignore")
    with pytest.raises(ValueError, match=message):
        TNTVolume(TNTConfig(), late="ignore")
    with pytest.raises(ValueError, match=message):
        Processor(TNTConfig(), classifier=lambda volume: [0.0], late="ignore")


@settings(max_examples=200, deadline=None)
@given(
    times=st.lists(st.one_of(st.integers(0, 12), st.integers(0, 2**62 - 1)), max_size=25),
    cuts=st.lists(st.integers(0, 25), max_size=5),
    late=st.sampled_from(["accept", "drop", "raise"]),
    form=st.integers(0, 3),
)
def test_any_stream_in_any_packets(times, cuts, late, form):
    decoder = EventDecoder(SENSOR, late)
    events = packet(times)
    borders = [0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]
    newest, n_dropped = -1, 0
    for first, last in pairwise(borders):
        expected, packet_newest, n_late = [], newest, 0
        for row in events[first:last].tolist():
            if row[0] < packet_newest and late != "accept":
                n_late += 1
            else:
                expected.append(row)
            packet_newest = max(packet_newest, row[0])
        came = list(forms(times))[form]
        part = tuple(column[first:last] for column in came) if isinstance(came, tuple) else came[first:last]
        if late == "raise" and n_late:
            with pytest.raises(ValueError, match="must not run backwards"):
                decoder.decode(part)
        else:
            assert rows(decoder.decode(part)) == expected
            newest, n_dropped = packet_newest, n_dropped + n_late
        if late != "accept":
            assert (decoder.newest_us, decoder.n_dropped) == (newest, n_dropped)


def test_volume_counts_every_late_event_once():
    config = TNTConfig(sensor=SENSOR, window_us=100, landmark="center")
    volume, control = TNTVolume(config, late="drop"), TNTVolume(config)
    volume.open(0)
    control.open(0)
    volume.update(packet(T))
    volume.update(packet([8, 8, 9]))
    volume.update_one(2, 1, 1, 1)
    kept = packet(T)[KEPT]
    control.update(np.concatenate([kept, packet([8, 8, 9])[2:]]))
    counts = volume.counts
    assert (counts.received, counts.dropped_late) == (len(T) + 3 + 1, 4 + 2 + 1)
    assert counts.kept > 0
    assert counts.received == counts.kept + counts.dropped_outside + counts.dropped_tau_zero + counts.dropped_late
    np.testing.assert_array_equal(volume.array, control.array)


def test_processor_counts_every_late_event_once():
    processor = Processor(TNTConfig(sensor=SENSOR, window_us=100), classifier=lambda volume: [0.0], late="drop")
    processor.push(packet(T))
    processor.push_one(8, 1, 1, 1)
    processor.push_one(9, 1, 1, 1)
    assert (processor.counts.received, processor.counts.dropped_late) == (len(T) + 2, 5)
    assert processor.fire().events == len(KEPT) + 1
    processor.reset()
    assert processor.counts.received == processor.counts.dropped_late == 0
    processor.push_one(1, 1, 1, 1)
    assert processor.counts.dropped_late == 0
