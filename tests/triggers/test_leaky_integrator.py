"""The leaky integrate-and-fire trigger, by hand."""

import math

import numpy as np
import pytest
from deciding import CONFIG, at, total_and_size
from made import random_events, random_model

from async_tnt import LeakyIntegrator, Processor


def fired(times, integrator, classifier=None, **settings):
    """Numbers of the stream's events, from 1 on, at which activity decided."""
    if classifier is None:
        processor = Processor(CONFIG, classifier=total_and_size, activity=integrator, **settings)
    else:
        processor = Processor(classifier, activity=integrator, **settings)
    return [k for k, t in enumerate(times, 1) if "activity" in {d.trigger for d in processor.push(at([t]))}]


@pytest.fixture(params=["callable", "compiled"])
def model(request):
    return None if request.param == "callable" else random_model(CONFIG)


def test_it_fires_where_it_reaches_the_threshold(model):
    """Ten microseconds apart, with a leak of 10 us: 1, 1 + 1/e = 1.37, 1 + 1.37/e = 1.50, 1.55, 1.57 ..."""
    times = list(range(0, 100, 10))
    potentials = [sum(math.exp(-k) for k in range(n)) for n in range(1, 11)]
    assert potentials[1] == pytest.approx(1.368, abs=1e-3) and potentials[2] == pytest.approx(1.503, abs=1e-3)
    for n in range(1, 8):
        between = (potentials[n - 1] + potentials[n]) / 2
        # from zero on it takes n + 1 events each time
        assert fired(times, LeakyIntegrator(between, 10.0), model) == list(range(n + 1, 11, n + 1))


def test_below_its_steady_potential_it_fires_and_above_never(model):
    """One event each d microseconds holds the potential at charge / (1 - exp(-d / leak)), about leak charge / d."""
    times = list(range(0, 900, 5))
    steady = 0.5 / (1 - math.exp(-5 / 40))
    assert steady == pytest.approx(40 * 0.5 / 5, rel=0.07)
    assert fired(times, LeakyIntegrator(steady * 1.0001, 40.0, 0.5), model) == []
    assert len(fired(times, LeakyIntegrator(steady * 0.9, 40.0, 0.5), model)) == 180 // 19
    busier = list(range(0, 900, 4))
    assert len(fired(busier, LeakyIntegrator(steady * 1.0001, 40.0, 0.5), model)) > 0


def test_after_firing_it_is_zero(model):
    """What exceeds the threshold is lost: 2.5 + 2.5 reaches 4, and then again two are needed."""
    assert fired([0] * 8, LeakyIntegrator(4.0, 100.0, 2.5), model) == [2, 4, 6, 8]
    assert fired([0] * 8, LeakyIntegrator(5.0, 100.0, 2.5), model) == [2, 4, 6, 8]  # reached exactly
    assert fired([0] * 8, LeakyIntegrator(5.1, 100.0, 2.5), model) == [3, 6]


def test_a_charge_as_large_as_the_threshold_fires_at_every_event(model):
    assert fired([0, 1, 500, 501], LeakyIntegrator(1.0, 1.0), model) == [1, 2, 3, 4]
    assert fired([0, 1, 500, 501], LeakyIntegrator(1.0, 1.0, 7.0), model) == [1, 2, 3, 4]


def test_a_pause_empties_it(model):
    assert fired([0, 0, 0, 900, 900, 900, 900], LeakyIntegrator(4.0, 10.0), model) == [7]
    assert fired([0, 0, 0, 5, 5, 5, 5], LeakyIntegrator(4.0, 10.0), model) == [6]  # 3 / sqrt(e) + 3 = 4.8


def test_without_a_leak_it_counts_across_windows(model):
    times = [0, 1, 2, 3, 4, 1000, 1001, 5000, 5001, 5002, 5003, 9000, 9001]
    assert fired(times, LeakyIntegrator(4.0, math.inf), model) == [4, 8, 12]
    processor = Processor(CONFIG, classifier=total_and_size, every_events=4)  # this counts within each
    assert [d.time_us for d in processor.push(at(times)) if d.trigger == "every_events"] == [3, 5003]


