"""Where nothing happens nothing is said, and time passes with events only."""

import pytest
from deciding import CONFIG, at, summary, total_and_size
from made import random_model

from async_tnt import LeakyIntegrator, Processor

ALL = [
    {"every_us": 1},
    {"every_events": 1},
    {"confidence": 0.01},
    {"activity": LeakyIntegrator(0.1, 1.0)},
    {"every_us": 1, "every_events": 1, "confidence": 0.01, "activity": LeakyIntegrator(0.1, 1.0), "start_us": 0},
    {"every_us": 1, "hop_us": 100},
]


@pytest.mark.parametrize("settings", ALL, ids=str)
@pytest.mark.parametrize("way", ["callable", "compiled"])
def test_no_events_no_decisions(settings, way):
    asked = []

    def classifier(volume):
        asked.append(1)
        return total_and_size(volume)

    general = Processor(CONFIG, classifier=classifier, **settings)
    processor = general if way == "callable" else Processor(random_model(CONFIG), **settings)
    for empty in (None, [], at([])):
        assert processor.push(empty) == []
    assert processor.finish() == [] and processor.counts.received == 0 and not asked


@pytest.mark.parametrize("way", ["callable", "compiled"])
def test_in_a_pause_nothing_is_said_twice(way):
    """Of a hundred moments that pass without an event, the first says what is new; the others are silent."""
    model = {"classifier": total_and_size} if way == "callable" else {}
    processor = Processor(CONFIG if model else random_model(CONFIG), every_us=5, **model)
    assert summary(processor.push(at([0, 1, 900]))) == [("every_us", 0, 1, 2)]
    assert summary(processor.push(at([901, 905]))) == [("every_us", 0, 901, 4)]
    assert summary(processor.push(at([10_000]))) == [("every_us", 0, 905, 5), ("window", 0, 905, 5)]


@pytest.mark.parametrize("way", ["callable", "compiled"])
def test_a_slow_scene_never_reaches_the_threshold(way):
    """An event each window, years long: only their windows are said."""
    model = {"classifier": total_and_size} if way == "callable" else {}
    processor = Processor(
        CONFIG if model else random_model(CONFIG), activity=LeakyIntegrator(1.01, 100.0), every_events=2, **model
    )
    times = [10**12 * k for k in range(50)]
    decisions = processor.push(at(times))
    assert summary(decisions) == [("window", t, t, 1) for t in times[:-1]]


@pytest.mark.parametrize("way", ["callable", "compiled"])
def test_dropped_events_make_nothing_due(way):
    """Late ones are not of the window: `every_events` does not count them, `every_us` finds nothing new."""
    model = {"classifier": total_and_size} if way == "callable" else {}
    processor = Processor(
        CONFIG if model else random_model(CONFIG), every_events=2, every_us=300, start_us=1000, **model
    )
    assert summary(processor.push(at([1000, 5, 6, 7]))) == []
    assert summary(processor.push(at([1001]))) == [("every_events", 1000, 1001, 2)]
    assert summary(processor.push(at([5, 6, 7, 8, 1500]))) == []
    assert summary(processor.push(at([1700]))) == [("every_us", 1000, 1500, 3), ("every_events", 1000, 1700, 4)]
    assert processor.counts.dropped_late == 7
