"""Confidence closes a window early: by hand, and as laws.

The classifier's two logits are the events' number and 0, so that after n events the first class has probability
1 / (1 + exp(-n)): .731, .881, .953, .982, .993 ...
"""

import numpy as np
import pytest
from deciding import key
from hypothesis import given, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_model

from async_tnt import CompiledClassifier, Counts, LeakyIntegrator, Model, Processor, TNTConfig

CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=1, window_us=1000, transform="none", polarity="unsigned")


def number_of_events(volume):
    return [float(volume.sum()), 0.0]


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


def test_the_window_ends_with_the_event_that_makes_it_sure(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95)
    assert processor.push(at(0, 10)) == []
    (decision,) = processor.push(at(20, 30, 40))
    assert summary([decision]) == [("confidence", 0, 20, 3, True)]
    assert decision.probability == pytest.approx(1 / (1 + np.exp(-3.0)))
    assert processor.counts == Counts(received=5, kept=3, dropped_decided=2)


def test_what_follows_lies_on_the_same_grid(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, start_us=100)
    decisions = processor.push(at(150, 160, 170, 180, 1099, 1100, 1101, 1102, 1103, 5500, 5501))
    assert summary(decisions + processor.finish()) == [
        ("confidence", 100, 170, 3, True),
        ("confidence", 1100, 1102, 3, True),
        ("end", 5100, 5501, 2, False),
    ]
    assert processor.counts == Counts(received=11, kept=8, dropped_decided=3)


def test_a_window_that_is_never_sure_ends_as_ever(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95)
    assert summary(processor.push(at(0, 900, 1000, 1001, 1002))) == [
        ("window", 0, 900, 2, True),
        ("confidence", 1000, 1002, 3, True),
    ]


def test_events_from_before_the_decided_window_are_late_and_not_decided(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, start_us=1000)
    processor.push(at(1500, 1501, 1502, 1503, 999, 1000, 1999, 5))
    assert processor.counts == Counts(received=8, kept=3, dropped_decided=3, dropped_late=2)


@pytest.mark.parametrize("size", [1, 2, 9])
def test_with_every_events_it_is_looked_for_only_there(classifier, size):
    """Sure after the third event, but nobody asks before the fourth."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_events=2)
    t, x, y, p = at(*range(9))
    decisions = [
        d
        for k in range(0, 9, size)
        for d in processor.push((t[k : k + size], x[k:][:size], y[k:][:size], p[k:][:size]))
    ]
    assert summary(decisions) == [("every_events", 0, 1, 2, False), ("confidence", 0, 3, 4, True)]
    assert processor.counts.dropped_decided == 5


def test_with_every_us_it_is_looked_for_only_there(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_us=100)
    decisions = processor.push(at(0, 50, 150, 160, 170, 180, 290, 1000))
    assert summary(decisions) == [("every_us", 0, 50, 2, False), ("confidence", 0, 180, 6, True)]
    assert processor.counts == Counts(received=8, kept=7, dropped_decided=1)  # the one at 290 tells that it is 200


def test_with_activity_it_is_looked_for_only_there(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, activity=LeakyIntegrator(2.0, 1e9))
    decisions = processor.push(at(0, 0, 1, 1, 1, 1))
    assert summary(decisions) == [("activity", 0, 0, 2, False), ("confidence", 0, 1, 4, True)]


def test_at_a_windows_end_it_is_not_looked_for(classifier):
    """It is complete anyhow, and says why."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_us=5000)
    assert summary(processor.push(at(0, 1, 2, 3, 4, 1000))) == [("window", 0, 4, 5, True)]
    assert summary(processor.finish()) == [("end", 1000, 1000, 1, False)]


def test_fire_says_how_sure_it_is_and_closes_nothing(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_events=5)
    processor.push(at(0, 1, 2, 3))
    assert summary([processor.fire()]) == [("fire", 0, 3, 4, False)] and processor.fire().probability > 0.95
    assert summary(processor.push(at(4))) == [("confidence", 0, 4, 5, True)]


def test_between_a_decided_window_and_the_next_there_is_none(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95)
    processor.push(at(700, 701, 702))
    for _ in range(2):
        assert processor.fire().events == 0 and not processor.volume().any()
        assert processor.landmark == (3.5, 3.5) and processor.finish() == []
    assert processor.push_one(710, 3, 3, 1) == []
    assert processor.counts.dropped_decided + processor.counts.dropped_late == 1
    assert processor.push(at(1700, 1701)) == []
    assert summary(processor.push_one(1702, 3, 3, 1)) == [("confidence", 1700, 1702, 3, True)]


