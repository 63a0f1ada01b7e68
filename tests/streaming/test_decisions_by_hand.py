"""Which decisions fall when, by hand, for every trigger.

For any stream: test_triggers_equal_oracle.py.

The classifier's two logits are the events' number and 0, so that after n events the first class has
probability 1 / (1 + exp(-n)): .731, .881, .953, .982, .993 ...
"""

from functools import cache

import numpy as np
import pytest
from deciding import summary
from made import random_model, thesis_model

from async_tnt import CompiledClassifier, Processor, TNTConfig

pytestmark = pytest.mark.filterwarnings("ignore:.* it never makes a decision due")
CONFIG = TNTConfig(
    sensor=(8, 8), grid=(8, 8), bins=1, window_us=1000, transform="none", polarity="unsigned"
)


def number_of_events(volume):
    return [float(volume.sum()), 0.0]


@cache
def compiled_number_of_events() -> CompiledClassifier:
    """The same, compiled.

    The network's two poolings take a mean of 16 places, so 16 times the mean is their sum.
    """
    model = random_model(CONFIG, classes=2, widths=(1, 1, 1))
    weights = {name: np.zeros_like(weight) for name, weight in model.weights.items()}
    weights["conv1.weight"][0, 0, 1, 1] = 1
    weights["conv2.weight"][0, 0, 1, 1] = 1
    weights["fc1.weight"][:] = 16
    weights["fc2.weight"][0] = 1
    return CompiledClassifier(thesis_model(CONFIG, weights, ("many", "few")))


@pytest.fixture(params=["callable", "compiled"])
def classifier(request):
    return number_of_events if request.param == "callable" else compiled_number_of_events()


def at(*times):
    n = len(times)
    return list(times), [k % 8 for k in range(n)], [k % 5 for k in range(n)], [1] * n


SURE = {"confidence": 0.95}
BY_3 = {"config": {"window_events": 3}}
# settings, times of events, all decisions, events counted as dropped_decided and dropped_late if
# any
BY_HAND = {
    # -- windows
    "windows start where asked, and earlier events are late": (
        {"start_us": 7000},
        (5, 7000, 7001, 6, 7999, 7, 8000, 9500, 8),
        [("window", 7000, 7999, 3), ("window", 8000, 8000, 1), ("end", 9000, 9500, 1)],
        (0, 4),
    ),
    "empty windows are skipped, however many, up to one that starts at the event": (
        {"start_us": 0},
        (0, 10**14),
        [("window", 0, 0, 1), ("end", 10**14, 10**14, 1)],
    ),
    "overlapping windows each hold their own events": (
        {"hop_us": 500},
        (0, 400, 700, 1000, 1500, 2400),
        [
            ("window", 0, 700, 3),
            ("window", 500, 1000, 2),
            ("window", 1000, 1500, 2),
            ("end", 1500, 2400, 2),
            ("end", 2000, 2400, 1),
        ],
    ),
    # -- every_us, every_events
    "every_us counts from the window's start": (
        {"every_us": 200},
        (100, 150, 350, 360, 900, 1250),
        [
            ("every_us", 100, 150, 2),  # at 300, without the event that shows the time
            ("every_us", 100, 360, 4),  # at 500; at 700 nothing new
            # at 900 the fifth event is new, but shows up at 1100 with the window's end
            ("window", 100, 900, 5),
            ("end", 1100, 1250, 1),
        ],
    ),
    "every_events counts within the window": (
        {"every_events": 2},
        (0, 1, 2, 3, 4, 1000, 1001),
        [
            ("every_events", 0, 1, 2),
            ("every_events", 0, 3, 4),
            ("window", 0, 4, 5),
            ("every_events", 1000, 1001, 2),
            ("end", 1000, 1001, 2),
        ],
    ),
    "late events make nothing due": (
        {"every_events": 2, "every_us": 300, "start_us": 1000},
        (1000, 5, 6, 7, 1001, 5, 6, 7, 8, 1500, 1700),
        [
            ("every_events", 1000, 1001, 2),
            ("every_us", 1000, 1500, 3),
            ("every_events", 1000, 1700, 4),
            ("end", 1000, 1700, 4),
        ],
        (0, 7),
    ),
    # -- confidence
    "the event that reaches the level ends the window": (
        SURE,
        (0, 10, 20, 30, 40),
        [("confidence", 0, 20, 3)],
        (2, 0),
    ),
    "the next windows lie on the same grid": (
        SURE | {"start_us": 100},
        (150, 160, 170, 180, 1099, 1100, 1101, 1102, 1103, 5500, 5501),
        [("confidence", 100, 170, 3), ("confidence", 1100, 1102, 3), ("end", 5100, 5501, 2)],
        (3, 0),
    ),
    "events before the window that was closed are late": (
        SURE | {"start_us": 1000},
        (1500, 1501, 1502, 1503, 999, 1000, 1999, 5),
        [("confidence", 1000, 1502, 3)],
        (3, 2),
    ),
    "of two windows closed in a row the first is remembered, too": (
        SURE | {"start_us": 0},
        (0, 1, 2, 1000, 1001, 1002, 3),
        [("confidence", 0, 2, 3), ("confidence", 1000, 1002, 3)],
        (1, 0),
    ),
    "with every_us it is checked only there": (
        SURE | {"every_us": 100},
        (0, 50, 150, 160, 170, 180, 290, 1000),
        [("every_us", 0, 50, 2), ("confidence", 0, 180, 6), ("end", 1000, 1000, 1)],
        (1, 0),  # the one at 290 shows that it is 200
    ),
    "at a window's end it is not checked: the window is complete anyhow": (
        SURE | {"every_us": 5000},
        (0, 1, 2, 3, 4, 1000),
        [("window", 0, 4, 5), ("end", 1000, 1000, 1)],
    ),
    # -- windows of a number of events
    "a window of events is decided with its last one, and the next begins with the one after": (
        BY_3,
        (5, 7, 20, 900, 950, 1000, 1001),
        [("window", 5, 20, 3), ("window", 900, 1000, 3), ("end", 1001, 1001, 1)],
    ),
    "a late event is not one of them, and a long pause ends a window": (
        {"config": {"window_events": 3, "window_us": 100}},
        (50, 40, 60, 149, 30, 130, 260),
        [
            ("window", 50, 149, 3),
            ("window", 30, 30, 1),
            ("window", 130, 130, 1),
            ("end", 260, 260, 1),
        ],
        (0, 1),
    ),
    "a confident one begins the next": (
        SURE | {"config": {"window_events": 9}},
        (1, 2, 3, 4, 5, 6, 7, 8),
        [("confidence", 1, 3, 3), ("confidence", 4, 6, 3), ("end", 7, 8, 2)],
    ),
}


