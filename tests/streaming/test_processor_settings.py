"""Processor: what a decision holds, and which settings and classifiers are refused."""

import numpy as np
import pytest
from deciding import CONFIG, at, run, total_and_size
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


@pytest.mark.parametrize("logits", [[1000.0, 1000.0], [-1000.0, -1000.0], [3e38, 3e38]], ids=str)
def test_large_logits_have_probabilities(logits):
    assert Processor(CONFIG, classifier=lambda volume: logits).fire().probabilities.tolist() == [0.5, 0.5]


def test_fire_before_the_first_event_is_an_empty_window():
    decision = Processor(CONFIG, classifier=total_and_size).fire()
    assert (decision.events, decision.trigger) == (0, "fire")
    assert Processor(CONFIG, classifier=total_and_size, start_us=70).fire().window_start_us == 70


def test_a_model_brings_its_network_and_classes():
    model = random_model(CONFIG, classes=3)
    processor = Processor(model)
    processor.push(random_events(100, duration_us=900))
    assert processor.fire().label in model.classes
    assert Processor(model, classifier=lambda volume: [1.0, 0.0], classes=["a", "b"]).fire().label == "a"


def test_a_torch_module_may_be_the_classifier():
    import torch

    module = torch.nn.Sequential(torch.nn.Flatten(0), torch.nn.Linear(9 * 34 * 34, 4))
    processor = Processor(CONFIG, classifier=lambda volume: module(torch.tensor(volume)).detach())
    assert processor.fire().logits.shape == (4,)


@pytest.mark.parametrize(
    ("answer", "classes", "message"),
    [
        ([float("nan"), 1.0], None, "finite logits, got"),
        ([1.0, float("inf")], None, "finite logits, got"),
        (None, None, "finite logits, got"),
        ([0.0], ["a", "b"], "2 logits, one for each class, got 1"),
    ],
)
def test_answers_that_are_refused(answer, classes, message):
    processor = Processor(CONFIG, classifier=lambda volume: answer, classes=classes)
    with pytest.raises(ValueError, match=f"`classifier` must return {message}"):
        processor.fire()


@pytest.mark.filterwarnings("error")
def test_a_full_replay_buffer_warns_after_the_packet_is_processed():
    """A warning may be an error: nothing may be half done then."""
    events = random_events(40, seed=5, duration_us=4000)
    strict, quiet = (
        Processor(CONFIG.replace(landmark="window"), classifier=total_and_size, replay_events=2, hop_us=500)
        for _ in range(2)
    )
    with pytest.raises(ReplayBufferFull):
        strict.push(events)
    with pytest.warns(ReplayBufferFull):
        quiet.push(events)
    assert quiet.counts == strict.counts and quiet.counts.received == 40


def test_start_may_be_a_numpy_integer():
    decisions, _ = run(events_of(*at([60_100, 70_000_000])), start_us=np.uint64(60_000))
    assert [d.window_start_us for d in decisions] == [60_000, 70_000_000]


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"hop_us": 1001}, "`hop_us` must be at most window_us = 1000, got 1001"),
        ({"hop_us": 0}, "`hop_us` must be at least 1, got 0"),
        ({"hop_us": np.True_}, "`hop_us` must be a whole number"),  # with NumPy 1 it is one for operator.index
        ({"hop_us": 1}, r"`hop_us` must be at least window_us / 256 = 4, got 1: 1000 windows would be open"),
        ({"start_us": -1}, r"`start_us` must be in \[0, 2\*\*62\), got -1"),
        ({"start_us": 1.5}, "`start_us` must be a whole number of microseconds, got 1.5"),
        ({"classes": "cat"}, "`classes` must be a sequence of names, got the single string 'cat'"),
        ({"late": "later"}, "`late` must be one of accept, drop, raise, got 'later'"),
        ({"classifier": 7}, "`classifier` must be callable, got int"),
        ({"classifier": None}, "`classifier` is missing: a TNTConfig alone cannot decide"),
        ({"model": "digits"}, "`model` must be a Model or a TNTConfig, got str; load_model"),
    ],
)
def test_bad_settings(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Processor(**({"model": CONFIG, "classifier": total_and_size} | settings))