@pytest.mark.parametrize("single", [False, True])
def test_switched_off_after_a_window_was_decided(classifier, single):
    """What comes for that window is still dropped, on the way that events take without triggers, too."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95)
    processor.push(at(0, 1, 2))
    processor.confidence = None
    for t in (3, 4, 999):
        assert (processor.push_one(t, 1, 1, 1) if single else processor.push(at(t))) == []
    assert processor.counts == Counts(received=6, kept=3, dropped_decided=3)
    assert (processor.push_one(1000, 1, 1, 1) if single else processor.push(at(1000))) == []
    assert summary(processor.finish()) == [("end", 1000, 1000, 1, False)]


def test_a_lower_level_comes_into_force_with_the_next_event(classifier):
    processor = Processor(CONFIG, classifier=classifier, confidence=0.999)
    assert processor.push(at(0, 1, 2, 3)) == []
    processor.confidence = 0.9
    assert summary(processor.push(at(4))) == [("confidence", 0, 4, 5, True)]


def test_level_one_needs_certainty():
    """exp(-40) beside 1 is lost in float64; exp(-30) is not."""
    logits = [[30.0, 0.0], [36.0, 0.0], [40.0, 0.0]]
    processor = Processor(CONFIG, classifier=lambda volume: logits[int(volume.sum()) - 1], confidence=1.0)
    assert summary(processor.push(at(0, 1, 2, 3))) == [("confidence", 0, 2, 3, True)]


@pytest.mark.parametrize("way", ["callable", "compiled"])
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("n_classes, probability", [(1, 1.0), (2, 0.5), (4, 0.25)])
def test_a_level_that_is_just_reached(way, single, n_classes, probability):
    """Classes that are all alike: exactly 1 / n each."""
    model = random_model(CONFIG, classes=n_classes, widths=(1, 1, 1))
    alike = {name: np.zeros_like(w) for name, w in model.weights.items()}
    compiled = CompiledClassifier(Model(CONFIG, alike, model.classes))
    classifier = compiled if way == "compiled" else lambda volume: [0.0] * n_classes
    for confidence, closes in ((probability, True), (min(1.0, np.nextafter(probability, 2)), n_classes == 1)):
        processor = Processor(CONFIG, classifier=classifier, confidence=confidence)
        decisions = processor.push_one(0, 1, 1, 1) if single else processor.push(at(0))
        assert summary(decisions) == ([("confidence", 0, 0, 1, True)] if closes else [])


def test_overlapping_windows_go_on_by_themselves(classifier):
    """The oldest is decided early; the next one, which has seen the same events, is the oldest then."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_events=1, hop_us=400)
    decisions = processor.push(at(0, 410, 420, 430, 900, 1500))
    assert summary(decisions) == [
        ("every_events", 0, 0, 1, False),
        ("every_events", 0, 410, 2, False),
        ("confidence", 0, 420, 3, True),
        ("confidence", 400, 430, 3, True),  # 410 and 420 are in it, too, but it spoke first at 430
        ("every_events", 800, 900, 1, False),
        ("every_events", 800, 1500, 2, False),
    ]
    assert summary(processor.finish()) == [("end", 800, 1500, 2, False), ("end", 1200, 1500, 1, False)]


@pytest.mark.parametrize("single", [False, True])
def test_the_next_windows_moments_count_from_its_own_start(classifier, single):
    """The first window would speak at 900 next; the one that follows it does at 500 + 300."""
    processor = Processor(CONFIG, classifier=classifier, confidence=0.95, every_events=3, every_us=300, hop_us=500)
    times = (0, 510, 650, 850)
    decisions = [d for t in times for d in processor.push(at(t))] if single else processor.push(at(*times))
    assert summary(decisions) == [
        ("every_us", 0, 0, 1, False),
        ("every_us", 0, 510, 2, False),
        ("confidence", 0, 650, 3, True),
        ("every_us", 500, 650, 2, False),
        ("confidence", 500, 850, 3, True),
    ]


triggers = st.sampled_from(
    [{}, {"every_events": 1}, {"every_events": 3}, {"every_us": 90}, {"activity": LeakyIntegrator(2.5, 300.0)}]
)


@settings(max_examples=150, deadline=None)
@given(
    events=nasty_streams((8, 8), 3500, 50),
    triggers=triggers,
    confidence=st.sampled_from([0.7, 0.95, 0.999]),
    hop_us=st.sampled_from([None, 300]),
    size=st.sampled_from([1, 7, 100]),
    way=st.booleans(),
)
def test_nothing_is_said_twice_or_after_a_window_is_over(events, triggers, confidence, hop_us, size, way):
    classifier = number_of_events if way else compiled_number_of_events()
    processor = Processor(CONFIG, classifier=classifier, confidence=confidence, hop_us=hop_us, **triggers)
    decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
    decisions += processor.finish()
    over, oldest_us = set(), -1
    for decision in decisions:
        assert decision.window_start_us not in over  # complete is complete
        assert decision.window_start_us >= oldest_us  # windows are spoken of in their order
        oldest_us = decision.window_start_us
        assert (decision.window_start_us - int(events["t"][0])) % (hop_us or 1000) == 0
        assert decision.complete == (decision.trigger in ("window", "confidence"))
        assert (decision.trigger == "confidence") <= (decision.probability >= confidence)
        if decision.complete:
            over.add(decision.window_start_us)
    assert len({(d.window_start_us, d.events, d.trigger) for d in decisions}) == len(decisions)
    counts = processor.counts
    assert counts.received == len(events)
    if hop_us is None:
        assert counts.received == counts.kept + counts.dropped_late + counts.dropped_decided
        last = {d.window_start_us: d.events for d in decisions}
        assert sum(last.values()) == counts.kept


@pytest.mark.parametrize("hop_us", [1000, 300])
def test_other_windows_are_as_they_would_be_without(hop_us):
    """Whatever became of a window, those that end by themselves say the same as without confidence."""
    events = random_events(400, seed=2, duration_us=20_000, sensor=(8, 8))
    plain = Processor(CONFIG, classifier=number_of_events, hop_us=hop_us, start_us=0)
    early = Processor(CONFIG, classifier=number_of_events, hop_us=hop_us, start_us=0, confidence=1 - 1e-8)
    everything = {d.window_start_us: key(d) for d in plain.push(events) + plain.finish()}
    ended = early.push(events) + early.finish()
    assert {"window", "confidence", "end"} >= {d.trigger for d in ended} >= {"window", "confidence"}
    assert all(key(d) == everything[d.window_start_us] for d in ended if d.trigger != "confidence")
    assert [d.window_start_us for d in ended] == list(everything)
