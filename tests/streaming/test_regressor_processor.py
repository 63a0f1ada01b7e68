"""Landmark "regressor" in the Processor: decisions equal the torch pipeline's, however the stream is cut."""

import asyncio
import threading
import tracemalloc

import numpy as np
import pytest
from deciding import key, total_and_size
from held_memory import held
from made import random_events, random_model, random_regressor_model

from async_tnt import Processor, TNTConfig, astream, load_model, stream
from async_tnt.checking.reference import reference_pipeline

CONFIG = TNTConfig(window_us=1000, landmark="regressor", t_max=2.0)
MODEL = random_regressor_model(CONFIG, widths=(3, 4, 5), regressor_widths=(9, 5, 8), sharpness=20.0)


def run(events, size=0, model=MODEL, **settings):
    processor = Processor(model, **settings)
    size = size or max(1, len(events))
    decisions = []
    for first in range(0, len(events), size):
        decisions += processor.push(events[first : first + size])
    return decisions + processor.finish(), processor


@pytest.mark.parametrize("settings", [{}, {"every_us": 170}, {"every_events": 37}, {"hop_us": 300, "every_us": 170}])
@pytest.mark.parametrize("polarity", ["signed", "split"])
def test_decisions_equal_the_torch_pipeline(settings, polarity):
    config = CONFIG.replace(polarity=polarity, sensor=(40, 34), grid=(34, 30), bins=5)
    model = random_regressor_model(config, sharpness=10.0, seed=2)
    pipeline = reference_pipeline(model)
    events = random_events(700, seed=1, duration_us=3500, sensor=(20, 20), start_us=50)
    decisions, _ = run(events, 50, model, **settings)
    assert len(decisions) >= 4
    seen = set()
    for decision in decisions:
        inside = events[events["t"] >= decision.window_start_us][: decision.events]
        assert inside["t"][-1] == decision.time_us
        expected = pipeline(inside, decision.window_start_us)
        assert np.abs(decision.logits - expected).max() <= 1e-4
        assert decision.index == expected.argmax()
        seen.add(decision.logits.tobytes())
    assert len(seen) > len(decisions) / 2


def test_overlapping_windows_have_each_its_own_landmark():
    """Every window by itself gives the decision that it gives among others."""
    events = random_events(600, seed=4, duration_us=3000)
    decisions, _ = run(events, 13, hop_us=250, start_us=0)
    assert len(decisions) == 12
    for decision in decisions:
        start_us = decision.window_start_us
        inside = events[(events["t"] >= start_us) & (events["t"] < start_us + 1000)]
        alone, _ = run(inside, start_us=start_us)
        assert alone[0].logits.tobytes() == decision.logits.tobytes()


def test_a_network_of_ones_own_beside_a_configuration():
    seen = []

    def regressor(raw):
        seen.append(raw.shape)
        return 20.0, 10.0

    processor = Processor(CONFIG, classifier=total_and_size, regressor=regressor, hop_us=500)
    assert processor.landmark == (16.5, 16.5) and not seen
    decisions = processor.push(random_events(300, duration_us=2000))
    assert decisions and seen and set(seen) == {(9, 34, 34)}
    assert processor.landmark == (20.0, 10.0)


def test_a_regressor_of_ones_own_in_the_place_of_a_models():
    events = random_events(200, duration_us=900)
    mine, models = Processor(MODEL, regressor=lambda raw: (20.0, 10.0)), Processor(MODEL)
    mine.push(events), models.push(events)
    assert mine.landmark == (20.0, 10.0) != models.landmark
    assert mine.fire().label in MODEL.classes


def test_a_model_whose_transform_is_none_has_no_regressor():
    config = CONFIG.replace(transform="none")
    model = random_model(config, seed=3)
    plain = random_model(config.replace(landmark="running"), seed=3)
    events = random_events(200, duration_us=2500)
    decisions, processor = run(events, model=model)
    assert [key(d) for d in decisions] == [key(d) for d in run(events, model=plain)[0]]
    assert processor.landmark == (16.5, 16.5)


def test_stream_and_astream_from_a_saved_model(tmp_path):
    path = MODEL.save(tmp_path / "regressor.safetensors")
    events = random_events(400, seed=2, duration_us=3500)
    expected, _ = run(events, 100, every_us=300)
    packets = np.split(events, 4)

    async def source():
        for packet in packets:
            yield packet

    async def collect():
        return [decision async for decision in astream(source(), path, every_us=300)]

    for decisions in (list(stream(packets, load_model(path), every_us=300)), asyncio.run(collect())):
        assert [key(d) for d in decisions] == [key(d) for d in expected] and len(expected) > 4
    own = list(stream(packets, CONFIG, classifier=total_and_size, regressor=lambda raw: (16.5, 16.5)))
    centre = list(stream(packets, CONFIG.replace(landmark="center"), classifier=total_and_size))
    assert [key(d) for d in own] == [key(d) for d in centre]


def test_processors_of_one_model_in_several_threads():
    """Each has scratch memory of its own."""
    streams = [random_events(2000, seed=seed, duration_us=10_000) for seed in range(4)]
    expected = [[key(d) for d in run(events, 50)[0]] for events in streams]
    got = [None] * len(streams)

    def work(k):
        got[k] = [key(d) for d in run(streams[k], 50)[0]]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(streams))]
    [thread.start() for thread in threads], [thread.join() for thread in threads]
    assert got == expected


def test_a_long_stream_leaves_nothing_behind():
    processor = Processor(MODEL, every_us=500, hop_us=500)
    packet = random_events(500, duration_us=1000)
    tracemalloc.start()
    try:
        for k in range(120):
            processor.push(packet)
            packet["t"] += 1000
            if k == 20:
                before = held()
        after = held()
    finally:
        tracemalloc.stop()
    assert processor.counts.received == 60_000
    assert before > 0 and after - before < 20_000
