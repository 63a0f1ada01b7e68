"""Confidence closes a window early, by hand. For any stream: test_triggers_equal_oracle.py.

The classifier's two logits are the events' number and 0, so that after n events the first class has probability
1 / (1 + exp(-n)): .731, .881, .953, .982, .993 ...
"""

from functools import cache

import numpy as np
import pytest
from made import random_model

from async_tnt import CompiledClassifier, Counts, Model, Processor, TNTConfig

CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=1, window_us=1000, transform="none", polarity="unsigned")


def number_of_events(volume):
    return [float(volume.sum()), 0.0]


@cache
def compiled_number_of_events() -> CompiledClassifier:
    """The same, compiled: the network's two poolings take a mean, 16 times it is the sum over a quarter."""
    weights = {name: np.zeros_like(w) for name, w in random_model(CONFIG, classes=2, widths=(1, 1, 1)).weights.items()}
    weights["conv1.weight"][0, 0, 1, 1] = weights["conv2.weight"][0, 0, 1, 1] = 1
    weights["fc1.weight"][:] = 16
    weights["fc2.weight"][0] = 1
    return CompiledClassifier(Model(CONFIG, weights, ("many", "few")))


@pytest.fixture(params=["callable", "compiled"])
def classifier(request):
    return number_of_events if request.param == "callable" else compiled_number_of_events()


def at(*times):
    n = len(times)
    return list(times), [k % 8 for k in range(n)], [k % 5 for k in range(n)], [1] * n


def summary(decisions):
    return [(d.trigger, d.window_start_us, d.time_us, d.events, d.complete) for d in decisions]


BY_HAND = {  # settings, times of events, all decisions, events counted as dropped_decided and dropped_late
    "the event that reaches the level ends the window": (
        {},
        (0, 10, 20, 30, 40),
        [("confidence", 0, 20, 3, True)],
        (2, 0),
    ),
    "the next windows lie on the same grid": (
        {"start_us": 100},
        (150, 160, 170, 180, 1099, 1100, 1101, 1102, 1103, 5500, 5501),
        [("confidence", 100, 170, 3, True), ("confidence", 1100, 1102, 3, True), ("end", 5100, 5501, 2, False)],
        (3, 0),
    ),
    "a window that does not reach it ends as usual": (
        {},
        (0, 900, 1000, 1001, 1002),
        [("window", 0, 900, 2, True), ("confidence", 1000, 1002, 3, True)],
        (0, 0),
    ),
    "events before the window that was closed are late": (
        {"start_us": 1000},
        (1500, 1501, 1502, 1503, 999, 1000, 1999, 5),
        [("confidence", 1000, 1502, 3, True)],
        (3, 2),
    ),
    "events before a window that was closed at its end are late": (
        {"start_us": 0},
        (0, 1, 2, 3, 1000, 2000, 2001, 2002, 5, 2003),
        [("confidence", 0, 2, 3, True), ("window", 1000, 1000, 1, True), ("confidence", 2000, 2002, 3, True)],
        (2, 1),
    ),
    "of two windows closed in a row the first is remembered, too": (
        {"start_us": 0},
        (0, 1, 2, 1000, 1001, 1002, 3),
        [("confidence", 0, 2, 3, True), ("confidence", 1000, 1002, 3, True)],
        (1, 0),
    ),
    "with every_us it is checked only there": (
        {"every_us": 100},
        (0, 50, 150, 160, 170, 180, 290, 1000),
        [("every_us", 0, 50, 2, False), ("confidence", 0, 180, 6, True), ("end", 1000, 1000, 1, False)],
        (1, 0),  # the one at 290 shows that it is 200
    ),
    "at a window's end it is not checked: the window is complete anyhow": (
        {"every_us": 5000},
        (0, 1, 2, 3, 4, 1000),
        [("window", 0, 4, 5, True), ("end", 1000, 1000, 1, False)],
        (0, 0),
    ),
    "overlapping windows continue by themselves": (
        {"every_events": 1, "hop_us": 400},
        (0, 410, 420, 430, 900, 1500),
        [
            ("every_events", 0, 0, 1, False),
            ("every_events", 0, 410, 2, False),
            ("confidence", 0, 420, 3, True),
            ("confidence", 400, 430, 3, True),  # it holds 410 and 420, too, but is the oldest only at 430
            ("every_events", 800, 900, 1, False),
            ("every_events", 800, 1500, 2, False),
            ("end", 800, 1500, 2, False),
            ("end", 1200, 1500, 1, False),
        ],
        (0, 0),
    ),
    "the next window's moments count from its own start": (  # the first would be due at 900, the next one at 500 + 300
        {"every_events": 3, "every_us": 300, "hop_us": 500},
        (0, 510, 650, 850),
        [
            ("every_us", 0, 0, 1, False),
            ("every_us", 0, 510, 2, False),
            ("confidence", 0, 650, 3, True),
            ("every_us", 500, 650, 2, False),
            ("confidence", 500, 850, 3, True),
        ],
        (0, 0),
    ),
}


@pytest.mark.parametrize(("settings", "times", "expected", "dropped"), BY_HAND.values(), ids=BY_HAND)
@pytest.mark.parametrize("single", [False, True])
def test_by_hand(classifier, settings, times, expected, dropped, single):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, **settings)
    decisions = [d for t in times for d in processor.push(at(t))] if single else processor.push(at(*times))
    assert summary(decisions + processor.finish()) == expected
    counts = processor.counts
    assert (counts.received, counts.dropped_decided, counts.dropped_late) == (len(times), *dropped)
    for decision in decisions:
        assert decision.probability == pytest.approx(1 / (1 + np.exp(-float(decision.events))))


def test_switched_off_after_it_closed_a_window(classifier):
    """Events that still arrive for that window are dropped, on the path without triggers, too."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95)
    processor.push(at(0, 1, 2))
    processor.confidence = None
    for t in (3, 4, 999):
        assert processor.push_one(t, 1, 1, 1) == []
    assert processor.counts == Counts(received=6, kept=3, dropped_decided=3)
    assert processor.push(at(1000)) == []
    assert summary(processor.finish()) == [("end", 1000, 1000, 1, False)]


@pytest.mark.parametrize("way", ["callable", "compiled"])
@pytest.mark.parametrize("n_classes, probability", [(1, 1.0), (2, 0.5), (4, 0.25)])
def test_a_level_that_is_just_reached(way, n_classes, probability):
    """Classes that are all alike: exactly 1 / n each."""
    model = random_model(CONFIG, classes=n_classes, widths=(1, 1, 1))
    alike = {name: np.zeros_like(w) for name, w in model.weights.items()}
    compiled = CompiledClassifier(Model(CONFIG, alike, model.classes))
    classifier = compiled if way == "compiled" else lambda volume: [0.0] * n_classes
    for confidence, closes in ((probability, True), (min(1.0, np.nextafter(probability, 2)), n_classes == 1)):
        for push in (lambda p: p.push_one(0, 1, 1, 1), lambda p: p.push(at(0))):
            processor = Processor(CONFIG, classifier=classifier, confidence=confidence)
            assert summary(push(processor)) == ([("confidence", 0, 0, 1, True)] if closes else [])
