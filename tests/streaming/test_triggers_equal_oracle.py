"""Which decisions fall when: Processor against a plain oracle, for any cut of any stream."""

import copy
import itertools
from dataclasses import fields, replace
from functools import cache
from unittest import mock

import numpy as np
import pytest
from deciding import uneven
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events, random_model
from oracles import Oracle, as_values

from async_tnt import CompiledClassifier, Processor, TNTConfig
from async_tnt.streaming.triggers import TriggerSettings

pytestmark = pytest.mark.filterwarnings(
    "ignore:.* it never makes a decision due", "ignore:times went back"
)
CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=2, window_us=1000, t_max=2.0, transform="none")
TNT = CONFIG.replace(transform="tnt")
REPLAYED = CONFIG.replace(transform="tnt", landmark="window")
BY_EVENTS = [
    TNT.replace(window_events=4),
    TNT.replace(window_events=30, landmark="line", window_us=3_600_000_000),
    CONFIG.replace(window_events=1, window_us=300),
]


@cache
def compiled(config: TNTConfig) -> CompiledClassifier:
    """A network with large logits, so that confidence rises and falls."""
    model = random_model(config, classes=3, widths=(3, 5, 7), seed=4)
    loud = {
        name: w * 12
        for name, w in model.weights.items()
        if name.startswith("fc2") or name == "fc1.weight"
    }
    return CompiledClassifier(replace(model, weights=model.weights | loud))


TRIGGERS = {
    "every_us": st.sampled_from([None, None, 1, 77, 500, 1000, 3000]),
    "every_events": st.sampled_from([None, None, 1, 2, 3, 30]),
    "confidence": st.sampled_from([None, None, 0.4, 0.7, 0.95, 1.0]),
}
triggers = st.fixed_dictionaries(TRIGGERS)
change = st.one_of(*(st.tuples(st.just(name), values) for name, values in TRIGGERS.items()))
windows = st.fixed_dictionaries(
    {
        "hop_us": st.sampled_from([None, None, None, 1000, 999, 500, 250, 130]),
        "start_us": st.sampled_from([None, None, 0, 60, 300]),
        "late": st.sampled_from(["accept", "accept", "drop"]),
    }
)
nasty = nasty_streams((8, 8), 3500, 50, max_events=70)
long = st.builds(  # hundreds of events in a window, more decisions than one compiled call makes
    random_events,
    st.just(1300),
    seed=st.integers(0, 99),
    duration_us=st.just(5200),
    sensor=st.just((8, 8)),
)
ways = st.sampled_from(
    [
        (CONFIG, "callable"),
        *((config, "compiled") for config in (CONFIG, TNT, REPLAYED)),
        (BY_EVENTS[0], "callable"),
    ]
    + [(config, "compiled") for config in BY_EVENTS]
)


def pair(config: TNTConfig, way: str, **settings) -> tuple[Oracle, Processor]:
    if config.window_events:
        settings |= {"hop_us": None, "start_us": None}
    if way == "callable":
        return Oracle(config, uneven, **settings), Processor(config, classifier=uneven, **settings)
    dense = compiled(config)  # called with arrays only: the whole network each time
    incremental = copy.deepcopy(dense)
    return Oracle(config, dense, **settings), Processor(config, classifier=incremental, **settings)


def assert_equal(oracle: Oracle, processor: Processor, decisions: list, expected: list) -> None:
    """Check that processor and oracle agree at the end of the stream.

    Decisions that depend on the last bit of exp are left out.
    """
    expected += oracle.finish()
    if oracle.close_calls:
        reject()
    assert [as_values(d) for d in decisions + processor.finish()] == expected
    assert processor.counts == oracle.counts


@settings(max_examples=2 * settings.default.max_examples)
@given(
    events=st.one_of(nasty, nasty, nasty, long),
    way=ways,
    windows=windows,
    triggers=triggers,
    steps=st.lists(st.tuples(st.integers(0, 30), st.none() | change), max_size=8),
    large=st.sampled_from([3, 500]),
)
def test_any_triggers_any_windows_any_packets_any_changes(
    events, way, windows, triggers, steps, large
):
    """steps : size of a packet, 0: one event by `push_one`; a trigger that is changed after it, if
        any.
    large : events of a packet that is decided in one compiled call."""
    with mock.patch("async_tnt.streaming.processor.STRETCH", large):
        check(events, way, windows, triggers, steps)


