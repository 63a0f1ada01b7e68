"""Which decisions fall when: Processor against a plain oracle, for any cut of any stream."""

import copy
from dataclasses import replace
from functools import cache
from unittest import mock

from deciding import uneven
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_model
from oracles import Oracle, as_values

from async_tnt import CompiledClassifier, Processor, TNTConfig

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
    loud = {name: w * 12 for name, w in model.weights.items() if name.startswith("fc2") or name == "fc1.weight"}
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
    random_events, st.just(1300), seed=st.integers(0, 99), duration_us=st.just(5200), sensor=st.just((8, 8))
)
ways = st.sampled_from(
    [(CONFIG, "callable"), *((config, "compiled") for config in (CONFIG, TNT, REPLAYED)), (BY_EVENTS[0], "callable")]
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
    """At the end of the stream; without decisions that the last bit of exp made."""
    expected += oracle.finish()
    if oracle.close_calls:
        reject()
    assert [as_values(d) for d in decisions + processor.finish()] == expected
    counts = processor.counts
    assert counts.received == oracle.received
    assert (counts.dropped_late, counts.dropped_decided) == (oracle.dropped_late, oracle.dropped_decided)


@settings(max_examples=2 * settings.default.max_examples)
@given(
    events=st.one_of(nasty, nasty, nasty, long),
    way=ways,
    windows=windows,
    triggers=triggers,
    steps=st.lists(st.tuples(st.integers(0, 30), st.none() | change), max_size=8),
    large=st.sampled_from([3, 500]),
)
def test_any_triggers_any_windows_any_packets_any_changes(events, way, windows, triggers, steps, large):
    """steps : size of a packet, 0: one event by `push_one`; a trigger that is changed after it, if any.
    large : events of a packet that is decided in one compiled call."""
    with mock.patch("async_tnt.processor.STRETCH", large):
        check(events, way, windows, triggers, steps)


def check(events, way, windows, triggers, steps) -> None:
    oracle, processor = pair(*way, **windows, **triggers)
    expected, decisions, first = [], [], 0
    for size, changed in [*steps, (len(events), None)]:
        packet = events[first : first + max(size, 1)]
        first += len(packet)
        expected += oracle.push_all(packet)
        if size:
            decisions += processor.push(packet)
        else:
            decisions += [decision for event in packet.tolist() for decision in processor.push_one(*event)]
        if changed:
            name, value = changed
            oracle.change(**{name: value})
            setattr(processor, name, value)
            assert getattr(processor, name) == value
    assert_equal(oracle, processor, decisions, expected)
