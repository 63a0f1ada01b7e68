"""Processor: what a decision holds, and which settings, triggers and classifiers are refused."""

import copy
import math
import pickle
import re

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_model, random_regressor_model

from async_tnt import CompiledClassifier, Processor, TNTVolume, load_model, warmup
from async_tnt.sources import open_recording, sample_recordings
from async_tnt.streaming.decision import class_of_recording

BY_3 = CONFIG.replace(window_events=3)


def test_decision_carries_logits_probabilities_and_label():
    processor = Processor(
        CONFIG, classifier=lambda volume: [0.0, np.log(3.0)], classes=["cat", "dog"], start_us=70
    )
    empty = processor.fire()
    assert (empty.window_start_us, empty.time_us, empty.events) == (70, 70, 0)
    processor.push(at([75]))
    decision = processor.fire()
    assert (decision.label, decision.index, decision.complete) == ("dog", 1, False)
    assert decision.probabilities == pytest.approx([0.25, 0.75])
    assert decision.probability == pytest.approx(0.75)
    assert decision.logits.dtype == np.float32


def test_a_decision_as_plain_values_has_six_decimals():
    processor = Processor(
        CONFIG, classifier=lambda volume: [0.0, np.log(2.0)], classes=["cat", "dog"], start_us=2
    )
    processor.push(at([5, 9]))
    assert list(processor.fire().to_dict().items()) == [
        ("time_us", 9),
        ("window_start_us", 2),
        ("label", "dog"),
        ("probability", 0.666667),
        ("probabilities", [0.333333, 0.666667]),
        ("events", 2),
        ("complete", False),
        ("trigger", "fire"),
    ]


@pytest.mark.parametrize(
    ("answer", "classes", "message"),
    [
        ([float("nan"), 1.0], None, "finite logits, got"),
        (None, None, "finite logits, got"),
        ([], None, "logits, got none"),
        ([0.0], ["a", "b"], "2 logits, one for each class, got 1"),
        (np.zeros((2, 5)), None, r"logits \(1, n_classes\), or a map .*, got shape \(2, 5\)"),
    ],
)
def test_answers_that_are_refused(answer, classes, message):
    processor = Processor(CONFIG, classifier=lambda volume: answer, classes=classes)
    with pytest.raises(ValueError, match=f"`classifier` must return {message}"):
        processor.fire()
    processor.classifier = lambda volume: [0.0, 1.0]  # what was wrong says nothing of the classes
    assert len(processor.fire().probabilities) == 2


def test_a_decision_keeps_the_answer_of_a_classifier_that_writes_each_one_into_one_array():
    logits = np.zeros(2, np.float32)
    shown = np.zeros((2, 9, 9), np.float32)

    def classifier(volume):
        logits[0] += 1
        return logits

    def finds(volume):
        shown[0, 4, 4] += 1
        return shown

    processor = Processor(CONFIG, classifier=classifier)
    decisions = [processor.fire(), processor.fire()]
    assert [decision.logits.tolist() for decision in decisions] == [[1, 0], [2, 0]]
    processor = Processor(CONFIG, classifier=finds, classes=["a"])
    decisions = [processor.fire(), processor.fire()]
    for n, decision in enumerate(decisions, 1):
        probability = 1 / (1 + np.exp(-n))
        assert decision.probabilities[0] == pytest.approx([probability, 1 - probability])


