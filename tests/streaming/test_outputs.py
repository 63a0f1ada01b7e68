"""Streams of raw outputs: views of the network's own arrays, copies where several are due."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from deciding import key
from hypothesis import given
from hypothesis import strategies as st
from made import nasty_streams, random_events, random_model, raw_model

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    Output,
    Processor,
    TNTConfig,
    TNTVolume,
    astream,
    stream,
    volumes,
    warmup,
)
from async_tnt.base.box import Box
from async_tnt.streaming.streams import PIECE

CONFIG = TNTConfig(sensor=(30, 24), grid=(14, 12), bins=3, window_us=1000, t_max=2.0)
MODEL = raw_model(CONFIG)
EVENTS = random_events(400, duration_us=4000, sensor=CONFIG.sensor)


def whole_pass(volume):
    return CompiledNetwork(MODEL)(volume)


def assert_same(arrays, expected):
    assert [array.shape for array in arrays] == [(2, 12, 14), (3, 6, 7), (3,)]
    for array, one in zip(arrays, expected, strict=True):
        assert array.tobytes() == one.tobytes()


def test_after_every_event_the_outputs_have_the_bits_of_a_whole_pass():
    processor = Processor(MODEL, every_events=1)
    for event in EVENTS[:150].tolist():
        *_, output = processor.push_one(*event)
        assert isinstance(output, Output) and output.names == ("flow", "half", "mean")
        assert_same(output.arrays, whole_pass(processor.volume()))
        assert output["half"] is output.arrays[1]


# a stream of hypothesis may look like one whose clock has begun again
@pytest.mark.filterwarnings("ignore:times went back")
@given(nasty_streams(CONFIG.sensor, 3000, 40), st.lists(st.integers(1, 60), min_size=1, max_size=5))
def test_each_window_has_the_outputs_of_its_volume(events, sizes):
    seen = [window.volume for window in volumes([events], CONFIG)]
    processor = Processor(MODEL)
    outputs = []
    first = 0
    while first < len(events):
        size = sizes[len(outputs) % len(sizes)]
        outputs += map(copy.copy, processor.push(events[first : first + size]))
        first += size
    outputs += processor.finish()
    for output, volume in zip(outputs, seen, strict=True):
        assert_same(output.arrays, whole_pass(volume))


def test_an_answer_is_a_view_and_the_next_call_changes_it():
    processor = Processor(MODEL, every_events=1)
    (first,) = processor.push_one(*EVENTS[0].tolist())
    kept = first.copy()
    before = key(kept)
    for event in EVENTS[1:20].tolist():
        (second,) = processor.push_one(*event)
    assert second.arrays is first.arrays and not first.arrays[0].flags.writeable
    assert key(kept) == before != key(first)


def test_of_several_answers_of_one_call_only_the_last_is_a_view():
    """At counts of events, ends of windows, moments of time, the end, and a restart."""
    settings = {"every_events": 7, "every_us": 130, "on_restart": "reset"}
    one_by_one = Processor(MODEL, **settings)
    at_once = Processor(MODEL, **settings)
    again = EVENTS.copy()
    expected = []
    for event in EVENTS.tolist():
        expected += map(key, map(copy.copy, one_by_one.push_one(*event)))
    outputs = at_once.push(EVENTS)
    assert [*map(key, outputs)] == expected
    own = {id(array) for output in outputs[:-1] for array in output.arrays}
    assert len(own) == 3 * (len(outputs) - 1)

    begun = at_once.push(again)  # the end of the old stream, then the new one
    old_end = [*map(key, one_by_one.finish())]
    assert begun[0].trigger == "end" and key(begun[0]) == old_end[0]
    fresh = Processor(MODEL, **settings)
    assert [*map(key, begun[1:])] == [*map(key, fresh.push(again))]


def test_overlapping_windows_have_outputs_of_their_own():
    together = Processor(MODEL, hop_us=500, start_us=0).push(EVENTS)
    for shift_us in (0, 500):
        alone = Processor(MODEL, start_us=shift_us).push(EVENTS[EVENTS["t"] >= shift_us])
        starts = [output.window_start_us for output in alone]
        same = [key(output) for output in together if output.window_start_us in starts]
        assert same == [*map(key, alone)] and len(same) >= 3


def test_what_lies_outside_the_boxes_has_not_changed():
    network = CompiledNetwork(MODEL)
    rng = np.random.default_rng(0)
    volume = TNTVolume(CONFIG)
    partial = set()
    for k in range(200):
        if k % 50 == 0:
            volume.open(1000 * k)
        before = [array.copy() for array in network.arrays]
        # near each other, so that most boxes are small
        volume.update_one(
            1000 * k + 13 * (k % 50), int(rng.integers(10, 14)), int(rng.integers(8, 12)), k % 2
        )
        arrays = network.refresh(volume)
        for number, (old, new, box) in enumerate(zip(before, arrays, network.changed, strict=True)):
            differs = (old.view(np.uint32) != np.ascontiguousarray(new).view(np.uint32)).reshape(
                len(new), *(new.shape[1:] or (1, 1))
            )
            rows, columns = differs.any(0).nonzero()
            if box.is_empty:
                assert not rows.size
                continue
            if k:  # before the first call nothing was computed
                assert box.x0 <= columns.min(initial=99) and columns.max(initial=-1) < box.x1
                assert box.y0 <= rows.min(initial=99) and rows.max(initial=-1) < box.y1
                partial.add(number * ((box.x1 - box.x0) < differs.shape[2]))
    assert partial == {0, 1}


def test_the_box_of_one_event_is_the_reach_of_its_pixels():
    """By hand: 4 cells of the volume at most, a 3x3 kernel around them; then every second place."""
    config = TNTConfig(sensor=(64, 48), grid=(200, 90), bins=1, transform="none")
    network = CompiledNetwork(raw_model(config))
    volume = TNTVolume(config)
    volume.open(0)
    network.refresh(volume)
    volume.update_one(10, 21, 0, 1)  # at x = 21 * 199 / 63 = 66.33, y = 0
    network.refresh(volume)
    assert network.changed[0] == Box(65, 0, 69, 2)
    # place k of the half map reads 2k - 1 to 2k + 1, and what a ReLU left at 0 has not changed
    half = network.changed[1]
    assert 32 <= half.x0 <= half.x1 <= 35 and half.y0 == 0 and half.y1 <= 2
    assert network.changed[2] == Box(0, 0, 1, 1)
    network.refresh(volume)
    assert all(box.is_empty for box in network.changed)


@pytest.mark.parametrize("size", [1, 40, 400])
def test_a_stream_yields_each_answer_when_it_is_due(size):
    packets = [EVENTS[k : k + size] for k in range(0, len(EVENTS), size)]
    expected = [*map(key, Processor(MODEL, every_events=9).push(EVENTS))]
    found = []
    for output in stream(packets, MODEL, every_events=9, finish=False):
        found.append(key(output))
    assert found == expected


def test_a_stream_makes_few_copies_of_a_long_packet(monkeypatch):
    n_copies = []
    monkeypatch.setattr(Output, "__copy__", lambda self: n_copies.append(1) or self)
    for _ in stream([EVENTS], MODEL, every_events=1):
        pass
    assert len(n_copies) <= 4  # where an event ends a window and is due itself
    assert len(EVENTS) > PIECE


def test_a_stream_drops_counts_and_refuses_late_events_as_a_push_does():
    events = EVENTS.copy()
    events["t"][7::9] = np.maximum(0, events["t"][7::9] - 300)
    pushed = Processor(MODEL, late="drop")
    streamed = Processor(MODEL, late="drop")
    expected = [*map(key, pushed.push(events))]
    expected += map(key, pushed.finish())
    assert [key(output) for output in stream([events], streamed)] == expected
    assert streamed.counts == pushed.counts and pushed.counts.dropped_late > 0
    with pytest.raises(ValueError, match=r"must not run backwards \(late=\"raise\"\)"):
        list(stream([events], MODEL, late="raise"))


def test_an_asynchronous_stream_yields_the_same():
    import asyncio

    async def source():
        yield EVENTS

    async def collect():
        return [key(output) async for output in astream(source(), MODEL, every_events=50)]

    assert asyncio.run(collect()) == [key(o) for o in stream([EVENTS], MODEL, every_events=50)]


@pytest.mark.parametrize("duplicate", [copy.copy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_have_arrays_of_their_own(duplicate):
    processor = Processor(MODEL, every_events=1)
    processor.push(EVENTS[:50])
    twin = duplicate(processor)
    (output,) = processor.push(EVENTS[50:51])
    (of_twin,) = twin.push(EVENTS[50:51])
    assert key(output) == key(of_twin)
    assert not np.shares_memory(output.arrays[0], of_twin.arrays[0])
    kept = pickle.loads(pickle.dumps(output))
    twin.push(EVENTS[51:90])
    assert key(kept) == key(output)


def test_a_saved_state_continues():
    processor = Processor(MODEL, every_events=1)
    processor.push(EVENTS[:50])
    again = Processor.from_state(processor.save_state(), MODEL)
    assert [*map(key, again.push(EVENTS[50:80]))] == [*map(key, processor.push(EVENTS[50:80]))]


def test_a_saved_state_continues_only_with_a_network_of_its_outputs():
    state = Processor(MODEL).save_state()
    decisions = Processor(random_model(CONFIG)).save_state()
    renamed = replace(MODEL, outputs={"other": MODEL.outputs["flow"]})
    for saved, model in ((state, random_model(CONFIG)), (decisions, MODEL), (state, renamed)):
        with pytest.raises(ValueError, match="`state` must be of a stream with the raw outputs"):
            Processor.from_state(saved, model)


def test_fire_and_reset():
    processor = Processor(MODEL)
    empty = processor.fire()
    assert empty.events == 0 and empty.trigger == "fire" and processor.classes == ()
    assert_same(empty.arrays, whole_pass(np.zeros(CONFIG.shape, np.float32)))
    processor.push(EVENTS[:60])
    processor.reset()
    assert_same(processor.fire().arrays, whole_pass(np.zeros(CONFIG.shape, np.float32)))


def test_the_network_of_a_processor_may_be_exchanged():
    processor = Processor(MODEL)
    other = CompiledNetwork(raw_model(CONFIG, seed=5))
    processor.classifier = other
    assert processor.fire().arrays is other.arrays
    with pytest.raises(TypeError, match="`classifier` must be a CompiledNetwork, because the"):
        processor.classifier = len
    with pytest.raises(ValueError, match="must take volumes of shape"):
        processor.classifier = CompiledNetwork(raw_model(CONFIG.replace(bins=2)))


def test_what_needs_classes_is_refused_in_one_line():
    message = "`confidence` is for models with classes; this one has raw outputs"
    with pytest.raises(ValueError, match=message):
        Processor(MODEL, confidence=0.9)
    with pytest.raises(ValueError, match=message):
        Processor(MODEL).confidence = 0.9
    with pytest.raises(TypeError, match="must be a CompiledNetwork, because the model has raw"):
        Processor(MODEL, classifier=len)
    with pytest.raises(TypeError, match="must return logits; a CompiledNetwork has raw outputs"):
        Processor(random_model(CONFIG)).classifier = CompiledNetwork(MODEL)
    with pytest.raises(TypeError, match="must return logits: the model has classes, and a Compi"):
        Processor(random_model(CONFIG), classifier=CompiledNetwork(MODEL))
    with pytest.raises(ValueError, match="`classes` are for a network of logits; the model has"):
        Processor(MODEL, classes=["a", "b"])
    with pytest.raises(ValueError, match=r"must have classes; CompiledNetwork\(model\) is for"):
        CompiledClassifier(MODEL)
    with pytest.raises(ValueError, match=r"must have raw outputs; CompiledClassifier\(model\) is"):
        CompiledNetwork(random_model(CONFIG))
    with pytest.raises(ValueError, match="`volume` must have shape"):
        CompiledNetwork(MODEL).refresh(TNTVolume(CONFIG.replace(bins=2)))


def test_as_text_and_as_values():
    config = CONFIG.replace(sensor=(4, 2), grid=(4, 2), bins=1, transform="none")
    output = Output(
        (
            np.float32([[[0, 1], [2, -3]]]),
            np.float32([np.nan, 1]),
            np.float32([2**24, 1, -(2**24)]),
        ),
        ("flow", "speed", "total"),
        (Box(0, 1, 2, 2), Box(0, 0, 1, 1), Box(0, 0, 1, 1)),
        100,
        150,
        7,
        True,
        "window",
    )
    assert repr(output) == (
        "Output(flow 1x2x2, speed 2, total 3, trigger='window', time_us=150, events=7)"
    )
    values = output.to_dict()
    flow = {"shape": [1, 2, 2], "least": -3.0, "mean": 0.0, "largest": 2.0}
    assert values["outputs"]["flow"] == flow | {"changed": [0, 1, 2, 2]}
    assert values["outputs"]["speed"]["least"] is None
    # a sum of float32 would lose the 1
    assert values["outputs"]["total"]["mean"] == 0.333333
    del values["outputs"]
    assert values == {
        "time_us": 150,
        "window_start_us": 100,
        "events": 7,
        "complete": True,
        "trigger": "window",
    }
    with pytest.raises(KeyError, match="no output 'depth': there are flow, speed"):
        output["depth"]
    assert warmup(raw_model(config)) >= 0
