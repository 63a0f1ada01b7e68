"""Python's lock: other threads run while much is computed; for little it is kept."""

import sys
import threading

import pytest
from made import random_events, random_model

from async_tnt import CompiledClassifier, Processor, TNTVolume
from async_tnt.kernels.jit import BOUNDS_CHECKED
from async_tnt.kernels.lock import LARGE
from async_tnt.volume.events import EventDecoder


def others_run_during(compute) -> bool:
    """Whether another thread, which waits for the lock, gets it while something is computed again
    and again."""
    ready, ran = threading.Event(), []
    other = threading.Thread(target=lambda: ran.append(ready.wait()))
    compute()  # compiled
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1000)  # seconds: nothing but a release lets the other go on
    try:
        other.start()
        ready.set()
        for _ in range(1000):
            compute()
            if ran:
                break
        return bool(ran)
    finally:
        sys.setswitchinterval(interval)
        other.join()


@pytest.mark.skipif(BOUNDS_CHECKED, reason="the lock is kept where indices are checked")
@pytest.mark.parametrize("n", [LARGE - 1, 50 * LARGE])
def test_others_run_while_large_packets_are_added_and_whole_windows_classified(n):
    model = random_model()
    events = random_events(n, seed=1, duration_us=9_000, sensor=model.config.sensor)
    decoder, classifier, volumes = EventDecoder(model.config.sensor), CompiledClassifier(model), []
    for _ in range(2):
        volumes.append(TNTVolume(model.config))
        volumes[-1].update(events)
    columns, is_large = EventDecoder(model.config.sensor).decode(events), n >= LARGE
    assert others_run_during(lambda: decoder.decode(events)) == is_large
    assert others_run_during(lambda: [classifier.answer(volume) for volume in volumes]) == is_large
    assert others_run_during(lambda: volumes[0].absorb(columns, 0, n)) == is_large
    # whose kernel has released it before it calls the others
    processor = Processor(model, every_events=LARGE)
    assert others_run_during(lambda: processor.push(events))
