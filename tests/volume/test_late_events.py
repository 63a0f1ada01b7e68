"""Events that come after newer ones: accepted, dropped and counted, or refused."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import events_of

from async_tnt import Processor, TNTConfig, TNTVolume
from async_tnt.volume.events import EventDecoder

SENSOR = (34, 34)
T = [5, 7, 6, 7, 9, 8, 8, 9, 3]  # 6, 8, 8 and 3 are late
KEPT = [0, 1, 3, 4, 7]


def packet(times):
    n = len(times)
    return events_of(times, np.arange(n) % 34, np.arange(n) % 31, np.arange(n) % 2)


FORMS = {
    "records": lambda events: events,
    "columns as they are": lambda events: tuple(events[name].copy() for name in "txyp"),
    "lists": lambda events: tuple(events[name].tolist() for name in "txyp"),
    "other records": lambda events: events.astype(
        [("t", ">u8"), ("x", ">u2"), ("y", ">u2"), ("p", ">i2")]
    ),
}


def rows(columns):
    return list(zip(*(column[: columns.n].tolist() for column in columns[:4]), strict=True))


def test_by_hand():
    events = packet(T)
    accept = EventDecoder(SENSOR, "accept")
    drop = EventDecoder(SENSOR, "drop")
    refuse = EventDecoder(SENSOR, "raise")
    assert rows(accept.decode(events)) == rows(accept.decode(events)) == packet(T).tolist()
    assert accept.n_dropped == 0
    for _ in range(2):
        assert rows(drop.decode(events)) == packet(T)[KEPT].tolist()
        assert (drop.n_dropped, drop.newest_us) == (4, 9)
        # 9 is not older than 9
        assert rows(drop.decode(events)) == [row for row in packet(T).tolist() if row[0] == 9]
        assert (drop.n_dropped, drop.newest_us) == (11, 9)
        drop.reset()
    one_by_one = [row for event in packet(T).tolist() for row in rows(drop.decode_one(*event))]
    assert (one_by_one, drop.n_dropped, drop.newest_us) == (packet(T)[KEPT].tolist(), 4, 9)
    with pytest.raises(
        ValueError,
        match=r"^`t` must not run backwards \(late=\"raise\"\), got 6 after 7 at event 2; ",
    ):
        refuse.decode(events)
    assert (refuse.newest_us, refuse.n_dropped) == (-1, 0)
    refuse.decode_one(9, 0, 0, 1)
    with pytest.raises(ValueError, match=r"got 8 after 9; "):
        refuse.decode_one(8, 0, 0, 1)


@given(
    times=st.lists(st.one_of(st.integers(0, 12), st.integers(0, 2**62 - 1)), max_size=25),
    cuts=st.lists(st.integers(0, 25), max_size=5),
    late=st.sampled_from(["accept", "drop", "raise"]),
    form=st.sampled_from(list(FORMS.values())),
)
def test_any_stream_in_any_packets(times, cuts, late, form):
    """Against a loop over the events."""
    decoder = EventDecoder(SENSOR, late)
    newest = -1
    n_dropped = 0
    for first, last in pairwise([0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]):
        events = packet(times)[first:last]
        expected = []
        newest_then = newest
        n_late = 0
        first_late = ""
        for i, row in enumerate(events.tolist()):
            if row[0] < newest_then and late != "accept":
                n_late += 1
                if n_late == 1:
                    at = f" at event {i}" if len(events) > 1 else ""
                    first_late = f"got {row[0]} after {newest_then}{at}; "
            else:
                expected.append(row)
            newest_then = max(newest_then, row[0])
        if late == "raise" and n_late:
            with pytest.raises(ValueError, match=f"must not run backwards .*{first_late}"):
                decoder.decode(form(events))
        else:
            assert rows(decoder.decode(form(events))) == expected
            newest = newest_then
            n_dropped += n_late
        if late != "accept":
            assert (decoder.newest_us, decoder.n_dropped) == (newest, n_dropped)


def test_volume_and_processor_count_every_late_event_once():
    config = TNTConfig(sensor=SENSOR, window_us=100)
    volume = TNTVolume(config, late="drop")
    control = TNTVolume(config)
    processor = Processor(config, classifier=lambda volume: [0.0], late="drop")
    for update, update_one in (
        (volume.update, volume.update_one),
        (processor.push, processor.push_one),
    ):
        update(packet(T))
        update(packet([8, 8, 9]))
        update_one(6, 1, 1, 1)  # this late event lies in the window
        update_one(9, 1, 1, 1)
    control.update(np.concatenate([packet(T)[KEPT], packet([8, 8, 9])[2:]]))
    control.update_one(9, 1, 1, 1)
    for counts in (volume.counts, processor.counts):
        assert (counts.received, counts.dropped_late) == (len(T) + 3 + 2, 4 + 2 + 1)
        assert counts.kept == control.counts.kept > 0
    assert volume.array.tobytes() == control.array.tobytes() == processor.volume().tobytes()
