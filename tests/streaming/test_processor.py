"""Processor: which decisions fall when, and that cutting the stream differently changes none of them."""

from deciding import CONFIG, at, run, summary, total_and_size
from made import events_of, random_events

from async_tnt import Processor

# -- windows -----------------------------------------------------------------------------------------------


def test_window_is_decided_when_the_first_event_at_or_after_its_end_comes():
    processor = Processor(CONFIG, classifier=total_and_size)
    assert processor.push(at([100, 1099])) == []
    (decision,) = processor.push(at([1100]))
    assert summary([decision]) == [("window", 100, 1099, 2)] and decision.complete
    assert summary([processor.fire()]) == [("fire", 1100, 1100, 1)]


def test_windows_start_where_asked():
    decisions, _ = run(events_of(*at([5, 999, 1000, 2500])), start_us=0)
    assert summary(decisions) == [("window", 0, 999, 2), ("window", 1000, 1000, 1), ("end", 2000, 2500, 1)]
    assert [d.complete for d in decisions] == [True, True, False]


def test_empty_windows_are_skipped_however_many():
    decisions, _ = run(events_of(*at([0, 10**14 + 1])))
    assert summary(decisions) == [("window", 0, 0, 1), ("end", 10**14, 10**14 + 1, 1)]


def test_events_before_the_first_window_are_dropped_and_counted():
    decisions, processor = run(events_of(*at([5, 7000, 7001])), start_us=7000)
    assert summary(decisions) == [("end", 7000, 7001, 2)]
    assert processor.counts.dropped_late == 1 and processor.counts.received == 3


def test_overlapping_windows_each_hold_their_own_events():
    decisions, _ = run(events_of(*at([0, 400, 700, 1000, 1500, 2400])), hop_us=500, config=CONFIG)
    assert summary(decisions) == [
        ("window", 0, 700, 3),
        ("window", 500, 1000, 2),
        ("window", 1000, 1500, 2),
        ("end", 1500, 2400, 2),
        ("end", 2000, 2400, 1),
    ]


def test_overlapping_windows_equal_windows_by_themselves():
    events = random_events(500, seed=4, duration_us=5000)
    decisions, _ = run(events, hop_us=300)
    for decision in decisions:
        start = decision.window_start_us
        alone, _ = run(events[(events["t"] >= start) & (events["t"] < start + 1000)], start_us=start)
        assert alone[0].logits.tobytes() == decision.logits.tobytes()
        assert alone[0].events == decision.events


# -- triggers ----------------------------------------------------------------------------------------------


def test_every_us_counts_from_the_windows_start():
    decisions, _ = run(events_of(*at([100, 150, 350, 360, 900, 1250])), every_us=200)
    assert summary(decisions) == [
        ("every_us", 100, 150, 2),  # at 300
        ("every_us", 100, 360, 4),  # at 500; at 700 nothing new
        ("window", 100, 900, 5),  # at 900 the fifth event is new, but shows up at 1100 with the window's end
        ("end", 1100, 1250, 1),
    ]


def test_every_us_decides_without_the_event_that_shows_the_time():
    decisions, _ = run(events_of(*at([0, 199, 200])), every_us=200)
    assert summary(decisions) == [("every_us", 0, 199, 2), ("end", 0, 200, 3)]


def test_every_events_counts_within_the_window():
    decisions, _ = run(events_of(*at([0, 1, 2, 3, 4, 1000, 1001])), every_events=2)
    assert summary(decisions) == [
        ("every_events", 0, 1, 2),
        ("every_events", 0, 3, 4),
        ("window", 0, 4, 5),
        ("every_events", 1000, 1001, 2),
        ("end", 1000, 1001, 2),
    ]


def test_every_event():
    events = random_events(300, seed=2, duration_us=2500)
    decisions, _ = run(events, every_events=1)
    assert [d.events for d in decisions if d.trigger == "every_events"] == [
        n for w in range(3) for n in range(1, 1 + sum((events["t"] - events["t"][0]) // 1000 == w))
    ]


# -- laws --------------------------------------------------------------------------------------------------


def test_counts_with_overlapping_windows_count_received_once():
    events = random_events(1000, seed=9, duration_us=10_000)
    _, plain = run(events)
    _, hop = run(events, hop_us=500, start_us=int(events["t"][0]))
    assert plain.counts.received == hop.counts.received == 1000
    c = plain.counts
    assert c.received == c.kept + c.dropped_outside + c.dropped_tau_zero + c.dropped_late
    assert hop.counts.kept > 1.5 * c.kept


def test_a_stream_may_go_on_after_finish():
    processor = Processor(CONFIG, classifier=total_and_size)
    processor.push(at([0, 10]))
    assert summary(processor.finish()) == [("end", 0, 10, 2)]
    assert processor.finish() == []
    assert processor.fire().events == 0 and not processor.volume().any() and processor.counts.received == 2
    assert processor.push_one(500, 3, 3, 1) == [] and processor.counts.dropped_late == 1
    assert processor.push_one(1500, 3, 3, 1) == []
    assert summary(processor.finish()) == [("end", 1000, 1500, 1)]
