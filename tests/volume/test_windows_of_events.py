"""Windows of a number of events, by hand: where they begin and end, when they are decided, how time is scaled."""

import numpy as np
import pytest

from async_tnt import Processor, TNTConfig, TNTVolume

CONFIG = TNTConfig(sensor=(5, 3), grid=(5, 3), bins=3, t_max=2.0, landmark="center", window_events=3)


def process(**settings):
    config = CONFIG.replace(**settings.pop("config", {}))
    return Processor(config, classifier=lambda volume: [volume.sum(), 0.0], **settings)


def of(decisions):
    return [(d.trigger, d.window_start_us, d.time_us, d.events, d.complete) for d in decisions]


def at(*times):
    return [(t, 2, 1, 1) for t in times]


def test_a_window_is_decided_with_its_last_event_and_the_next_begins_with_the_one_after():
    processor = process()
    expected = {20: [("window", 5, 20, 3, True)], 1000: [("window", 900, 1000, 3, True)]}
    for event in at(5, 7, 20, 900, 950, 1000, 1001):
        assert of(processor.push_one(*event)) == expected.get(event[0], [])
    assert of(processor.finish()) == [("end", 1001, 1001, 1, False)]
    assert processor.counts.received == 7 and processor.counts.dropped_late == 0


def test_a_late_event_is_not_one_of_them_and_a_long_pause_ends_a_window():
    processor = process(config={"window_us": 100})
    events = np.array(at(50, 40, 60, 149, 30, 130, 260), [("t", int), ("x", int), ("y", int), ("p", int)])
    assert of(processor.push(events)) == [
        ("window", 50, 149, 3, True),
        ("window", 30, 30, 1, True),
        ("window", 130, 130, 1, True),
    ]
    assert of([processor.fire()]) == [("fire", 260, 260, 1, False)]
    assert processor.counts.dropped_late == 1


def test_the_other_triggers_decide_within_them_and_a_confident_one_begins_the_next():
    processor = process(every_events=2)
    assert of(processor.push(at_once(1, 2, 3, 4, 5))) == [
        ("every_events", 1, 2, 2, False),
        ("window", 1, 3, 3, True),
        ("every_events", 4, 5, 2, False),
    ]
    processor = process(confidence=0.9, config={"transform": "none", "window_events": 9})
    decisions = of(processor.push(at_once(1, 2, 3, 4, 5, 6, 7, 8)))
    assert decisions == [("confidence", 1, 3, 3, True), ("confidence", 4, 6, 3, True)]
    assert processor.counts.dropped_decided == 0


def at_once(*times):
    return tuple(np.array(column) for column in zip(*at(*times), strict=True))


def test_times_are_scaled_by_the_newest_event():
    """At TNT time 1 an event stays where it is, at 2 it is at half its distance from the centre; the last bin is the
    newest event's."""
    volume = TNTVolume(CONFIG)
    volume.update(([100, 150], [4, 4], [1, 1], [1, 1]))
    expected = np.zeros((3, 3, 5))
    expected[2, 1, 3] = 1  # tau = 2; the first event, at tau = 0, is dropped
    assert np.array_equal(volume.array, expected)
    volume.update_one(200, 2, 1, 0)
    expected[:] = 0
    expected[1, 1, 4] = 1  # now tau = 1, in the middle bin
    expected[2, 1, 2] = -1
    assert np.array_equal(volume.array, expected)
    assert volume.counts.dropped_tau_zero == 1
    volume.update_one(201, 0, 0, 1)  # the next window: one event, no duration
    assert not volume.array.any() and (volume.start_us, volume.n_events) == (201, 1)


def test_equal_times_make_windows_that_begin_at_the_same_moment():
    processor = process()
    assert of(processor.push(at_once(7, 7, 7, 7, 7, 7, 8))) == [("window", 7, 7, 3, True)] * 2
    assert of(processor.finish()) == [("end", 8, 8, 1, False)]


@pytest.mark.parametrize("retry", [lambda p: p.push([]), lambda p: p.finish(), lambda p: p.push(at_once(9))])
def test_a_decision_that_failed_is_made_up_for(retry):
    answers = iter([ValueError("not now"), [1.0, 0.0], [1.0, 0.0]])

    def classify(volume):
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    processor = Processor(CONFIG, classifier=classify)
    with pytest.raises(ValueError, match="not now"):
        processor.push(at_once(1, 2, 3))
    assert of(retry(processor)) == [("window", 1, 3, 3, True)]
