"""UntransformedVolume where a processor's window is not what the events alone would tell."""

import numpy as np
import pytest
from made import events_of, random_events

from async_tnt import Processor, TNTConfig, TNTVolume
from async_tnt.views.untransformed_volume import UntransformedVolume

CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), window_us=1_000, bins=3)


def test_a_window_that_starts_at_zero_before_the_first_event():
    processor, twin = Processor(CONFIG, classifier=lambda v: [0.0], start_us=0), UntransformedVolume(CONFIG)
    events = events_of([600, 1_200], [1, 2], [3, 4], [1, 0])
    processor.push(events[:1])
    truth = TNTVolume(CONFIG.replace(transform="none"))
    truth.open(0)
    truth.update(events[:1])
    assert np.array_equal(twin.follow([events[:1]], processor.fire()), truth.array)
    processor.push(events[1:])
    truth.update(events[1:])
    assert truth.start_us == 1_000
    assert np.array_equal(twin.follow([events[1:]], processor.fire()), truth.array)


def test_a_window_just_closed_by_its_newest_event_is_empty():
    processor = Processor(CONFIG, classifier=lambda v: [20.0 * (np.abs(v).sum() > 0), 0.0], confidence=0.9)
    twin = UntransformedVolume(CONFIG)
    events = random_events(40, duration_us=5_000, sensor=(8, 8), start_us=300)
    n_closed = 0
    for k in range(len(events)):
        packet = events[k : k + 1]
        n_closed += sum(d.trigger == "confidence" for d in processor.push(packet))
        now = processor.fire()
        raw = twin.follow([packet], now)
        if now.events == 0:
            assert not raw.any()
    assert n_closed >= 4


def test_events_that_went_another_way_are_refused():
    processor, twin = Processor(CONFIG, classifier=lambda v: [0.0]), UntransformedVolume(CONFIG)
    events = random_events(10, duration_us=900, sensor=(8, 8))
    processor.push(events)
    with pytest.raises(ValueError, match=r"the raw volume has 5 events from .* the processor's window 10 from"):
        twin.follow([events[:5]], processor.fire())
