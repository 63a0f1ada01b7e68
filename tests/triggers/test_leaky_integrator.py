"""The leaky integrate-and-fire trigger, by hand and against its equation; event by event and in one packet."""

import math

import pytest
from deciding import CONFIG, at, key
from made import random_events

from async_tnt import LeakyIntegrator, Processor


def fired(make, times, integrator, **settings):
    """Numbers of the stream's events, from 1 on, at which activity decided: event by event as in one packet."""
    single, packed = (make(activity=integrator, **settings) for _ in range(2))
    answers = [single.push_one(*event) for event in zip(*at(times), strict=True)]
    assert [key(d) for d in packed.push(at(times))] == [key(d) for answer in answers for d in answer]
    return [k for k, answer in enumerate(answers, 1) if "activity" in {d.trigger for d in answer}]


@pytest.mark.parametrize(
    ("threshold", "leak_us", "charge"), [(3.5, 30.0, 1.0), (1.7, 4.0, 0.6), (2.5, 1e4, 2.4), (80.0, math.inf, 1.0)]
)
def test_it_fires_where_the_equation_says(make, threshold, leak_us, charge):
    """v <- v exp(-dt / leak_us) + charge, with dt = 0 for an event older than the newest; zero again where it fires."""
    times = random_events(700, seed=3, duration_us=3000)["t"]
    times[5::9] = times[4::9][: len(times[5::9])] - 2  # within their window: those before it are dropped
    times = sorted(times[:3].tolist()) + [int(t) for t in times[3:] if (t - times[0]) % 1000 > 3]
    potential, newest_us, expected = 0.0, times[0], []
    for k, t in enumerate(times, 1):
        potential = potential * math.exp(-max(t - newest_us, 0) / leak_us) + charge
        newest_us = max(newest_us, t)
        assert abs(potential - threshold) > 1e-9 or leak_us == math.inf  # not decided by the last bit of exp
        if potential >= threshold:
            expected.append(k)
            potential = 0.0
    assert len(expected) > 5
    assert fired(make, times, LeakyIntegrator(threshold, leak_us, charge)) == expected


def test_it_fires_where_it_reaches_the_threshold(make):
    """Ten microseconds apart, with a leak of 10 us: 1, 1 + 1/e = 1.37, 1 + 1.37/e = 1.50, 1.55, 1.57 ..."""
    times = list(range(0, 100, 10))
    assert fired(make, times, LeakyIntegrator(1.36, 10.0)) == [2, 4, 6, 8, 10]
    assert fired(make, times, LeakyIntegrator(1.37, 10.0)) == [3, 6, 9]
    assert fired(make, times, LeakyIntegrator(1.54, 10.0)) == [4, 8]


def test_after_firing_it_is_zero(make):
    """What exceeds the threshold is lost: 2.5 + 2.5 reaches 4, and then again two are needed."""
    assert fired(make, [0] * 8, LeakyIntegrator(4.0, 100.0, 2.5)) == [2, 4, 6, 8]
    assert fired(make, [0] * 8, LeakyIntegrator(5.0, 100.0, 2.5)) == [2, 4, 6, 8]  # reached exactly
    assert fired(make, [0] * 8, LeakyIntegrator(5.1, 100.0, 2.5)) == [3, 6]
    assert fired(make, [0, 1, 500, 501], LeakyIntegrator(1.0, 1.0, 7.0)) == [1, 2, 3, 4]


def test_it_counts_across_windows(make):
    times = [0, 1, 2, 3, 4, 1000, 1001, 5000, 5001, 5002, 5003, 9000, 9001]
    assert fired(make, times, LeakyIntegrator(4.0, math.inf)) == [4, 8, 12]
    assert fired(make, [998, 999, 1998, 1999], LeakyIntegrator(3.0, 1e6)) == [4]  # 2.998..; 3.997
    each = make(every_events=4).push(at(times))  # this counts within each window
    assert [d.time_us for d in each if d.trigger == "every_events"] == [3, 5003]


def test_late_events_do_not_charge(make):
    assert fired(make, [5000, 4000, 3000, 2000, 5001], LeakyIntegrator(2.0, 1e9), start_us=5000) == []
    assert fired(make, [5000, 4999, 4999, 5000], LeakyIntegrator(2.0, 1e9), late="drop") == [4]


def test_events_of_a_window_that_was_closed_early_do_not_charge():
    processor = Processor(
        CONFIG, classifier=lambda volume: [9.0, 0.0], activity=LeakyIntegrator(2.0, 1e9), confidence=0.9
    )
    assert [d.trigger for d in processor.push(at([0, 0]))] == ["confidence"]
    assert processor.push(at([1, 2, 3, 4, 1000])) == []
    assert [d.events for d in processor.push(at([1000]))] == [2]


def test_with_every_events_an_event_decides_once(make):
    """Where both are due there is one decision, and the potential is zero again."""
    decisions = make(every_events=4, activity=LeakyIntegrator(2.0, 1e9, 1.001)).push(at(list(range(10))))
    names = ["activity", "every_events", "activity", "every_events", "activity"]
    assert [(d.trigger, d.events) for d in decisions] == list(zip(names, [2, 4, 6, 8, 10], strict=True))


def test_reset_and_another_integrator_begin_at_zero(make):
    processor = make()
    processor.activity = LeakyIntegrator(3.0, math.inf)
    processor.push(at([0, 0]))
    processor.reset()
    assert processor.push(at([0, 0])) == [] and len(processor.push(at([0]))) == 1
    processor.push(at([0, 0]))
    processor.activity = LeakyIntegrator(3.0, math.inf)  # the same: continues
    assert len(processor.push(at([0]))) == 1
    processor.push(at([0, 0]))
    processor.activity = LeakyIntegrator(3.0, 1e12)
    assert processor.push(at([0, 0])) == []
    processor.activity = None
    processor.push(at([0] * 9))
    processor.activity = LeakyIntegrator(3.0, math.inf)
    assert processor.push(at([0, 0])) == [] and len(processor.push(at([0]))) == 1


@pytest.mark.parametrize(("last", "fires"), [(10, True), (11, False)])
def test_another_one_begins_as_on_a_new_stream(make, last, fires):
    """Earlier events count neither as charge nor as time: 0.4 at 9 us, then 0.4/e + 0.4 = 0.547 or 0.4/e^2 + 0.4."""
    processor = make(activity=LeakyIntegrator(1.5, 1.0), start_us=0)
    assert processor.push(at([10])) == []
    processor.activity = LeakyIntegrator(0.5, 1.0, 0.4)
    assert processor.push(at([9])) == []  # older than the newest, and accepted
    assert bool(processor.push(at([last]))) == fires
