"""Settings of triggers: what is refused, with which words, and that nothing changes then."""

import copy
import math
import pickle
import re
from fractions import Fraction

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_model

from async_tnt import LeakyIntegrator, Processor

ACTIVITY = LeakyIntegrator(3.0, 500.0)
BAD = [
    ("every_us", 0, ValueError, "`every_us` must be at least 1, got 0"),
    ("every_us", -7, ValueError, "`every_us` must be at least 1, got -7"),
    ("every_us", 1.0, TypeError, "`every_us` must be a whole number, got 1.0"),
    ("every_us", True, TypeError, "`every_us` must be a whole number, got True"),
    ("every_us", "5", TypeError, "`every_us` must be a whole number, got '5'"),
    ("every_events", 0, ValueError, "`every_events` must be at least 1, got 0"),
    ("every_events", 2.5, TypeError, "`every_events` must be a whole number, got 2.5"),
    ("every_events", False, TypeError, "`every_events` must be a whole number, got False"),
    ("confidence", 0, ValueError, "`confidence` must be a probability in (0, 1], got 0"),
    ("confidence", -0.5, ValueError, "`confidence` must be a probability in (0, 1], got -0.5"),
    ("confidence", 1.01, ValueError, "`confidence` must be a probability in (0, 1], got 1.01"),
    ("confidence", 90, ValueError, "`confidence` must be a probability in (0, 1], got 90"),
    ("confidence", math.nan, ValueError, "`confidence` must be a probability in (0, 1], got nan"),
    ("confidence", math.inf, ValueError, "`confidence` must be a probability in (0, 1], got inf"),
    ("confidence", "high", TypeError, "`confidence` must be a number, got 'high'"),
    ("confidence", True, TypeError, "`confidence` must be a number, got True"),
    ("activity", 5, TypeError, "`activity` must be a LeakyIntegrator(threshold, leak_us), got 5"),
    ("activity", (5, 9), TypeError, "`activity` must be a LeakyIntegrator(threshold, leak_us), got (5, 9)"),
    (
        "activity",
        LeakyIntegrator,
        TypeError,
        "`activity` must be a LeakyIntegrator(threshold, leak_us), got <class 'async_tnt.triggers.LeakyIntegrator'>",
    ),
]


def exactly(message: str) -> str:
    return f"^{re.escape(message)}$"


@pytest.mark.parametrize("name, value, error, message", BAD)
def test_bad_settings_of_a_new_processor(name, value, error, message):
    with pytest.raises(error, match=exactly(message)):
        Processor(CONFIG, classifier=total_and_size, **{name: value})


@pytest.mark.parametrize("name, value, error, message", BAD)
def test_bad_settings_in_midstream_change_nothing(name, value, error, message):
    good = {"every_us": 70, "every_events": 5, "confidence": 0.999, "activity": ACTIVITY}
    troubled, untouched = (Processor(CONFIG, classifier=total_and_size, **good) for _ in range(2))
    for processor in (troubled, untouched):
        processor.push(at([0, 1, 3]))
    with pytest.raises(error, match=exactly(message)):
        setattr(troubled, name, value)
    assert {name: getattr(troubled, name) for name in good} == good
    rest = at(list(range(5, 2500, 13)))
    decisions = [key(d) for d in troubled.push(rest)]
    assert decisions == [key(d) for d in untouched.push(rest)] and len(decisions) > 10