def test_what_was_charged_in_one_window_counts_in_the_next(model):
    assert fired([998, 999, 1998, 1999], LeakyIntegrator(3.0, 1e6), model) == [4]  # 2.998..; 3.997


def test_time_that_runs_backwards_leaks_nothing(model):
    """The potential leaks with the newest time: an older event only charges."""
    assert fired([0, 50, 20, 10, 50], LeakyIntegrator(4.9, 1000.0), model) == [5]
    potential = 1.0
    for dt in (50, 0, 0):
        potential = potential * math.exp(-dt / 1000) + 1
    assert fired([0, 50, 20, 10], LeakyIntegrator(potential - 1e-6, 1000.0), model) == [4]
    assert fired([0, 50, 20, 10], LeakyIntegrator(potential + 1e-6, 1000.0), model) == []


def test_late_events_do_not_charge(model):
    assert fired([5000, 4000, 3000, 2000, 5001], LeakyIntegrator(2.0, 1e9), model, start_us=5000) == []
    assert fired([5000, 4999, 4999, 5000], LeakyIntegrator(2.0, 1e9), model, late="drop") == [4]


def test_events_of_a_decided_window_do_not_charge():
    processor = Processor(
        CONFIG, classifier=lambda volume: [9.0, 0.0], activity=LeakyIntegrator(2.0, 1e9), confidence=0.9
    )
    assert [d.trigger for d in processor.push(at([0, 0]))] == ["confidence"]
    assert processor.push(at([1, 2, 3, 4, 1000])) == []
    assert [d.events for d in processor.push(at([1000]))] == [2]


def test_with_every_events_both_count_and_one_speaks(model):
    """At an event where both are due it is said once, and the potential is zero again."""
    settings = {"every_events": 4}
    processor = Processor(model or CONFIG, classifier=None if model else total_and_size, **settings)
    processor.activity = LeakyIntegrator(2.0, 1e9, 1.001)
    decisions = processor.push(at(list(range(10))))
    assert [(d.trigger, d.events) for d in decisions] == [
        ("activity", 2),
        ("every_events", 4),
        ("activity", 6),
        ("every_events", 8),
        ("activity", 10),
    ]


def test_reset_and_another_integrator_begin_at_zero(model):
    processor = Processor(model or CONFIG, classifier=None if model else total_and_size)
    processor.activity = LeakyIntegrator(3.0, math.inf)
    processor.push(at([0, 0]))
    processor.reset()
    assert processor.push(at([0, 0])) == [] and len(processor.push(at([0]))) == 1
    processor.push(at([0, 0]))
    processor.activity = LeakyIntegrator(3.0, math.inf)  # the same: goes on
    assert len(processor.push(at([0]))) == 1
    processor.push(at([0, 0]))
    processor.activity = LeakyIntegrator(3.0, 1e12)
    assert processor.push(at([0, 0])) == []
    processor.activity = None
    assert processor.push(at([0] * 9)) == []
    processor.activity = LeakyIntegrator(3.0, math.inf)
    assert processor.push(at([0, 0])) == [] and len(processor.push(at([0]))) == 1


def test_a_busy_scene_is_decided_more_often_than_a_slow_one(model):
    """What it is for: as many events, in half the time."""
    integrator = LeakyIntegrator(20.0, 100.0)
    counts = []
    for duration_us in (900, 450):
        t = np.sort(random_events(300, seed=1, duration_us=duration_us)["t"]).tolist()
        counts.append(len(fired(t, integrator, model)))
    assert 0 < counts[0] < counts[1]


@pytest.mark.parametrize(("last", "fires"), [(10, True), (11, False)])
def test_another_one_in_midstream_begins_as_on_a_new_stream(model, last, fires):
    """What came before counts neither as charge nor as time: 0.4 at 9 us, then 0.4/e + 0.4 = 0.547 or 0.4/e^2 + 0.4."""
    one = {"start_us": 0} | ({"classifier": total_and_size} if model is None else {})
    processor = Processor(CONFIG if model is None else model, activity=LeakyIntegrator(1.5, 1.0), **one)
    assert processor.push(at([10])) == []
    processor.activity = LeakyIntegrator(0.5, 1.0, 0.4)
    assert processor.push(at([9])) == []  # older than the newest, and taken
    assert bool(processor.push(at([last]))) == fires
