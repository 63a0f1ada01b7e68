"""Processor.exchange: another model decides about the same open window from then on."""

from dataclasses import replace

import numpy as np
import pytest
from deciding import key
from made import random_events, random_model, random_regressor_model, raw_model

from async_tnt import CompiledClassifier, Processor, TNTConfig, load_model

CONFIG = TNTConfig(sensor=(20, 16), grid=(20, 16), bins=2, window_us=1000, transform="none")
FIRST = random_model(CONFIG, classes=3)
SECOND = random_model(CONFIG, classes=5, seed=1)


@pytest.mark.parametrize(
    "settings", [{}, {"every_events": 3}, {"every_us": 100}, {"confidence": 0.3}, {"hop_us": 400}]
)
def test_from_then_on_decisions_are_those_of_the_other_model(settings):
    events = random_events(400, sensor=(20, 16), duration_us=4000)
    for n in (0, 1, 57, 200, 400):
        processor = Processor(FIRST, start_us=0, **settings)
        before = processor.push(events[:n])
        processor.exchange(SECOND)
        after = processor.push(events[n:]) + processor.finish()
        assert processor.classes == SECOND.classes
        first = Processor(FIRST, start_us=0, **settings)
        assert list(map(key, before)) == list(map(key, first.push(events[:n])))
        if "confidence" in settings:  # what was decided before closes windows
            continue
        second = Processor(SECOND, start_us=0, **settings)
        second.push(events[:n])
        expected = second.push(events[n:]) + second.finish()
        assert list(map(key, after)) == list(map(key, expected))


def test_windows_that_slide_forget_which_class_was_sure():
    config = CONFIG.replace(representation="count", bins=None, last_events=50)
    first = random_model(config, classes=3)
    # the classes are always alike, so that the first one is decided for
    alike = {name: np.zeros_like(weight) for name, weight in first.weights.items()}
    first = replace(first, weights=alike)
    processor = Processor(first, confidence=0.01)
    assert len(processor.push(random_events(60, sensor=(20, 16)))) == 1
    processor.exchange(replace(first, classes=("x", "y", "z")))
    (decision,) = processor.push(random_events(60, seed=1, sensor=(20, 16), start_us=200_000))
    assert decision.label == "x"


@pytest.mark.parametrize("settings", [{}, {"every_events": 3}, {"every_us": 100}, {"hop_us": 400}])
def test_a_classifier_that_is_assigned_decides_from_then_on(settings):
    """A function after a compiled one, and the other way round."""
    events = random_events(400, sensor=(20, 16), duration_us=4000)
    compiled = CompiledClassifier(random_model(CONFIG, classes=3, seed=1))
    dense = CompiledClassifier(FIRST)
    for before, after in ((compiled, dense.__call__), (dense.__call__, compiled)):
        processor = Processor(CONFIG, classifier=before, start_us=0, **settings)
        processor.push(events[:150])
        processor.classifier = after
        found = processor.push(events[150:]) + processor.finish()
        expected = Processor(CONFIG, classifier=after, start_us=0, **settings)
        expected.push(events[:150])
        decisions = expected.push(events[150:]) + expected.finish()
        assert list(map(key, found)) == list(map(key, decisions)) != []


def test_models_that_cannot_take_its_place():
    processor = Processor(FIRST)
    events = random_events(100, sensor=(20, 16), duration_us=900)
    processor.push(events)
    for other in (raw_model(CONFIG), load_model("digits-everywhere")):
        with pytest.raises(ValueError, match="`model` must decide about windows, as this"):
            processor.exchange(other)
    with pytest.raises(ValueError, match="`model` must be of the configuration"):
        processor.exchange(random_model(CONFIG.replace(window_us=2000), classes=3))
    finder = load_model("digits-everywhere")
    with_landmark = random_regressor_model(CONFIG)
    for model, other in (
        (finder, finder),
        (finder, random_model(finder.config)),
        (with_landmark, with_landmark),
    ):
        with pytest.raises(ValueError, match="`model` must decide about windows"):
            Processor(model).exchange(other)
    # nothing has changed
    expected = Processor(FIRST)
    expected.push(events)
    np.testing.assert_array_equal(processor.fire().logits, expected.fire().logits)
    assert processor.classes == FIRST.classes