@pytest.mark.parametrize(
    "arguments, error, message",
    [
        ((0, 5), ValueError, "`threshold` must be a positive number, got 0"),
        ((-1.5, 5), ValueError, "`threshold` must be a positive number, got -1.5"),
        ((math.inf, 5), ValueError, "`threshold` must be a positive number, got inf"),
        ((math.nan, 5), ValueError, "`threshold` must be a positive number, got nan"),
        (("3", 5), TypeError, "`threshold` must be a number, got '3'"),
        ((True, 5), TypeError, "`threshold` must be a number, got True"),
        ((3, 0), ValueError, "`leak_us` must be a positive number, got 0"),
        ((3, -math.inf), ValueError, "`leak_us` must be a positive number, got -inf"),
        ((3, math.nan), ValueError, "`leak_us` must be a positive number, got nan"),
        ((3, None), TypeError, "`leak_us` must be a number, got None"),
        ((3, 5, 0.0), ValueError, "`charge` must be a positive number, got 0.0"),
        ((3, 5, -1), ValueError, "`charge` must be a positive number, got -1"),
        ((3, 5, math.inf), ValueError, "`charge` must be a positive number, got inf"),
        ((3, 5, [1]), TypeError, "`charge` must be a number, got [1]"),
    ],
)
def test_bad_integrators(arguments, error, message):
    with pytest.raises(error, match=exactly(message)):
        LeakyIntegrator(*arguments)


def test_an_integrator_is_a_value():
    assert LeakyIntegrator(3, 5) == LeakyIntegrator(3.0, 5.0, 1.0) != LeakyIntegrator(3, 6)
    assert LeakyIntegrator(3, math.inf).leak_us == math.inf
    with pytest.raises(AttributeError):
        LeakyIntegrator(3, 5).threshold = 4


def test_numbers_of_any_kind():
    """NumPy's, fractions: what is kept are Python's own."""
    processor = Processor(
        CONFIG,
        classifier=total_and_size,
        every_us=np.uint16(70),
        every_events=np.int64(3),
        confidence=np.float32(0.75),
        activity=LeakyIntegrator(Fraction(7, 2), np.float64(300), np.int8(1)),
    )
    plain = Processor(
        CONFIG,
        classifier=total_and_size,
        every_us=70,
        every_events=3,
        confidence=0.75,
        activity=LeakyIntegrator(3.5, 300.0, 1.0),
    )
    assert [type(value) for value in (processor.every_us, processor.every_events, processor.confidence)] == [
        int,
        int,
        float,
    ]
    events = at(list(range(0, 4000, 7)))
    decisions = [key(d) for d in processor.push(events)]
    assert decisions == [key(d) for d in plain.push(events)] and len(decisions) > 5


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
@pytest.mark.parametrize("way", ["callable", "compiled"])
def test_settings_of_a_copy_are_its_own(way, duplicate):
    """And changed they come into force, also in what compiled code reads of them."""
    given = {"classifier": total_and_size} if way == "callable" else {}
    original = Processor(CONFIG if given else random_model(CONFIG), every_events=3, activity=ACTIVITY, **given)
    original.push(at([0, 1]))
    other = duplicate(original)
    other.every_events, other.activity = 2, None
    assert (original.every_events, original.activity) == (3, ACTIVITY)
    assert [(d.trigger, d.events) for d in other.push(at([2, 3, 4, 5]))] == [("every_events", 4), ("every_events", 6)]
    assert original.push(at([2, 3, 4, 5]))[0].events == 3
    other.every_events = None
    assert other.push(at([6, 7, 8, 9])) == []
    other.confidence = 1e-9  # looked for at every event, as nothing else is left
    assert [(d.trigger, d.events) for d in other.push(at([10, 11]))] == [("confidence", 11)]


def test_none_switches_each_off():
    processor = Processor(
        CONFIG, classifier=total_and_size, every_us=70, every_events=2, confidence=0.999, activity=ACTIVITY
    )
    assert processor.push(at([0, 1, 2, 3, 80]))
    for name in ("every_us", "every_events", "confidence", "activity"):
        setattr(processor, name, None)
        assert getattr(processor, name) is None
    assert processor.push(at(list(range(80, 1000, 3)))) == []
    assert [d.trigger for d in processor.push(at([1000]))] == ["window"]


@pytest.mark.parametrize("name", ["every_us", "every_events", "hop_us", "start_us"])
def test_a_numpy_bool_is_no_whole_number(name):  # with NumPy 1 it is one for operator.index
    with pytest.raises(TypeError, match=f"`{name}` must be a whole number"):
        Processor(random_model(CONFIG), **{name: np.True_})
