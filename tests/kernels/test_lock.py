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
    """Whether another thread gets the lock while something is computed again and again."""
    ready = threading.Event()
    ran = []
    other = threading.Thread(target=lambda: ran.append(ready.wait()))
    compute()  # It is compiled by now.
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1000)  # seconds: only a release of the lock lets the other go on
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
    decoder = EventDecoder(model.config.sensor)
    classifier = CompiledClassifier(model)
    volumes = [TNTVolume(model.config), TNTVolume(model.config)]
    for volume in volumes:
        volume.update(events)
    columns = EventDecoder(model.config.sensor).decode(events)
    is_large = n >= LARGE
    assert others_run_during(lambda: decoder.decode(events)) == is_large
    assert others_run_during(lambda: [classifier.answer(volume) for volume in volumes]) == is_large
    assert others_run_during(lambda: volumes[0].absorb(columns, 0, n)) == is_large
    # The processor's kernel releases the lock before it calls the others.
    processor = Processor(model, every_events=LARGE)
    assert others_run_during(lambda: processor.push(events))