def test_a_time_that_is_impossible_changes_nothing():
    processor = Processor(CONFIG, classifier=total_and_size)
    for wrong in ((True, 3, 3, 1), (5, True, 3, 1), (5, 3, 3.0, 1)):
        with pytest.raises(TypeError, match=r"^`[txy]` must be whole numbers, got"):
            processor.push_one(*wrong)
    assert processor.push_one(2**62 - 1, 3, 3, 1) == [] and len(processor.finish()) == 1
    for _ in range(2):
        with pytest.raises(ValueError, match=r"^`start_us` must be in \[0, 2\*\*62\)"):
            processor.push_one(2**62 - 1, 3, 3, 1)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"hop_us": 1001}, "`hop_us` must be at most window_us = 1000, got 1001"),
        (
            {"hop_us": 1},
            r"`hop_us` must be at least window_us / 256 = 4, got 1: 1000 windows would be open",
        ),
        ({"start_us": -1}, r"`start_us` must be in \[0, 2\*\*62\), got -1"),
        ({"classes": "cat"}, "`classes` must be a sequence of names, got the single string 'cat'"),
        ({"late": "later"}, "`late` must be one of accept, drop, raise, got 'later'"),
        ({"hop_us": 5, "model": BY_3}, "`hop_us` must not be given with window_events=3, got 5"),
        ({"start_us": 5, "model": BY_3}, "`start_us` must not be given with window_events=3"),
        (
            {"classifier": CompiledClassifier(random_model(CONFIG)), "classes": ["a", "b"]},
            "`classifier` must return 2 logits, one for each class, got 10",
        ),
        ({"classifier": None}, "`classifier` is missing: a TNTConfig alone cannot decide"),
        ({"model": 3}, "`model` must be a Model, the name or path of one, or a TNTConfig, got int"),
    ],
)
def test_bad_settings(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Processor(**({"model": CONFIG, "classifier": total_and_size} | settings))


def test_as_many_windows_may_be_open_as_the_message_says():
    small = CONFIG.replace(sensor=(2, 2), grid=(2, 2), bins=1, window_us=1024)
    processor = Processor(small, classifier=total_and_size, hop_us=4)
    assert processor.push(([0, 1023], [1, 1], [1, 1], [1, 1])) == []
    assert len(processor.finish()) == 256
    with pytest.raises(ValueError, match=r"at least window_us / 256 = 4, got 3: 342 windows"):
        Processor(small, classifier=total_and_size, hop_us=3)


def test_the_repr_of_a_stream_counts_its_open_windows_and_events():
    processor = Processor(CONFIG, classifier=total_and_size, hop_us=250)
    assert repr(processor) == f"Processor({CONFIG}, 0 open windows, 0 events received)"
    processor.push(at([0, 10, 600]))
    assert repr(processor) == f"Processor({CONFIG}, 3 open windows, 3 events received)"
    volume = TNTVolume(CONFIG)
    volume.update(at([70, 80]))
    assert repr(volume) == f"TNTVolume({CONFIG}, 2 events from 70 us on)"


OTHER_SHAPE = CompiledClassifier(random_model(CONFIG.replace(bins=3)))
CHANGEABLE = [
    ("every_us", 0, ValueError, "`every_us` must be at least 1, got 0"),
    ("every_us", 2**62, ValueError, f"`every_us` must be below 2**62, got {2**62}"),
    ("every_events", 2**62, ValueError, f"`every_events` must be below 2**62, got {2**62}"),
    ("confidence", 0, ValueError, "`confidence` must be a probability in (0, 1], got 0"),
    ("every_us", True, TypeError, "`every_us` must be a whole number, got True"),
    ("every_events", 1.0, TypeError, "`every_events` must be a whole number, got 1.0"),
    ("confidence", 1.01, ValueError, "`confidence` must be a probability in (0, 1], got 1.01"),
    ("confidence", math.nan, ValueError, "`confidence` must be a probability in (0, 1], got nan"),
    ("confidence", "high", TypeError, "`confidence` must be a number, got 'high'"),
    ("classifier", 7, TypeError, "`classifier` must be callable, got int"),
    (
        "classifier",
        OTHER_SHAPE,
        ValueError,
        "`classifier` must take volumes of shape (9, 34, 34), got one for (3, 34, 34)",
    ),
]


@pytest.mark.parametrize("name, value, error, message", CHANGEABLE)
def test_bad_changes_are_refused_and_change_nothing(name, value, error, message):
    good = {"every_us": 70, "every_events": 5, "confidence": 0.999}
    good["classifier"] = total_and_size
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        Processor(CONFIG, **good | {name: value})
    processor = Processor(CONFIG, **good)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        setattr(processor, name, value)
    assert {name: getattr(processor, name) for name in good} == good
    with pytest.raises(AttributeError, match="every_ms"):
        processor.every_ms = 5


def test_a_model_may_be_given_by_its_name_or_path(tmp_path):
    """Its decisions are those of the model that `load_model` returns."""
    model = load_model("digits")
    path = model.save(tmp_path / "m.safetensors")
    events = open_recording(sample_recordings()[3]).read()
    expected = [key(decision) for decision in Processor(model).push(events)]
    for given in ("digits", str(path), path):
        assert [key(decision) for decision in Processor(given).push(events)] == expected and len(
            expected
        ) == 2
        assert warmup(given) >= 0
    for use in (Processor, warmup):
        with pytest.raises(
            FileNotFoundError, match="no model file nothing, and no bundled model of that name"
        ):
            use("nothing")
        with pytest.raises(
            TypeError, match="`model` must be a Model, the name or path of one, or a TNTConfig, got"
        ):
            use(3)
    with pytest.raises(
        TypeError,
        match=r"`config` must be a TNTConfig, got 'digits'; load_model\(name\).config is that",
    ):
        TNTVolume("digits")
    with pytest.raises(
        TypeError, match=r"`config` must be a TNTConfig, got Model.*; pass its `config`$"
    ):
        TNTVolume(model)


class Doubtful(CompiledClassifier):
    """A compiled classifier that changes its answers."""

    def __call__(self, volume):
        return 0 * super().__call__(volume)


def test_a_subclass_of_the_compiled_classifier_is_called_for_its_answers():
    processor = Processor(CONFIG, classifier=Doubtful(random_model(CONFIG)), every_events=2)
    (decision,) = processor.push(at([5, 9]))
    assert not decision.logits.any() and not processor.fire().logits.any()


def test_what_is_passed_beside_a_model_takes_the_place_of_its_own():
    model = random_regressor_model(CONFIG, classes=2)
    processor = Processor(model, classes=["cat", "dog"], regressor=lambda raw: (3.0, 4.0))
    processor.push(at([5, 9]))
    assert processor.landmark == (3.0, 4.0) and processor.classes == ("cat", "dog")
    assert processor.fire().label in ("cat", "dog")
    # an answer about the window does not depend on the sensor's size
    larger = CONFIG.replace(sensor=(68, 68))
    Processor(larger, classifier=CompiledClassifier(random_model(CONFIG))).push(at([5]))


@pytest.mark.parametrize(
    ("probabilities", "expected"),
    [
        ([[0.1, 0.9], [0.8, 0.2], [0.75, 0.25]], ("cat", "mean probability 0.550 of 3 windows")),
        ([[0.1, 0.9], [0.6, 0.4]], ("dog", "mean probability 0.650 of 2 windows")),
        ([[0.25, 0.75]], ("dog", "mean probability 0.750 of 1 window")),
    ],
)
def test_the_class_of_a_recording_is_the_likeliest_on_average(probabilities, expected):
    assert class_of_recording(["cat", "dog"], np.array(probabilities)) == expected


@pytest.mark.parametrize(
    ("config", "name", "longest"),
    [
        (CONFIG, "every_us", CONFIG.window_us),
        (BY_3, "every_events", 3),
        (BY_3.replace(window_us=500), "every_us", 500),  # the longest duration of its windows
    ],
)
def test_a_trigger_that_no_window_is_long_enough_for_is_told_once(config, name, longest):
    """A trigger that is never due is warned of when it is made or set.

    There is no warning if it is due as often as windows end, nor if the same value is set
    again.
    """
    message = (
        f"`{name}` = {longest + 1} is .* a window.*, {longest}.*: it never makes a decision due"
    )
    with pytest.warns(UserWarning, match=message) as caught:
        processor = Processor(config, classifier=total_and_size, **{name: longest + 1})
    assert len(caught) == 1 and caught[0].filename == __file__
    setattr(processor, name, longest + 1)
    setattr(processor, name, longest)
    pickle.loads(pickle.dumps(Processor(config, classifier=total_and_size, **{name: longest})))
    with pytest.warns(UserWarning, match=message) as caught:
        setattr(processor, name, longest + 1)
    assert len(caught) == 1 and caught[0].filename == __file__
    copy.copy(processor).push(at([5]))


def test_a_window_without_a_limit_is_long_enough_for_any_trigger():
    """One by time has any number of events, and one by number takes up to an hour."""
    Processor(CONFIG, classifier=total_and_size, every_events=10**9)
    Processor(BY_3, classifier=total_and_size, every_us=10**9)


def test_the_repr_of_a_decision_is_short():
    """Whatever its arrays hold."""
    logits = np.zeros(5000, np.float32)
    logits[[7, 4000, 2]] = np.log([4000.0, 3000.0, 2000.0])
    processor = Processor(CONFIG, classifier=lambda volume: logits)
    processor.push(at([5, 9]))
    assert repr(processor.fire()) == (
        "Decision(label='7', probability=0.286, trigger='fire', time_us=9, events=2, "
        "likeliest={7: 0.286, 4000: 0.214, 2: 0.143})"
    )
    two = Processor(CONFIG, classifier=lambda volume: [0.0, 0.0], classes=["a", "b"]).fire()
    assert repr(two).endswith("likeliest={0: 0.500, 1: 0.500})")
    # of classes that are as likely as each other, the first
    alike = Processor(CONFIG, classifier=lambda volume: np.arange(1000) % 2 * 50.0).fire()
    assert repr(alike).endswith("likeliest={1: 0.002, 3: 0.002, 5: 0.002})")
    for n, shown in (
        (0, "[]"),
        (1, "['a' at (15.0, 15.0)]"),
        (4, ", 1 more]"),
        (5, ", 2 more]"),
    ):
        found = np.zeros((2, 34, 34), np.float32)
        found[1] = 1
        found[0, 15 : 15 + 3 * n : 3, 15] = 2
        decision = Processor(
            CONFIG, classifier=lambda volume, found=found: found, classes=["a"]
        ).fire()
        assert len(decision.objects) == n and f"{shown})" in repr(decision)
        assert len(repr(decision)) < 250
