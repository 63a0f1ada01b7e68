"""Several threads, each with its own processor, at the same time; and what releases the GIL."""

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from deciding import key
from incremental.cases import CASES, Case, model_of
from made import random_events

from async_tnt import CompiledClassifier, Processor, TNTVolume
from async_tnt.kernels import state as S

N_THREADS = 4


def decide(case: Case, seed: int, together: threading.Barrier | None = None, **settings):
    processor = Processor(model_of(case, seed), **settings)
    events = random_events(1500, seed=seed, duration_us=10_000, sensor=case.config.sensor)
    if together is not None:
        together.wait()
    decisions = [d for k in range(0, len(events), 300) for d in processor.push(events[k : k + 300])]
    return [key(d) for d in decisions + processor.finish()]


@pytest.mark.parametrize("settings", [{"every_events": 1}, {"confidence": 0.9}, {"every_us": 40}], ids=str)
@pytest.mark.parametrize("case", [CASES[5], CASES[7]], ids=str)
def test_processors_in_threads_decide_as_one_after_the_other(case, settings):
    expected = [decide(case, seed, **settings) for seed in range(N_THREADS)]
    together = threading.Barrier(N_THREADS)
    with ThreadPoolExecutor(N_THREADS) as threads:
        found = [threads.submit(decide, case, seed, together, **settings) for seed in range(N_THREADS)]
    assert [one.result() for one in found] == expected
    assert len({str(decisions) for decisions in expected}) == N_THREADS  # none has another one's


def test_volumes_made_in_threads_are_never_taken_for_each_other():
    """Each window has a number of its own, even where threads open windows at the same time."""
    case = CASES[1]

    def open_many(seed):
        volume, numbers = TNTVolume(case.config), []
        for k in range(500):
            volume.open(k)
            numbers.append(int(volume.state().view(np.int64)[S.EPOCH]))
        return numbers

    with ThreadPoolExecutor(N_THREADS) as threads:
        numbers = [number for many in threads.map(open_many, range(N_THREADS)) for number in many]
    assert len(set(numbers)) == N_THREADS * 500


def test_other_threads_go_on_while_a_packet_is_decided():
    """This thread never gives up the GIL by itself, so the other one runs only where the kernel releases it."""
    case = CASES[7]
    processor = Processor(model_of(case), every_events=1)
    events = random_events(20_000, seed=1, duration_us=3900)
    processor.push(events[:10])
    counted, stop, running = [0], threading.Event(), threading.Event()

    def count():
        while not stop.is_set():
            counted[0] += 1
            running.set()
            time.sleep(0)  # releases the GIL

    other = threading.Thread(target=count)
    interval_s = sys.getswitchinterval()
    other.start()
    try:
        running.wait()
        sys.setswitchinterval(1000.0)
        before = counted[0]
        decisions = processor.push(events[10:])
        during = counted[0] - before
    finally:
        sys.setswitchinterval(interval_s)
        stop.set()
        other.join()
    assert len(decisions) == len(events) - 10
    assert during > 10


def test_a_classifier_in_another_thread_than_before():
    """One at a time, it may move."""
    case = CASES[7]
    network, dense, volume = CompiledClassifier(model_of(case)), CompiledClassifier(model_of(case)), case.volume()
    for event in random_events(40, seed=2, duration_us=3900).tolist():
        volume.update_one(*event)
        with ThreadPoolExecutor(1) as thread:  # a new one each time
            found = thread.submit(network.refresh, volume).result()
        assert found.tobytes() == dense(volume.array).tobytes()
