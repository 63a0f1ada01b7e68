"""Early decisions: which one counts, when it fell, what it took; and the script that measures them."""

from __future__ import annotations

import numpy as np
import pytest

from async_tnt import CompiledClassifier, Decision, Processor, load_model
from async_tnt.sources.files.recording import open_recording, sample_recordings
from experiments import early

WINDOW_US = 105_000
DIGITS = load_model("digits")


def decision(time_us, trigger, index=3, events=10):
    one = np.zeros(10)
    one[index] = 1.0
    complete = trigger in ("window", "confidence")
    start_us = 210_000
    return Decision(str(index), index, one, one.astype("f4"), start_us, start_us + time_us, events, complete, trigger)


EVERY_20_MS, SURE, SURE_EVERY_MS = {"every_us": 20_000}, {"confidence": 0.9}, {"confidence": 0.9, "every_us": 1000}


@pytest.mark.parametrize(
    "settings, decisions, right, ms, by_trigger, evaluations",
    [
        # a fixed moment counts from itself and not from its newest event
        (EVERY_20_MS, [decision(19_000, "every_us", 5), decision(39_999, "every_us")], False, 20.0, True, 1),
        (EVERY_20_MS, [decision(40_000, "every_us"), decision(104_000, "window")], True, 60.0, True, 1),
        # confidence counts where it closed the window
        (SURE_EVERY_MS, [decision(900, "every_us", 1), decision(2700, "confidence")], True, 3.0, True, 2),
        (SURE_EVERY_MS, [decision(900, "every_us", 1), decision(104_000, "window")], True, 105.0, False, 2),
        # alone it asks at every event, and once more at the end
        (SURE, [decision(31_234, "confidence", events=245)], True, 31.234, True, 245),
        (SURE, [decision(104_000, "end", 7, events=1400)], False, 105.0, False, 1401),
    ],
)
def test_the_early_decision_by_hand(settings, decisions, right, ms, by_trigger, evaluations):
    found = early.early_decision(decisions, settings, WINDOW_US, truth=3)
    assert found == early.Early(right, ms, by_trigger, evaluations, len(decisions))


@pytest.mark.parametrize(
    "settings", [{"confidence": 0.5}, {"confidence": 0.95}, {"confidence": 0.9, "every_us": 3000}, {}], ids=str
)
def test_evaluations_are_those_that_a_counting_classifier_counts(settings):
    events = open_recording(sample_recordings()[3]).read()
    network, asked = CompiledClassifier(DIGITS), []
    processor = Processor(DIGITS, classifier=lambda v: asked.append(None) or network(v), start_us=0, **settings)
    processor.push(events)
    processor.finish()
    found = early.early_decisions(DIGITS, [(3, events)], settings)
    assert len(found) == 3 and sum(e.evaluations for e in found) == len(asked)
