"""Networks in a Processor: what it decides, on its compiled and its general path, against a plain loop."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from deciding import key
from hypothesis import given
from hypothesis import strategies as st
from incremental.cases import DIGITS, NETWORKS, SMALL, WINDOW_US, of_all, of_some
from incremental.oracles import decisions_one_by_one, row
from made import nasty_streams, random_events

from async_tnt import CompiledClassifier, CompiledRegressor, Processor, TNTVolume
from async_tnt.kernels import state as S


def decide(processor, events, size, finish=True):
    """size : events in a packet; 0: all in one; None: one by one, by `push_one`."""
    if size is None:
        decisions = [d for event in events.tolist() for d in processor.push_one(*event)]
    else:
        size = size or len(events) or 1
        decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
    return decisions + (processor.finish() if finish else [])


def plain(network, events, every, seed=0):
    return decisions_one_by_one(events, network.volume(), network.dense(seed), every)


@of_all
def test_after_every_event(network):
    events = random_events(300, seed=1, duration_us=2 * WINDOW_US + 900, sensor=network.config.sensor)
    expected = plain(network, events, 1)
    assert len(expected) == 300 + 3  # two closed windows and the end
    for size in (None, 1, 7, 0):
        assert [row(d) for d in decide(Processor(network.model(), every_events=1), events, size)] == expected


@of_some
@pytest.mark.parametrize("every", [2, 257, 10_000])
def test_after_every_so_many_events(network, every):
    events = random_events(3000, seed=3, duration_us=2 * WINDOW_US + 900, sensor=network.config.sensor)
    expected = plain(network, events, every)
    for size in (7, 1300, 0):
        assert [row(d) for d in decide(Processor(network.model(), every_events=every), events, size)] == expected


def test_more_decisions_than_one_compiled_call_makes():
    """Rows for them are made 256 at a time: packets with that many decisions, one less and one more."""
    for n in (255, 256, 257, 512, 513, 1300):
        events = random_events(n, seed=n, duration_us=WINDOW_US, sensor=SMALL.config.sensor)
        for every in (1, 2):
            decisions = decide(Processor(SMALL.model(), every_events=every), events, 0)
            assert [row(d) for d in decisions] == plain(SMALL, events, every)


@given(st.sampled_from(NETWORKS), st.data(), st.sampled_from([1, 1, 2, 5]), st.sampled_from([None, 1, 2, 7, 0]))
def test_nasty_streams(network, data, every, size):
    """Ties, bursts, borders, times that run backwards, also into windows that are closed."""
    events = data.draw(nasty_streams(network.config.sensor, 3 * WINDOW_US, 77))
    decisions = decide(Processor(network.model(), every_events=every), events, size)
    assert [row(d) for d in decisions] == plain(network, events, every)


@of_all
@pytest.mark.parametrize("settings", [{"every_events": 3, "hop_us": 1300}, {"every_us": 50}], ids=str)
def test_the_compiled_path_decides_as_the_general_one(network, settings):
    events = random_events(300, seed=4, duration_us=2 * WINDOW_US, sensor=network.config.sensor)
    regressor = CompiledRegressor(network.model()) if network.config.needs_regressor else None
    dense = network.dense()
    general = Processor(network.config, classifier=lambda volume: dense(volume), regressor=regressor, **settings)
    expected = [key(d) for d in decide(general, events, 0)]
    assert len(expected) > 50
    for size in (1, 7, 300):
        compiled = Processor(network.model(), classes=[str(k) for k in range(network.classes)], **settings)
        assert [key(d) for d in decide(compiled, events, size)] == expected


@of_some
@pytest.mark.parametrize("size", [1, 13])
def test_another_classifier_in_the_middle_of_a_window(network, size):
    """Back and forth, to a classifier that has seen the window before, and one that has not."""
    classifiers = network.classifier(0), network.classifier(1)
    events = random_events(260, seed=1, duration_us=2 * WINDOW_US, sensor=network.config.sensor)
    processor, found, used = Processor(network.config, classifier=classifiers[0], every_events=1), [], []
    for k, first in enumerate(range(0, 260, size)):
        number = k // 3 % 2
        processor.classifier = classifiers[number]
        new = processor.push(events[first : first + size])
        found += [row(d) for d in new]
        used += [number] * len(new)
    both = [plain(network, events, 1, seed) for seed in (0, 1)]
    assert found == [both[number][k] for k, number in enumerate(used)] and {0, 1} == set(used)


@pytest.mark.parametrize("sizes", [(1, 1), (7, 3), (100, 1)])
@pytest.mark.parametrize("hop_us", [None, 1500])
def test_one_classifier_for_two_processors(sizes, hop_us):
    """Two cameras, one network, alternating."""
    shared, settings = DIGITS.classifier(), {"every_events": 2, "hop_us": hop_us}
    streams = [random_events(300, seed=seed, duration_us=2 * WINDOW_US) for seed in (4, 5)]
    both = [Processor(DIGITS.config, classifier=shared, **settings) for _ in streams]
    decisions, at = ([], []), [0, 0]
    while min(at) < 300:
        for k, size in enumerate(sizes):
            decisions[k].extend(both[k].push(streams[k][at[k] : at[k] + size]))
            at[k] += size
            assert both[k].fire().logits.tobytes() == DIGITS.dense()(both[k].volume()).tobytes()
    for k, events in enumerate(streams):
        expected = Processor(DIGITS.model(), **settings).push(events[: at[k]])
        assert [row(d) for d in decisions[k]] == [row(d) for d in expected] and len(expected) > 100


@pytest.mark.parametrize("size", [1, 7, 0])
def test_a_subclass_of_the_compiled_classifier_is_called_itself(size):
    """It may behave differently: Processor must call it like any callable."""

    class Reversed(CompiledClassifier):
        def __call__(self, volume):
            return super().__call__(volume)[::-1].copy()

    events = random_events(60, seed=5, duration_us=WINDOW_US)
    processor = Processor(DIGITS.config, classifier=Reversed(DIGITS.model()), every_events=1)
    expected = [logits for trigger, *_, logits, _ in plain(DIGITS, events, 1) if trigger == "every_events"]
    assert [d.logits[::-1].tobytes() for d in decide(processor, events, size, finish=False)] == expected


def test_arrays_of_a_decision_are_its_own():
    """Those of one packet share one piece of memory: none may reach into another."""
    decisions = Processor(DIGITS.model(), every_events=1).push(random_events(20, seed=6, duration_us=3000))
    before = [key(d) for d in decisions]
    decisions[4].logits[:] = 0
    decisions[4].probabilities[:] = 0
    assert [key(d) for d in decisions[:4] + decisions[5:]] == before[:4] + before[5:]


# -- threads -----------------------------------------------------------------------------------------------------

N_THREADS = 4


@pytest.mark.parametrize("settings", [{"every_events": 1}, {"confidence": 0.9}], ids=str)
def test_processors_in_threads_decide_as_one_after_the_other(settings):
    together = threading.Barrier(N_THREADS)

    def work(seed, wait=lambda: None):
        processor = Processor(DIGITS.model(seed), **settings)
        events = random_events(1500, seed=seed, duration_us=10_000)
        wait()
        return [key(d) for d in decide(processor, events, 300)]

    expected = [work(seed) for seed in range(N_THREADS)]
    with ThreadPoolExecutor(N_THREADS) as threads:
        assert list(threads.map(lambda seed: work(seed, together.wait), range(N_THREADS))) == expected
    assert len({str(decisions) for decisions in expected}) == N_THREADS  # none has another one's


def test_windows_opened_in_threads_are_never_taken_for_each_other():
    """Each window has a number of its own, even where threads open windows at the same time."""

    def open_many(seed):
        volume, numbers = TNTVolume(SMALL.config), []
        for k in range(500):
            volume.open(k)
            numbers.append(int(volume.state().view(np.int64)[S.EPOCH]))
        return numbers

    with ThreadPoolExecutor(N_THREADS) as threads:
        numbers = [number for many in threads.map(open_many, range(N_THREADS)) for number in many]
    assert len(set(numbers)) == N_THREADS * 500


def test_other_threads_run_while_a_packet_is_decided():
    """This thread never gives up the GIL by itself, so the other one runs only where the kernel releases it."""
    processor, events = Processor(DIGITS.model(), every_events=1), random_events(20_000, seed=1, duration_us=3900)
    counted, stop, running = [0], threading.Event(), threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1
            running.set()
            time.sleep(0)  # releases the GIL

    processor.push(events[:10])
    other, interval_s, during = threading.Thread(target=count), sys.getswitchinterval(), 0
    other.start()
    try:
        running.wait(60)
        sys.setswitchinterval(1000.0)
        for _ in range(20):  # a loaded machine may not give the other thread a core at first
            before = counted[0]
            assert len(processor.push(events[10:])) == len(events) - 10
            during += counted[0] - before
            processor.reset()
            if during > 10:
                break
    finally:
        sys.setswitchinterval(interval_s)
        stop.set()
        other.join()
    assert during > 10
