"""Processors in the middle of windows: reads and `fire` in between, other models, resets, one classifier for two."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from incremental.cases import CASES, WINDOW_US, Case, dense_of, model_of
from incremental.oracle import decisions_one_by_one, row
from made import random_events

from async_tnt import CompiledClassifier, Processor

PARTS = [CASES[2], CASES[5], CASES[7]]


@settings(max_examples=100, deadline=None)
@given(
    case=st.sampled_from(PARTS),
    every=st.sampled_from([None, 1, 30]),
    seed=st.integers(0, 9),
    script=st.lists(
        st.one_of(st.integers(1, 90), st.sampled_from(["fire", "array", "landmark", "counts"])), min_size=2, max_size=25
    ),
)
def test_looking_in_between_packets_disturbs_nothing(case, every, seed, script):
    n = sum(step for step in script if isinstance(step, int))
    events = random_events(n, seed=seed, duration_us=2 * WINDOW_US, sensor=case.config.sensor)
    processor, twin, done = Processor(model_of(case), every_events=every), case.volume(), 0
    decisions = []
    for step in script:
        if isinstance(step, int):
            decisions += processor.push(events[done : done + step])
            twin.update(events[done : done + step])
            done += step
        elif step == "fire":
            decision = processor.fire()
            assert decision.logits.tobytes() == dense_of(case)(twin.array).tobytes()
            assert (decision.events, decision.window_start_us) == (twin.n_events, twin.start_us)
        elif step == "array":
            assert processor.volume().tobytes() == twin.array.tobytes()
        elif step == "landmark":
            assert processor.landmark == twin.landmark
        else:
            assert processor.counts == twin.counts
    expected = decisions_one_by_one(events, case.volume, dense_of(case), every or n + 1)
    assert [row(d) for d in decisions + processor.finish()] == expected


@pytest.mark.parametrize("size", [1, 13])
@pytest.mark.parametrize("case", PARTS, ids=str)
def test_another_model_in_the_middle_of_a_window(case, size):
    """Back and forth, to a network that has seen the window before, and one that has not."""
    first, second = case.classifier(0), case.classifier(1)
    events = random_events(260, seed=1, duration_us=2 * WINDOW_US, sensor=case.config.sensor)
    processor = Processor(case.config, classifier=first, every_events=1)
    decisions, used = [], []
    for k, first_event in enumerate(range(0, 260, size)):
        number = k // 3 % 2
        processor.classifier = (first, second)[number]
        new = processor.push(events[first_event : first_event + size])
        decisions += new
        used += [number] * len(new)
    both = [decisions_one_by_one(events, case.volume, dense_of(case, seed), 1)[:-1] for seed in (0, 1)]
    assert [row(d) for d in decisions] == [both[number][k] for k, number in enumerate(used)]
    assert {0, 1} == set(used)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_reset_in_the_middle_of_a_window(case):
    processor = Processor(model_of(case), every_events=1)
    for seed in range(3):
        events = random_events(120, seed=seed, duration_us=6000, sensor=case.config.sensor)
        expected = decisions_one_by_one(events, case.volume, dense_of(case), 1)[:-1]
        assert [row(d) for d in processor.push(events)] == expected
        processor.reset()
        empty = dense_of(case)(np.zeros(case.config.shape, np.float32))
        assert processor.fire().logits.tobytes() == empty.tobytes() and processor.fire().events == 0


def test_a_stream_that_goes_on_after_its_end():
    case = CASES[7]
    processor = Processor(model_of(case), every_events=1)
    events = random_events(100, seed=2, duration_us=WINDOW_US)
    later = random_events(100, seed=3, duration_us=WINDOW_US, start_us=10 * WINDOW_US + int(events["t"][0]))
    processor.push(events)
    processor.finish()
    assert not processor.volume().any()
    expected = decisions_one_by_one(
        later, lambda: opened(case, int(events["t"][0]) + 10 * WINDOW_US), dense_of(case), 1
    )
    assert [row(d) for d in processor.push(later)] == expected[:-1]


def opened(case: Case, start_us: int):
    volume = case.volume()
    volume.open(start_us)
    return volume


@pytest.mark.parametrize("sizes", [(1, 1), (7, 3), (100, 1)])
@pytest.mark.parametrize("hop_us", [None, 1500])
def test_one_classifier_for_two_processors(sizes, hop_us):
    """Two cameras, one network, alternating."""
    case = CASES[7]
    network = CompiledClassifier(model_of(case))
    streams = [random_events(300, seed=seed, duration_us=2 * WINDOW_US) for seed in (4, 5)]
    settings = {"every_events": 2, "hop_us": hop_us}
    both = [Processor(case.config, classifier=network, **settings) for _ in streams]
    decisions: list[list] = [[], []]
    at = [0, 0]
    while min(at) < 300:
        for k, size in enumerate(sizes):
            decisions[k] += both[k].push(streams[k][at[k] : at[k] + size])
            at[k] += size
            assert both[k].fire().logits.tobytes() == dense_of(case)(both[k].volume()).tobytes()
    for k, events in enumerate(streams):
        alone = Processor(model_of(case), **settings)
        expected = alone.push(events[: at[k]])
        assert [row(d) for d in decisions[k]] == [row(d) for d in expected] and len(expected) > 100


def test_many_processors_at_once():
    """Each with its own model, landmark and stream, an event each in turn."""
    processors = [Processor(model_of(case), every_events=1) for case in CASES]
    streams = [random_events(80, seed=k, duration_us=5000, sensor=c.config.sensor) for k, c in enumerate(CASES)]
    decisions: list[list] = [[] for _ in CASES]
    for k in range(80):
        for number, processor in enumerate(processors):
            decisions[number] += processor.push_one(*streams[number][k].tolist())
    for case, events, found in zip(CASES, streams, decisions, strict=True):
        expected = decisions_one_by_one(events, case.volume, dense_of(case), 1)[:-1]
        assert [row(d) for d in found] == expected
