"""`every_events=1` and more: what Processor decides, on its compiled and its general path, against a plain loop."""

import numpy as np
import pytest
from deciding import key
from hypothesis import given, settings
from hypothesis import strategies as st
from incremental.cases import CASES, LARGE, WINDOW_US, Case, dense_of, model_of
from incremental.oracle import decisions_one_by_one, row
from made import nasty_streams, random_events

from async_tnt import CompiledClassifier, CompiledRegressor, Processor


class Another(CompiledClassifier):
    """A subclass may behave differently: Processor must call it like any callable."""

    def __call__(self, volume):
        return super().__call__(volume)[::-1].copy()


def decide(case: Case, events, size, **settings):
    """size : events in a packet; 0: all in one; None: one by one, by `push_one`."""
    processor = Processor(model_of(case), **settings)
    if size is None:
        decisions = [d for event in events.tolist() for d in processor.push_one(*event)]
    else:
        size = size or len(events) or 1
        decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
    return [row(d) for d in decisions + processor.finish()]


def plain(case: Case, events, every):
    return decisions_one_by_one(events, case.volume, dense_of(case), every)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_after_every_event(case):
    events = random_events(300, seed=1, duration_us=2 * WINDOW_US + 900, sensor=case.config.sensor)
    expected = plain(case, events, 1)
    assert len(expected) == 300 + 3  # two closed windows and the end
    for size in (None, 1, 2, 7, 100, 0):
        assert decide(case, events, size, every_events=1) == expected


def test_after_every_event_on_a_large_grid():
    events = random_events(16, seed=2, duration_us=WINDOW_US, sensor=LARGE.grid)
    assert decide(LARGE, events, 0, every_events=1) == plain(LARGE, events, 1)


@pytest.mark.parametrize("every", [2, 3, 50, 257, 10_000])
@pytest.mark.parametrize("case", [CASES[2], CASES[3], CASES[5], CASES[7]], ids=str)
def test_after_every_so_many_events(case, every):
    events = random_events(3000, seed=3, duration_us=2 * WINDOW_US + 900, sensor=case.config.sensor)
    expected = plain(case, events, every)
    for size in (1, 7, 100, 1300, 0):
        assert decide(case, events, size, every_events=every) == expected


def test_more_decisions_than_one_compiled_call_makes():
    """Rows for them are made 256 at a time: packets with that many decisions, one less and one more."""
    case = CASES[1]
    for n in (255, 256, 257, 511, 512, 513, 1300):
        events = random_events(n, seed=n, duration_us=WINDOW_US, sensor=case.config.sensor)
        for every in (1, 2):
            assert decide(case, events, 0, every_events=every) == plain(case, events, every)


@settings(max_examples=150, deadline=None)
@given(
    case=st.sampled_from(CASES),
    data=st.data(),
    every=st.sampled_from([1, 1, 2, 5]),
    size=st.sampled_from([None, 1, 2, 7, 0]),
)
def test_nasty_streams(case, data, every, size):
    """Ties, bursts, borders, times that run backwards, also into windows that are closed."""
    events = data.draw(nasty_streams(case.config.sensor, 3 * WINDOW_US, 77))
    assert decide(case, events, size, every_events=every) == plain(case, events, every)


@pytest.mark.parametrize("settings", [{"every_events": 1}, {"every_events": 3, "hop_us": 1300}, {"every_us": 50}])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_compiled_path_decides_as_the_general_one(case, settings):
    events = random_events(300, seed=4, duration_us=2 * WINDOW_US, sensor=case.config.sensor)
    dense = dense_of(case)
    regressor = CompiledRegressor(model_of(case)) if case.config.needs_regressor else None
    general = Processor(case.config, classifier=lambda volume: dense(volume), regressor=regressor, **settings)
    expected = [key(d) for d in general.push(events) + general.finish()]
    assert len(expected) > 50
    for size in (1, 7, 300):
        compiled = Processor(model_of(case), classes=[str(k) for k in range(case.classes)], **settings)
        decisions = [d for k in range(0, len(events), size) for d in compiled.push(events[k : k + size])]
        assert [key(d) for d in decisions + compiled.finish()] == expected


@settings(max_examples=80, deadline=None)
@given(
    case=st.sampled_from([CASES[1], CASES[2], CASES[3]]),
    data=st.data(),
    hop_us=st.sampled_from([4000, 1999, 700]),
    every=st.sampled_from([1, 2]),
    size=st.sampled_from([None, 1, 7, 0]),
)
def test_overlapping_windows_each_by_itself(case, data, hop_us, every, size):
    """Each window holds its own events; every so many of them, the oldest window decides."""
    events = data.draw(nasty_streams(case.config.sensor, 3 * WINDOW_US, 77))
    events = np.sort(events, order="t", kind="stable")
    expected = []
    if len(events):
        first_us, last_us = int(events["t"][0]), int(events["t"][-1])
        for start_us in range(first_us, last_us + 1, hop_us):
            inside = events[(events["t"] >= start_us) & (events["t"] < start_us + WINDOW_US)]
            since_us = start_us - hop_us + WINDOW_US  # the end of the window before: from then on the oldest

            def opened(start_us=start_us):
                volume = case.volume()
                volume.open(start_us)
                return volume

            closed = start_us + WINDOW_US <= last_us
            for trigger, *rest in decisions_one_by_one(inside, opened, dense_of(case), every):
                if trigger == "every_events" and rest[1] < since_us and start_us > first_us:
                    continue
                end = trigger == "end" and closed
                expected.append(("window", *rest[:3], True, *rest[4:]) if end else (trigger, *rest))
    assert decide(case, events, size, every_events=every, hop_us=hop_us) == expected


@pytest.mark.parametrize("size", [1, 7, 0])
def test_a_subclass_of_the_compiled_classifier_is_called_itself(size):
    case = CASES[7]
    events = random_events(60, seed=5, duration_us=WINDOW_US)
    processor = Processor(case.config, classifier=Another(model_of(case)), every_events=1)
    size = size or len(events)
    decisions = [d for k in range(0, len(events), size) for d in processor.push(events[k : k + size])]
    expected = [bytes_ for trigger, *_, bytes_, _ in plain(case, events, 1) if trigger == "every_events"]
    assert [d.logits[::-1].tobytes() for d in decisions] == expected


def test_arrays_of_a_decision_are_its_own():
    """Those of one packet share one piece of memory: none may reach into another."""
    decisions = Processor(model_of(CASES[7]), every_events=1).push(random_events(20, seed=6, duration_us=3000))
    before = [key(d) for d in decisions]
    decisions[4].logits[:] = 0
    decisions[4].probabilities[:] = 0
    assert [key(d) for d in decisions[:4] + decisions[5:]] == before[:4] + before[5:]
