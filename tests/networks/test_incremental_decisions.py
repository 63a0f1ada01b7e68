"""Networks in a Processor: what it decides, on its compiled and its general path, against a plain loop."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from deciding import key
from made import random_events
from networks.cases import DIGITS, WINDOW_US, of_all
from oracles import Oracle, as_values

from async_tnt import CompiledRegressor, Processor


def decide(processor, events, size):
    """size : events in a packet; 0: one by one, by `push_one`."""
    if size == 0:
        decisions = [d for event in events.tolist() for d in processor.push_one(*event)]
    else:
        decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
    return decisions + processor.finish()


def regressor_of(network):
    return CompiledRegressor(network.model()) if network.config.needs_regressor else None


def plain(network, events, every, seed=0):
    """One event at a time, and the whole network each time."""
    oracle = Oracle(network.config, network.dense(seed), regressor=regressor_of(network), every_events=every)
    return oracle.push_all(events) + oracle.finish()


@of_all
def test_after_every_event(network):
    events = random_events(300, seed=1, duration_us=2 * WINDOW_US + 900, sensor=network.config.sensor)
    expected = plain(network, events, 1)
    assert len(expected) == 300 + 3  # two closed windows and the end
    for size in (0, 7, 300):
        assert [as_values(d) for d in decide(Processor(network.model(), every_events=1), events, size)] == expected


@pytest.mark.parametrize("settings", [{"every_events": 1}, {"confidence": 0.9}], ids=str)
def test_processors_in_threads_decide_as_one_after_the_other(settings):
    n_threads = 4
    together = threading.Barrier(n_threads)

    def work(seed, wait=lambda: None):
        processor = Processor(DIGITS.model(seed), **settings)
        events = random_events(700, seed=seed, duration_us=10_000)
        wait()
        return [key(d) for d in decide(processor, events, 300)]

    expected = [work(seed) for seed in range(n_threads)]
    with ThreadPoolExecutor(n_threads) as threads:
        assert list(threads.map(lambda seed: work(seed, together.wait), range(n_threads))) == expected
    assert len({str(decisions) for decisions in expected}) == n_threads  # none has another one's
