"""Settings of triggers: which are refused, with which message, and that they may change while the stream runs."""

import copy
import math
import re
from fractions import Fraction

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size

from async_tnt import LeakyIntegrator, Processor

ACTIVITY = LeakyIntegrator(3.0, 500.0)
WHOLE = ((0, ValueError, "at least 1"), (1.0, TypeError, "a whole number"), (True, TypeError, "a whole number"))
NO_INTEGRATOR = "`activity` must be a LeakyIntegrator(threshold, leak_us), got "
BAD = [
    *[
        (name, value, error, f"`{name}` must be {rule}, got {value!r}")
        for name in ("every_us", "every_events")
        for value, error, rule in (*WHOLE, ("5", TypeError, "a whole number"), (np.True_, TypeError, "a whole number"))
    ],
    *[
        ("confidence", value, ValueError, f"`confidence` must be a probability in (0, 1], got {value}")
        for value in (0, -0.5, 1.01, math.nan, math.inf)
    ],
    ("confidence", "high", TypeError, "`confidence` must be a number, got 'high'"),
    ("confidence", True, TypeError, "`confidence` must be a number, got True"),
    ("activity", 5, TypeError, f"{NO_INTEGRATOR}5"),
    ("activity", LeakyIntegrator, TypeError, f"{NO_INTEGRATOR}<class 'async_tnt.triggers.LeakyIntegrator'>"),
]


@pytest.mark.parametrize("name, value, error, message", BAD)
def test_bad_settings_are_refused_and_change_nothing(name, value, error, message):
    exactly = f"^{re.escape(message)}$"
    with pytest.raises(error, match=exactly):
        Processor(CONFIG, classifier=total_and_size, **{name: value})
    good = {"every_us": 70, "every_events": 5, "confidence": 0.999, "activity": ACTIVITY}
    refusing, untouched = (Processor(CONFIG, classifier=total_and_size, **good) for _ in range(2))
    for processor in (refusing, untouched):
        processor.push(at([0, 1, 3]))
    with pytest.raises(error, match=exactly):
        setattr(refusing, name, value)
    assert {name: getattr(refusing, name) for name in good} == good
    rest = at(list(range(5, 1500, 13)))
    decisions = [key(d) for d in refusing.push(rest)]
    assert decisions == [key(d) for d in untouched.push(rest)] and len(decisions) > 10


@pytest.mark.parametrize("place, name", [(0, "threshold"), (1, "leak_us"), (2, "charge")])
def test_bad_integrators(place, name):
    for value in (0, -1.5, math.nan, -math.inf, *([] if name == "leak_us" else [math.inf])):
        with pytest.raises(ValueError, match=re.escape(f"`{name}` must be a positive number, got {value}")):
            LeakyIntegrator(*[value if k == place else 3.0 for k in range(3)])
    for value in ("3", True, None, [1]):
        with pytest.raises(TypeError, match=re.escape(f"`{name}` must be a number, got {value!r}")):
            LeakyIntegrator(*[value if k == place else 3.0 for k in range(3)])


def test_an_integrator_is_a_value():
    assert LeakyIntegrator(3, 5) == LeakyIntegrator(3.0, 5.0, 1.0) != LeakyIntegrator(3, 6)
    assert LeakyIntegrator(3, math.inf).leak_us == math.inf
    with pytest.raises(AttributeError):
        LeakyIntegrator(3, 5).threshold = 4


def test_numbers_of_any_type():
    """NumPy's, fractions: they are kept as Python's own."""
    fraction = LeakyIntegrator(Fraction(7, 2), np.float64(300), np.int8(1))
    given = {"every_us": np.uint16(70), "every_events": np.int64(3), "confidence": np.float32(0.75)}
    one = Processor(CONFIG, classifier=total_and_size, activity=fraction, **given)
    plain = {"every_us": 70, "every_events": 3, "confidence": 0.75}
    other = Processor(CONFIG, classifier=total_and_size, activity=LeakyIntegrator(3.5, 300.0, 1.0), **plain)
    assert {name: type(getattr(one, name)) for name in plain} == {name: type(plain[name]) for name in plain}
    events = at(list(range(0, 4000, 7)))
    decisions = [key(d) for d in one.push(events)]
    assert decisions == [key(d) for d in other.push(events)] and len(decisions) > 5


def test_settings_of_a_copy_are_its_own(make):
    """And they take effect when changed, also in compiled code, which has a copy of them."""
    original = make(every_events=3, activity=ACTIVITY)
    original.push(at([0, 1]))
    other = copy.deepcopy(original)
    other.every_events, other.activity = 2, None
    assert (original.every_events, original.activity) == (3, ACTIVITY)
    assert [(d.trigger, d.events) for d in other.push(at([2, 3, 4, 5]))] == [("every_events", 4), ("every_events", 6)]
    assert original.push(at([2, 3, 4, 5]))[0].events == 3
    other.every_events = None
    assert other.push(at([6, 7, 8, 9])) == []
    other.confidence = 1e-9  # checked at every event, as there is no other trigger
    assert [(d.trigger, d.events) for d in other.push(at([10, 11]))] == [("confidence", 11)]


def test_none_switches_each_off(make):
    settings = {"every_us": 70, "every_events": 2, "confidence": 0.999, "activity": ACTIVITY}
    processor = make(**settings)
    assert processor.push(at([0, 1, 2, 3, 80]))
    for name in settings:
        setattr(processor, name, None)
        assert getattr(processor, name) is None
    assert processor.push(at(list(range(80, 1000, 3)))) == []
    assert [d.trigger for d in processor.push(at([1000]))] == ["window"]
