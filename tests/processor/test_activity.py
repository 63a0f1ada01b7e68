"""The leaky integrate-and-fire trigger, by hand, event by event and in one packet.

Where nothing happens there are no decisions: time passes with events only.
"""

import math

import pytest
from deciding import CONFIG, at, key, summary

from async_tnt import LeakyIntegrator, Processor


def fired(make, times, integrator, **settings):
    """Numbers of the stream's events, from 1 on, at which activity decided: event by event as in one packet."""
    single, packed = (make(activity=integrator, **settings) for _ in range(2))
    answers = [single.push_one(*event) for event in zip(*at(times), strict=True)]
    assert [key(d) for d in packed.push(at(times))] == [key(d) for answer in answers for d in answer]
    return [k for k, answer in enumerate(answers, 1) if "activity" in {d.trigger for d in answer}]


def test_it_fires_where_it_reaches_the_threshold(make):
    """Ten microseconds apart, with a leak of 10 us: 1, 1 + 1/e = 1.37, 1 + 1.37/e = 1.50, 1.55, 1.57 ..."""
    times = list(range(0, 100, 10))
    assert fired(make, times, LeakyIntegrator(1.36, 10.0)) == [2, 4, 6, 8, 10]
    assert fired(make, times, LeakyIntegrator(1.37, 10.0)) == [3, 6, 9]
    assert fired(make, times, LeakyIntegrator(1.54, 10.0)) == [4, 8]


def test_it_counts_across_windows(make):
    times = [0, 1, 2, 3, 4, 1000, 1001, 5000, 5001, 5002, 5003, 9000, 9001]
    assert fired(make, times, LeakyIntegrator(4.0, math.inf)) == [4, 8, 12]
    assert fired(make, [998, 999, 1998, 1999], LeakyIntegrator(3.0, 1e6)) == [4]  # 2.998..; 3.997


def test_late_events_do_not_charge(make):
    assert fired(make, [5000, 4000, 3000, 2000, 5001], LeakyIntegrator(2.0, 1e9), start_us=5000) == []
    assert fired(make, [5000, 4999, 4999, 5000], LeakyIntegrator(2.0, 1e9), late="drop") == [4]


@pytest.mark.parametrize(("last", "fires"), [(10, True), (11, False)])
def test_another_one_begins_as_on_a_new_stream(make, last, fires):
    """Earlier events count neither as charge nor as time: 0.4 at 9 us, then 0.4/e + 0.4 = 0.547 or 0.4/e^2 + 0.4."""
    processor = make(activity=LeakyIntegrator(1.5, 1.0), start_us=0)
    assert processor.push(at([10])) == []
    processor.activity = LeakyIntegrator(0.5, 1.0, 0.4)
    assert processor.push(at([9])) == []  # older than the newest, and accepted
    assert bool(processor.push(at([last]))) == fires


def test_no_events_no_decisions(make):
    processor = make(every_us=1, every_events=1, confidence=0.01, activity=LeakyIntegrator(0.1, 1.0), start_us=0)
    for empty in (None, [], at([])):
        assert processor.push(empty) == []
    assert processor.finish() == [] and processor.counts.received == 0


def test_dropped_events_make_nothing_due(make):
    """Late ones are not of the window: `every_events` does not count them, `every_us` finds nothing new."""
    processor = make(every_events=2, every_us=300, start_us=1000)
    assert summary(processor.push(at([1000, 5, 6, 7]))) == []
    assert summary(processor.push(at([1001]))) == [("every_events", 1000, 1001, 2)]
    assert summary(processor.push(at([5, 6, 7, 8, 1500]))) == []
    assert summary(processor.push(at([1700]))) == [("every_us", 1000, 1500, 3), ("every_events", 1000, 1700, 4)]
    assert processor.counts.dropped_late == 7


def test_events_of_a_window_that_was_closed_early_do_not_charge():
    processor = Processor(
        CONFIG, classifier=lambda volume: [9.0, 0.0], activity=LeakyIntegrator(2.0, 1e9), confidence=0.9
    )
    assert [d.trigger for d in processor.push(at([0, 0]))] == ["confidence"]
    assert processor.push(at([1, 2, 3, 4, 1000])) == []
    assert [d.events for d in processor.push(at([1000]))] == [2]