def check(events, way, windows, triggers, steps) -> None:
    oracle, processor = pair(*way, **windows, **triggers)
    expected = []
    decisions = []
    first = 0
    for size, changed in [*steps, (len(events), None)]:
        packet = events[first : first + max(size, 1)]
        first += len(packet)
        expected += oracle.push_all(packet)
        if size:
            decisions += processor.push(packet)
        else:
            decisions += [
                decision for event in packet.tolist() for decision in processor.push_one(*event)
            ]
        if changed:
            name, value = changed
            oracle.change(**{name: value})
            setattr(processor, name, value)
            assert getattr(processor, name) == value
    assert_equal(oracle, processor, decisions, expected)


def test_every_trigger_is_drawn_and_combined():
    names = {field.name for field in fields(TriggerSettings)}
    assert TRIGGERS.keys() == COMBINED.keys() == names


def with_stragglers(seed: int, n: int = 700) -> np.ndarray:
    """A dense stream with events of earlier windows, also from before pauses of windows."""
    rng = np.random.default_rng(seed)
    steps = rng.integers(0, 12, n)
    pauses = rng.random(n) < 0.006
    times = 3000 + np.cumsum(steps + pauses * rng.integers(1000, 4000, n))
    back = rng.random(n) < 0.12
    times[back] = np.maximum(0, times[back] - rng.integers(1, 3500, back.sum()))
    return events_of(times, rng.integers(0, 8, n), rng.integers(0, 8, n), rng.integers(0, 2, n))


HOPS = None, 500, 130
COMBINED = {
    "every_us": (None, 200),
    "every_events": (None, 1, 3),
    "confidence": (None, 0.5, 0.9),
}
OF_A_DURATION = {
    "callable": (CONFIG, "callable"),
    "callable, replayed": (REPLAYED, "callable"),
    "compiled": (TNT, "compiled"),
    "compiled, replayed": (REPLAYED, "compiled"),
}
OF_EVENTS = {
    "callable, by events": (BY_EVENTS[1], "callable"),
    "compiled, by events": (BY_EVENTS[0], "compiled"),
}
ALL = {
    f"{name}, hop {hop_us}": (way, hop_us) for name, way in OF_A_DURATION.items() for hop_us in HOPS
}
ALL |= {name: (way, None) for name, way in OF_EVENTS.items()}


@pytest.mark.parametrize(("way", "hop_us"), ALL.values(), ids=ALL)
def test_every_combination_of_triggers_on_a_stream_with_stragglers(way, hop_us):
    """The stream comes in one packet, and in small ones.

    Where possible, one packet is decided in one compiled call.
    """
    dropped = np.zeros(2, int)
    for seed, values in enumerate(itertools.product(*COMBINED.values())):
        triggers = dict(zip(COMBINED, values, strict=True))
        events = with_stragglers(seed)
        oracle, whole = pair(*way, hop_us=hop_us, **triggers)
        _, cut = pair(*way, hop_us=hop_us, **triggers)
        expected = []
        decisions = []
        first = 0
        for size in itertools.cycle([7, 1, 250]):
            packet = events[first : first + size]
            expected += oracle.push_all(packet)
            decisions += cut.push(packet)
            assert cut.counts == oracle.counts, triggers
            first += size
            if first >= len(events):
                break
        expected += oracle.finish()
        if oracle.close_calls:
            continue
        assert [as_values(d) for d in decisions + cut.finish()] == expected, triggers
        assert [as_values(d) for d in whole.push(events) + whole.finish()] == expected, triggers
        assert whole.counts == cut.counts == oracle.counts, triggers
        dropped += oracle.dropped_late, oracle.dropped_decided
    assert way in OF_EVENTS.values() or (dropped > 50).all()
