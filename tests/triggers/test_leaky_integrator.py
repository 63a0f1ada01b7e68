"""The leaky integrate-and-fire trigger, by hand and against its equation; event by event and in one packet."""

import json
import math

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_model

from async_tnt import LeakyIntegrator, Processor, TNTConfig


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


def test_even_events_fire_from_their_own_level_on_and_irregular_ones_below_the_rate_of_the_threshold():
    """60 events in 4,000 us are the rate at which the mean potential is 60; after an event it is 1/2 more."""
    integrator = LeakyIntegrator(60.0, 4000.0)
    rate = 60 / 4000
    even = np.arange(2_000) / rate
    irregular = np.cumsum(np.random.default_rng(0).exponential(1 / (0.8 * rate), 20_000))

    def n_fired(t_us):
        processor = Processor(CONFIG, classifier=total_and_size, activity=integrator)
        return sum(d.trigger == "activity" for d in processor.push(at(np.round(t_us).astype(np.int64))))

    assert 1 / -math.expm1(-1 / (0.991 * rate * 4000)) < 60 < 1 / -math.expm1(-1 / (0.998 * rate * 4000))
    assert n_fired(even / 0.991) == 0 and n_fired(even / 0.998) == 6
    assert n_fired(irregular) == 22


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


def test_its_numbers_may_be_numpys_and_a_period_longer_than_time():
    activity = LeakyIntegrator(np.float32(60), np.int64(4000))
    assert json.dumps(vars(activity)) == '{"threshold": 60.0, "leak_us": 4000.0, "charge": 1.0}'
    Processor(random_model(TNTConfig()), activity=activity, every_us=2**62 - 1, start_us=10**6)
