"""A classifier that fails in the middle of a packet.

The tests say which events are absorbed, and that the stream continues.
"""

import pytest
from deciding import CONFIG, at, key, summary, total_and_size
from made import random_events

from async_tnt import Processor

SETTINGS = [
    {},
    {"every_us": 70},
    {"every_us": 70, "confidence": 0.999, "hop_us": 400},
    {"every_events": 1, "hop_us": 300},
]


def failing(*fails, **settings):
    """A Processor whose classifier fails at its n-th answers."""
    asked = []

    def classifier(volume):
        asked.append(volume)
        if len(asked) in fails:
            raise RuntimeError("out of memory")
        return total_and_size(volume)

    return Processor(CONFIG, classifier=classifier, **settings)


def push_all(processor, events, size):
    """Push events in packets, after an error again from the first event that was not processed.

    Returns the decisions and the number of errors.
    """
    decisions = []
    errors = 0
    first = 0
    while first < len(events):
        try:
            decisions += processor.push(events[first : first + size])
        except RuntimeError:
            errors += 1
        first = processor.counts.received
    return [key(d) for d in decisions], errors


@pytest.mark.parametrize("settings", SETTINGS, ids=str)
@pytest.mark.parametrize("size", [1, 300])
def test_no_event_is_lost_or_absorbed_twice(settings, size):
    events = random_events(300, seed=3, duration_us=4000)
    untroubled = failing(**settings)
    troubled = failing(2, 3, 4, **settings)
    expected, _ = push_all(untroubled, events, size)
    decisions, errors = push_all(troubled, events, size)
    assert errors == 3 and untroubled.counts.received == troubled.counts.received == 300
    if "confidence" not in settings:
        assert troubled.counts == untroubled.counts
        # `every_events` decides after the event, so its decisions may differ.
        if size == 1 and "every_events" not in settings:
            assert decisions == expected != []
    assert [key(d) for d in troubled.finish()] == [key(d) for d in untroubled.finish()]


@pytest.mark.parametrize(
    "retry", [lambda p: p.push([]), lambda p: p.finish(), lambda p: p.push(at([9]))]
)
def test_a_window_of_events_whose_decision_failed_is_made_up_for(retry):
    answers = iter([ValueError("not now"), [1.0, 0.0], [1.0, 0.0]])

    def classify(volume):
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    processor = Processor(CONFIG.replace(window_events=3), classifier=classify)
    with pytest.raises(ValueError, match="not now"):
        processor.push(at([1, 2, 3]))
    assert summary(retry(processor)) == [("window", 1, 3, 3)]
