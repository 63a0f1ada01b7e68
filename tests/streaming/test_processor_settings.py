"""Processor: classifiers, settings, and what must not harm it."""

import numpy as np
import pytest
from deciding import CONFIG, at, key, run, total_and_size
from made import events_of, random_events, random_model

from async_tnt import Processor, ReplayBufferFull


def test_decision_carries_logits_probabilities_and_label():
    processor = Processor(CONFIG, classifier=lambda volume: [0.0, np.log(3.0)], classes=["cat", "dog"])
    processor.push(at([5]))
    decision = processor.fire()
    assert (decision.label, decision.index, decision.complete) == ("dog", 1, False)
    assert decision.probabilities == pytest.approx([0.25, 0.75])
    assert decision.probability == pytest.approx(0.75)
    assert decision.logits.dtype == np.float32


def test_fire_before_the_first_event_is_an_empty_window():
    decision = Processor(CONFIG, classifier=total_and_size).fire()
    assert (decision.events, decision.trigger) == (0, "fire")
    assert Processor(CONFIG, classifier=total_and_size, start_us=70).fire().window_start_us == 70


def test_a_model_brings_its_network_and_classes():
    model = random_model(CONFIG, classes=3)
    processor = Processor(model)
    processor.push(random_events(100, duration_us=900))
    assert processor.fire().label in model.classes
    mine = Processor(model, classifier=lambda volume: [1.0, 0.0], classes=["a", "b"])
    assert mine.fire().label == "a"


def test_a_torch_module_may_be_the_classifier():
    import torch

    module = torch.nn.Sequential(torch.nn.Flatten(0), torch.nn.Linear(9 * 34 * 34, 4))
    processor = Processor(CONFIG, classifier=lambda volume: module(torch.tensor(volume)).detach())
    processor.push(at([5]))
    assert processor.fire().logits.shape == (4,)


@pytest.mark.parametrize("answer", [[float("nan"), 1.0], [1.0, float("inf")], None])
def test_logits_that_are_no_numbers_are_refused(answer):
    processor = Processor(CONFIG, classifier=lambda volume: answer)
    with pytest.raises(ValueError, match="`classifier` must return finite logits, got"):
        processor.fire()


@pytest.mark.parametrize("settings", [{}, {"hop_us": 300}, {"every_us": 100}, {"every_events": 7}])
def test_a_classifier_that_raises_once_costs_only_the_rest_of_its_packet(settings):
    events = random_events(300, seed=3, duration_us=4000)
    expected, _ = run(events, 1, **settings)
    troubles = iter([False, False, True])

    def troubled(volume):
        if next(troubles, False):
            raise RuntimeError("out of memory")
        return total_and_size(volume)

    processor = Processor(CONFIG, classifier=troubled, **settings)
    decisions = []
    for event in events:
        try:
            decisions += processor.push(np.array([event]))
        except RuntimeError:
            decisions += processor.push(np.array([event]))  # in packets of one nothing is lost
    decisions += processor.finish()
    if "every_events" not in settings:  # there the event is taken before its decision fails
        assert [key(d) for d in decisions] == [key(d) for d in expected]
    assert processor.counts.received >= 300 and decisions


def test_a_full_replay_buffer_warns_after_the_packet_is_done():
    """A warning may be an error, as in these tests: nothing may be half done then."""
    events = random_events(40, seed=5, duration_us=4000)
    processor = Processor(CONFIG.replace(landmark="window"), classifier=total_and_size, replay_events=2, hop_us=500)
    with pytest.raises(ReplayBufferFull):
        processor.push(events)
    counts = processor.counts
    assert counts.received == 40
    with pytest.warns(ReplayBufferFull):
        quiet = Processor(CONFIG.replace(landmark="window"), classifier=total_and_size, replay_events=2, hop_us=500)
        quiet.push(events)
    assert quiet.counts == counts


@pytest.mark.parametrize("kind", [np.uint16, np.int32, np.uint64])
def test_start_may_be_a_numpy_integer(kind):
    decisions, _ = run(events_of(*at([60_100, 70_000_000])), start_us=kind(60_000))
    assert [d.window_start_us for d in decisions] == [60_000, 70_000_000]


def test_wrong_number_of_logits():
    processor = Processor(CONFIG, classifier=lambda volume: [0.0], classes=["a", "b"])
    with pytest.raises(ValueError, match="`classifier` must return 2 logits, one for each class, got 1"):
        processor.fire()


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"hop_us": 1001}, "`hop_us` must be at most window_us = 1000, got 1001"),
        ({"hop_us": 0}, "`hop_us` must be at least 1, got 0"),
        ({"every_us": -5}, "`every_us` must be at least 1, got -5"),
        ({"every_events": 0}, "`every_events` must be at least 1, got 0"),
        ({"every_us": 0.5}, "`every_us` must be a whole number, got 0.5"),
        ({"start_us": -1}, r"`start_us` must be in \[0, 2\*\*62\), got -1"),
        ({"start_us": 1.5}, "`start_us` must be a whole number of microseconds, got 1.5"),
        ({"hop_us": 1}, r"`hop_us` must be at least window_us / 256 = 4, got 1: 1000 windows would be open"),
        ({"classes": "cat"}, "`classes` must be a sequence of names, got the single string 'cat'"),
        ({"late": "later"}, "`late` must be one of accept, drop, raise, got 'later'"),
        ({"classifier": 7}, "`classifier` must be callable, got int"),
        ({"classifier": None}, "`classifier` is missing: a TNTConfig alone cannot decide"),
    ],
)
def test_bad_settings(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Processor(CONFIG, **({"classifier": total_and_size} | settings))


def test_bad_model():
    with pytest.raises(TypeError, match="`model` must be a Model or a TNTConfig, got str; load_model"):
        Processor("digits")
