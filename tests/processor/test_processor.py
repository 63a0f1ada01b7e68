"""Processor: which decisions are made when. test_triggers_equal_oracle.py compares all triggers with an oracle."""

import pytest
from deciding import CONFIG, at, run, summary, total_and_size
from made import events_of

from async_tnt import Processor

BY_HAND = {  # settings, times of events, decisions
    "windows start where asked": (
        {"start_us": 0},
        (5, 999, 1000, 2500),
        [("window", 0, 999, 2), ("window", 1000, 1000, 1), ("end", 2000, 2500, 1)],
    ),
    "empty windows are skipped, however many": (
        {},
        (0, 10**14 + 1),
        [("window", 0, 0, 1), ("end", 10**14, 10**14 + 1, 1)],
    ),
    "an event exactly at the end of an empty window skips it": (
        {"start_us": 0},
        (0, 2000),
        [("window", 0, 0, 1), ("end", 2000, 2000, 1)],
    ),
    "overlapping windows each hold their own events": (
        {"hop_us": 500},
        (0, 400, 700, 1000, 1500, 2400),
        [
            ("window", 0, 700, 3),
            ("window", 500, 1000, 2),
            ("window", 1000, 1500, 2),
            ("end", 1500, 2400, 2),
            ("end", 2000, 2400, 1),
        ],
    ),
    "every_us counts from the window's start": (
        {"every_us": 200},
        (100, 150, 350, 360, 900, 1250),
        [
            ("every_us", 100, 150, 2),  # at 300
            ("every_us", 100, 360, 4),  # at 500; at 700 nothing new
            ("window", 100, 900, 5),  # at 900 the fifth event is new, but shows up at 1100 with the window's end
            ("end", 1100, 1250, 1),
        ],
    ),
    "every_us decides without the event that shows the time": (
        {"every_us": 200},
        (0, 199, 200),
        [("every_us", 0, 199, 2), ("end", 0, 200, 3)],
    ),
    "a moment at the window's end is the window's end": (
        {"every_us": 500},
        (0, 600, 1000),
        [("every_us", 0, 0, 1), ("window", 0, 600, 2), ("end", 1000, 1000, 1)],
    ),
    "every_us decides nothing twice, and nothing of an empty window": (
        {"every_us": 5, "every_events": 2, "start_us": 0},
        (7, 8, 13),
        [("every_events", 0, 8, 2), ("end", 0, 13, 3)],
    ),
    "every_events counts within the window": (
        {"every_events": 2},
        (0, 1, 2, 3, 4, 1000, 1001),
        [
            ("every_events", 0, 1, 2),
            ("every_events", 0, 3, 4),
            ("window", 0, 4, 5),
            ("every_events", 1000, 1001, 2),
            ("end", 1000, 1001, 2),
        ],
    ),
}


@pytest.mark.parametrize(("settings", "times", "expected"), BY_HAND.values(), ids=BY_HAND)
@pytest.mark.parametrize("size", [1, 9])
def test_by_hand(settings, times, expected, size):
    decisions, _ = run(events_of(*at(times)), size, **settings)
    assert summary(decisions) == expected
    assert all(d.complete == (d.trigger == "window") for d in decisions)


@pytest.mark.parametrize("hop_us", [None, 300])
@pytest.mark.parametrize("size", [1, 8])
def test_events_before_all_open_windows_are_dropped_and_counted_once(hop_us, size):
    _, processor = run(events_of(*at([5, 7000, 7001, 6, 8600, 7, 9900, 8])), size, start_us=7000, hop_us=hop_us)
    assert (processor.counts.received, processor.counts.dropped_late) == (8, 4)


def test_a_stream_may_continue_after_finish():
    processor = Processor(CONFIG, classifier=total_and_size)
    processor.push(at([0, 10]))
    assert summary(processor.finish()) == [("end", 0, 10, 2)]
    assert processor.finish() == []
    assert processor.fire().events == 0 and not processor.volume().any() and processor.counts.received == 2
    assert processor.push_one(500, 3, 3, 1) == [] and processor.counts.dropped_late == 1
    assert processor.push_one(1500, 3, 3, 1) == []
    assert summary(processor.finish()) == [("end", 1000, 1500, 1)]