@pytest.mark.parametrize("name", BY_HAND)
@pytest.mark.parametrize("single", [False, True])
def test_by_hand(classifier, name, single):
    settings, times, expected, *dropped = BY_HAND[name]
    settings = dict(settings)
    processor = Processor(
        CONFIG.replace(**settings.pop("config", {})), classifier=classifier, **settings
    )
    decisions = (
        [d for t in times for d in processor.push(at(t))] if single else processor.push(at(*times))
    )
    decisions += processor.finish()
    assert summary(decisions) == expected
    counts = processor.counts
    assert [(counts.dropped_decided, counts.dropped_late)] == (dropped or [(0, 0)])
    for decision in decisions:
        assert decision.complete == (decision.trigger in ("window", "confidence"))
        assert decision.probability == pytest.approx(1 / (1 + np.exp(-float(decision.events))))


@pytest.mark.parametrize("way", ["callable", "compiled"])
@pytest.mark.parametrize("n_classes, probability", [(1, 1.0), (2, 0.5), (4, 0.25)])
def test_a_level_that_is_just_reached(way, n_classes, probability):
    """Classes that are all alike: exactly 1 / n each."""
    model = random_model(CONFIG, classes=n_classes, widths=(1, 1, 1))
    alike = {name: np.zeros_like(w) for name, w in model.weights.items()}
    compiled = CompiledClassifier(thesis_model(CONFIG, alike, model.classes))
    classifier = compiled if way == "compiled" else lambda volume: [0.0] * n_classes
    for confidence, closes in (
        (probability, True),
        (min(1.0, np.nextafter(probability, 2)), n_classes == 1),
    ):
        for push in (lambda p: p.push_one(0, 1, 1, 1), lambda p: p.push(at(0))):
            processor = Processor(CONFIG, classifier=classifier, confidence=confidence)
            assert summary(push(processor)) == ([("confidence", 0, 0, 1)] if closes else [])


def test_fire_leaves_the_window_open_however_sure_it_is(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.9, every_us=500)
    processor.push(at(0, 1, 2, 3))
    decision = processor.fire()
    assert summary([decision]) == [("fire", 0, 3, 4)]
    assert decision.probability > 0.9 and not decision.complete
    assert summary(processor.push(at(600))) == [("confidence", 0, 3, 4)]


def test_a_trigger_that_is_changed_in_midstream_looks_ahead(classifier):
    processor = Processor(CONFIG, classifier=classifier)
    processor.push(at(0, 450))
    processor.every_us = 200  # 200 and 400 are over
    assert processor.push(at(500)) == []
    assert summary(processor.push(at(600))) == [("every_us", 0, 500, 3)]


def test_no_events_no_decisions(classifier):
    """Time passes with events only."""
    triggers = {"every_us": 1, "every_events": 1, "confidence": 0.01}
    processor = Processor(CONFIG, classifier=classifier, start_us=0, **triggers)
    for empty in (None, [], at()):
        assert processor.push(empty) == []
    assert processor.finish() == [] and processor.counts.received == 0


def test_a_stream_may_continue_after_finish(classifier):
    processor = Processor(CONFIG, classifier=classifier)
    processor.push(at(0, 10))
    assert summary(processor.finish()) == [("end", 0, 10, 2)]
    assert processor.finish() == []
    assert processor.fire().events == 0
    assert not processor.volume().any()
    assert processor.counts.received == 2
    assert processor.push_one(500, 3, 3, 1) == [] and processor.counts.dropped_late == 1
    assert processor.push_one(1500, 3, 3, 1) == []
    assert summary(processor.finish()) == [("end", 1000, 1500, 1)]


@pytest.mark.parametrize("settings", [{}, {"every_events": 1}, {"every_us": 100}], ids=str)
def test_of_equal_logits_the_first_class_decides(settings):
    weights = {
        name: np.zeros_like(w)
        for name, w in random_model(CONFIG, classes=3, widths=(1, 1, 1)).weights.items()
    }
    weights["fc2.bias"] = np.float32([0, 1, 1])
    compiled = CompiledClassifier(thesis_model(CONFIG, weights, ("a", "b", "c")))
    for classifier in (compiled, lambda volume: [0.0, 1.0, 1.0]):
        processor = Processor(CONFIG, classifier=classifier, classes=("a", "b", "c"), **settings)
        decisions = processor.push(([0, 250, 400, 1_000], [1, 2, 3, 4], [1, 2, 3, 4], [1, 1, 1, 1]))
        decisions.append(processor.fire())
        assert {(decision.label, decision.index) for decision in decisions} == {("b", 1)}
