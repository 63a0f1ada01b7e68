"""Decisions after 10, 20, 50, ... events of each window, however the recording is cut into packets."""

import numpy as np
from deciding import CONFIG, at, total_and_size
from hypothesis import example, given, settings
from hypothesis import strategies as st
from made import events_of

from async_tnt import Processor
from async_tnt.evaluation.early import FiringProcessor


def decide(events, cuts=(), config=CONFIG, **triggers):
    stream = FiringProcessor(Processor(config, classifier=total_and_size, **triggers))
    decisions = [decision for packet in np.split(events, sorted(cuts)) for decision in stream.push(packet)]
    return decisions + stream.finish()


def events_at(times):
    return events_of(*at(times))


@given(
    times=st.lists(st.integers(0, 5000), min_size=1, max_size=130).map(sorted),
    cuts=st.lists(st.integers(0, 130), max_size=5),
)
@example(times=list(range(60)), cuts=[5, 33])
@settings(deadline=None)
def test_every_window_is_decided_after_so_many_events(times, cuts):
    fired = [(d.window_start_us, d.events) for d in decide(events_at(times), cuts) if d.trigger == "fire"]
    window = (np.array(times) - times[0]) // 1000
    expected = [
        (times[0] + 1000 * k, count) for k in range(6) for count in (10, 20, 50, 100) if (window == k).sum() >= count
    ]
    assert fired == expected
