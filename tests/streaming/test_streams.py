"""stream and astream."""

import asyncio

import numpy as np
import pytest
from made import random_events, random_model

from async_tnt import Processor, TNTConfig, astream, stream

CONFIG = TNTConfig(window_us=1000)
EVENTS = random_events(400, seed=1, duration_us=4000)


def classifier(volume):
    return [float(volume.sum()), 1.0]


def packets(size):
    return (EVENTS[first : first + size] for first in range(0, len(EVENTS), size))


def keys(decisions):
    return [(d.trigger, d.window_start_us, d.events, d.logits.tobytes()) for d in decisions]


EXPECTED = keys(stream([EVENTS], CONFIG, classifier=classifier))


@pytest.mark.parametrize(
    "source",
    [
        lambda: packets(70),
        lambda: iter(EVENTS),  # single records
        lambda: EVENTS.tolist(),  # single tuples
        lambda: [None, EVENTS[:0], EVENTS, None],
        lambda: (tuple(packet[name] for name in "txyp") for packet in packets(33)),
    ],
)
def test_any_source_gives_the_same_decisions(source):
    assert len(EXPECTED) == 4
    assert keys(stream(source(), CONFIG, classifier=classifier)) == EXPECTED


def test_stream_is_lazy():
    decisions = stream(packets(100), CONFIG, classifier=classifier)
    assert next(decisions).window_start_us == EVENTS["t"][0]


def test_stream_takes_model_path_and_processor(tmp_path):
    model = random_model(CONFIG)
    path = model.save(tmp_path / "m.safetensors")
    expected = keys(stream([EVENTS], model))
    assert keys(stream([EVENTS], path)) == expected
    assert keys(stream([EVENTS], str(path))) == expected
    processor = Processor(model)
    assert keys(stream([EVENTS], processor)) == expected
    with pytest.raises(TypeError, match="a Processor has its settings already, got also every_us"):
        next(stream([EVENTS], processor, every_us=5))


def test_settings_reach_the_processor():
    triggers = {d.trigger for d in stream([EVENTS], CONFIG, classifier=classifier, every_events=10)}
    assert triggers == {"every_events", "window", "end"}


def test_astream_equals_stream():
    async def source():
        for packet in packets(70):
            await asyncio.sleep(0)
            yield packet

    async def collect():
        return [decision async for decision in astream(source(), CONFIG, classifier=classifier)]

    assert keys(asyncio.run(collect())) == EXPECTED


def test_two_processors_side_by_side_do_not_touch_each_other():
    model = random_model(CONFIG)
    alone = keys(stream([EVENTS], model))
    a, b = Processor(model), Processor(model)
    got_a, got_b = [], []
    for packet in packets(13):
        got_a += a.push(packet)
        got_b += b.push(packet)
    assert keys(got_a + a.finish()) == keys(got_b + b.finish()) == alone


def test_decisions_keep_their_numbers_when_the_stream_goes_on():
    decisions, kept = [], []
    for decision in stream([EVENTS], random_model(CONFIG)):
        decisions.append(decision)
        kept.append((decision.logits.copy(), decision.probabilities.copy()))
    for decision, (logits, probabilities) in zip(decisions, kept, strict=True):
        assert np.array_equal(decision.logits, logits) and np.array_equal(decision.probabilities, probabilities)
    assert len({logits.tobytes() for logits, _ in kept}) == len(kept) == 4


def test_mistakes_show_before_the_first_event():
    with pytest.raises(FileNotFoundError, match="no model file digitz"):
        stream([EVENTS], "digitz")
    with pytest.raises(TypeError, match=r"`source` must yield events, got the path five.bin; open_recording"):
        stream("five.bin", CONFIG, classifier=classifier)
