"""Windows that slide hold the events that the definition names, at every moment."""

import os
import pickle
import re

import numpy as np
import pytest
from held_memory import peak_of_process
from hypothesis import given, settings
from hypothesis import strategies as st
from made import events_of, nasty_streams, random_events, random_model

from async_tnt import CompiledClassifier, Model, Processor, TNTConfig, TNTVolume, load_model, stream
from async_tnt.kernels.volume import state as S
from async_tnt.volume import config as config_module
from async_tnt.volume.config import with_an_end

torch = pytest.importorskip("torch", reason="the reference needs torch")

from tnt_reference import sliding  # noqa: E402

SENSOR = (9, 8)
CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "60"))
"""Number of random streams. ASYNC_TNT_FUZZ_CASES makes it a long run: it was 10,000 once."""

LONG_STREAM = int(os.environ.get("ASYNC_TNT_LONG_STREAM", "60000"))
"""Number of events of the long stream. ASYNC_TNT_LONG_STREAM changes it: it was 20 million once."""

MORE_MEMORY = 1 << 24
"""Bytes that a process may take between two moments, for buffers of any library."""

WINDOWS = [{"last_events": n} for n in (1, 2, 7, 40)] + [{"last_us": t} for t in (1, 60, 400, 900)]
WINDOWS += [
    {"last_us": t, "representation": "volume", "bins": bins}
    for t, bins in ((60, 1), (4, 4), (60, 3), (400, 4), (900, 2), (900, 9))
]
POLARITIES = ("split", "signed", "unsigned")


def config_of(sensor=SENSOR, **settings):
    counts = {"representation": "count", "transform": "none", "polarity": "split"}
    return TNTConfig(sensor=sensor, grid=sensor, **counts | settings)


def bins_of(events, config, now_us=None, start_us=0):
    """The bin of each event, from the definition; -1 if the window does not hold it."""
    if config.last_events is not None:
        return sliding.last_events(events["t"], config.last_events).numpy() - 1
    if config.slice_us is None:
        return sliding.last_us(events["t"], config.last_us, now_us).numpy() - 1
    return sliding.slices(events["t"], start_us, config.last_us, config.bins, now_us).numpy()


def held(events, config, now_us=None, start_us=0):
    """The events of a window, and its volume."""
    bins = bins_of(events, config, now_us, start_us)
    inside = events[bins >= 0]
    return inside, image(inside, config, bins[bins >= 0])


def image(events, config, bins=0):
    """How many events each pixel has, in each bin."""
    expected = np.zeros(config.shape)
    channel = np.zeros(len(events), int) + bins
    sign = np.ones(len(events))
    if config.polarity == "split":
        channel += config.bins * (1 - events["p"].astype(int))
    if config.polarity == "signed":
        sign = np.where(events["p"] == 1, 1, -1)
    np.add.at(expected, (channel, events["y"], events["x"]), sign)
    return expected


@pytest.mark.parametrize("window", WINDOWS, ids=str)
@pytest.mark.parametrize("polarity", POLARITIES)
@settings(max_examples=settings.default.max_examples // 3)
@given(data=st.data())
def test_the_window_is_the_definition_at_every_event(window, polarity, data):
    """However the stream is cut into packets. Events may be late.

    A third of the usual number of streams: there are 42 kinds of windows.
    """
    config = config_of(polarity=polarity, **window)
    start_us = data.draw(st.sampled_from([0, 1_700_000_000_000_000]))
    events = data.draw(nasty_streams(SENSOR, 1000, start_us, max_events=50))
    sizes = data.draw(st.lists(st.integers(1, 20), min_size=1, max_size=5))
    one = TNTVolume(config)
    many = TNTVolume(config)
    one.open(start_us)
    many.open(start_us)
    ends = {0}
    while max(ends) < len(events):
        ends.add(min(len(events), max(ends) + sizes[len(ends) % len(sizes)]))
    last_end = 0
    for n in range(1, len(events) + 1):
        one.update_one(*events[n - 1].tolist())
        inside, expected = held(events[:n], config, start_us=start_us)
        np.testing.assert_array_equal(one.array, expected)
        assert one.n_events == len(inside)
        if n in ends:
            many.update(events[last_end:n])
            last_end = n
            np.testing.assert_array_equal(many.array, one.array)
            assert (many.counts, many.moment()) == (one.counts, one.moment())
            first_us = inside["t"].min() if config.last_us else inside["t"][0]
            assert one.moment()[0] == first_us


def test_random_streams():
    """Longer streams, whose rings go round many times, and whose events come late."""
    for seed in range(CASES):
        rng = np.random.default_rng(seed)
        window = {"last_events": int(rng.integers(1, 200))}
        if rng.random() < 0.6:
            window = {"last_us": int(rng.integers(1, 2_000))}
        if rng.random() < 0.5 and "last_us" in window:
            bins = int(rng.integers(1, 12))
            window = {"last_us": bins * int(rng.integers(1, 300)), "bins": bins}
            window["representation"] = "volume"
        sensor = (int(rng.integers(2, 40)), int(rng.integers(2, 40)))
        polarity = POLARITIES[rng.integers(3)]
        config = config_of(sensor, polarity=polarity, **window)
        n = int(rng.integers(1, 1_500))
        events = random_events(
            n, seed=seed, duration_us=int(rng.integers(1, 20_000)), sensor=sensor
        )
        late = rng.random(n) < 0.1
        events["t"][late] = np.maximum(0, events["t"][late] - rng.integers(0, 3_000, late.sum()))
        volume = TNTVolume(config)
        volume.open(0)
        done = 0
        while done < n:
            step = int(rng.integers(1, 400))
            volume.update(events[done : done + step])
            done = min(n, done + step)
            inside, expected = held(events[:done], config)
            np.testing.assert_array_equal(volume.array, expected, str(seed))
            assert volume.n_events == len(inside), seed


@pytest.mark.parametrize(
    "window",
    [
        {"last_events": 5_000},
        {"last_us": 30_000},
        {"last_us": 30_000, "representation": "volume", "bins": 5},
    ],
    ids=str,
)
def test_a_map_over_a_long_stream(window):
    """A network's value of each pixel follows the events that come and leave, late ones too.

    The second half of the stream takes no more memory than the first.
    """
    sensor = (64, 64)
    config = config_of(sensor, **window)
    torch.manual_seed(0)
    network = torch.nn.Sequential(
        torch.nn.Conv2d(config.channels, 8, 3, padding=1),
        torch.nn.ReLU(),
        torch.nn.Conv2d(8, 2, 3, padding=1),
    )
    processor = Processor(Model.from_torch(network.eval(), config))
    network.double()
    rng = np.random.default_rng(5)
    recent = random_events(0, sensor=sensor)
    now_us = 5_000
    start_us = None
    done = 0
    memory_of_half = None
    while done < LONG_STREAM:
        if done >= LONG_STREAM // 2 and memory_of_half is None:
            memory_of_half = memory_of(processor)
        n = int(rng.integers(1, 8_000))
        events = random_events(n, seed=done, sensor=sensor)
        events["t"] = now_us + np.cumsum(rng.integers(0, 13, n))
        now_us = int(events["t"][-1])
        late = rng.random(n) < 0.01
        events["t"][late] -= rng.integers(0, 2_000, late.sum())
        start_us = int(events["t"][0]) if start_us is None else start_us
        processor.push(events)
        done += n
        # more than enough: 30 ms hold about 5,000 events here
        recent = np.concatenate([recent, events])[-40_000:]
        recent = recent[recent["t"] >= start_us]
        _, expected = held(recent, config, start_us=start_us)
        np.testing.assert_array_equal(processor.volume(), expected)
        with torch.no_grad():
            values = network(torch.from_numpy(expected)[None])[0].numpy()
        np.testing.assert_allclose(processor.fire()["output"], values, atol=1e-5)
    assert processor.counts.received == done
    for now, before in zip(memory_of(processor), memory_of_half, strict=True):
        assert now <= before + MORE_MEMORY


def memory_of(processor):
    """Bytes of the state of a Processor, and of the process where the system says it."""
    return len(pickle.dumps(processor)), peak_of_process() or 0


def test_a_window_of_a_number_of_events_by_hand():
    volume = TNTVolume(config_of(last_events=2))
    volume.open(0)
    volume.update(([10, 20, 30], [1, 2, 2], [3, 4, 4], [1, 0, 0]))
    assert volume.array[1, 4, 2] == 2 and volume.array.sum() == 2 == volume.n_events
    assert volume.moment() == (20, 30, 2) and volume.n_arrived == 3
    # an event that comes late is one of the last, too
    volume.update_one(5, 0, 0, 1)
    assert volume.array[0, 0, 0] == 1 == volume.array[1, 4, 2] and volume.moment() == (30, 30, 2)
    assert volume.n_left_early == 0  # as only an event of a window of a time can


def test_a_window_of_a_time_by_hand():
    """An event as old as the window has left it."""
    volume = TNTVolume(config_of(last_us=20))
    volume.open(7)
    assert volume.moment() == (7, 7, 0)
    volume.open(0)
    volume.update(([10, 20, 29], [1, 2, 3], [1, 2, 3], [1, 1, 1]))
    assert volume.n_events == 3 and volume.moment() == (10, 29, 3)
    volume.update_one(30, 4, 4, 1)
    assert volume.array[0, 1, 1] == 0 and volume.moment() == (20, 30, 3)
    # late: at 12 it is in the window, at 10 it is not
    volume.update_one(12, 5, 5, 1)
    volume.update_one(10, 6, 6, 1)
    assert volume.array[0, 5, 5] == 1 and volume.array[0, 6, 6] == 0
    assert volume.counts.dropped_late == 1 and volume.n_events == 4
    # it leaves at 32, before the events that came earlier
    volume.update_one(32, 0, 0, 0)
    assert volume.array[0, 5, 5] == 0 and volume.array[0, 2, 2] == 1 and volume.n_events == 4
    volume.advance(40)
    assert volume.array[0, 2, 2] == 0 and volume.moment() == (29, 32, 3)
    volume.advance(1_000)
    assert volume.n_events == 0 == volume.array.sum() and volume.moment() == (32, 32, 0)


def test_a_window_of_slices_by_hand():
    """Three slices of 10 us from 100 us on. A pixel for each event says in which bin it is."""
    volume = TNTVolume(config_of(last_us=30, representation="volume", bins=3, polarity="unsigned"))
    volume.open(100)

    def bins():
        return {
            (int(x), int(b)): int(volume.array[b, y, x])
            for b, y, x in zip(*np.nonzero(volume.array), strict=True)
        }

    volume.update(([100, 109, 110, 119], [0, 1, 2, 3], [0] * 4, [1, 0, 1, 1]))
    assert bins() == {(0, 1): 1, (1, 1): 1, (2, 2): 1, (3, 2): 1}
    volume.update_one(129, 4, 0, 1)
    assert bins() == {(0, 0): 1, (1, 0): 1, (2, 1): 1, (3, 1): 1, (4, 2): 1}
    # a late event goes to its own slice
    volume.update_one(101, 5, 0, 1)
    assert bins()[5, 0] == 1
    # the first slice leaves, and an event of it is too late then
    volume.update(([130, 109], [6, 7], [0, 0], [1, 1]))
    assert bins() == {(2, 0): 1, (3, 0): 1, (4, 1): 1, (6, 2): 1}
    assert volume.counts.dropped_late == 1 and volume.moment() == (110, 130, 4)
    # time passes without events; two slices leave
    volume.advance(139)
    assert volume.n_events == 4
    volume.advance(150)
    assert bins() == {(6, 0): 1} and volume.moment() == (130, 130, 1)
    # a pause of many windows
    volume.update_one(1_000_003, 8, 0, 0)
    assert bins() == {(8, 2): 1} and volume.n_events == 1


def test_a_full_window_of_a_time_loses_its_oldest_events(monkeypatch):
    monkeypatch.setattr(config_module, "MAX_LAST_EVENTS", 5)
    monkeypatch.setattr("async_tnt.volume.state.MAX_LAST_EVENTS", 5)
    config = config_of(last_us=1_000)
    events = random_events(300, duration_us=20_000, sensor=SENSOR)
    found = []
    for size in (1, 7, 300):
        volume = TNTVolume(config)
        volume.open(0)
        for first in range(0, 300, size):
            volume.update(events[first : first + size])
        found.append((volume.array.tobytes(), volume.n_left_early, volume.n_events))
    assert found[0] == found[1] == found[2] and 0 < found[0][1] < 300 and found[0][2] == 5
    np.testing.assert_array_equal(volume.array, image(events[-5:], config))
    volume.reset()
    assert volume.n_left_early == 0


class FullWindow:
    """The events of a window of `last_us` that holds a few at most, kept in a list."""

    def __init__(self, config, n_most):
        self.config = config
        self.n_most = n_most
        self.events = []  # by time, and those of one time in the order of their arrival
        self.newest_us = 0
        self.n_left_early = 0
        self.n_late = 0

    def oldest_us(self):
        """The first time that is in the window."""
        slice_us = self.config.slice_us
        if slice_us is None:
            return self.newest_us - self.config.last_us + 1
        return (self.newest_us // slice_us - self.config.bins + 1) * slice_us

    def add(self, event):
        self.newest_us = max(self.newest_us, event[0])
        self.events = [one for one in self.events if one[0] >= self.oldest_us()]
        if event[0] < self.oldest_us():
            self.n_late += 1
            return
        if len(self.events) == self.n_most:
            del self.events[0]
            self.n_left_early += 1
        place = sum(one[0] <= event[0] for one in self.events)
        self.events.insert(place, event)

    def array(self):
        events = events_of(*np.array(self.events).T)
        slice_us = self.config.slice_us
        bins = 0
        if slice_us is not None:
            bins = events["t"] // slice_us - self.newest_us // slice_us + self.config.bins - 1
        return image(events, self.config, bins)


@pytest.mark.parametrize(
    "window", [{"last_us": 20}, {"last_us": 20, "representation": "volume", "bins": 2}], ids=str
)
def test_a_full_window_with_pauses_and_late_events_is_that_of_a_list(window, monkeypatch):
    """Many events have equal times. What is too old by then has not left early."""
    monkeypatch.setattr("async_tnt.volume.state.MAX_LAST_EVENTS", 5)
    config = config_of(**window)
    rng = np.random.default_rng(1)
    n = 600
    times = np.cumsum(rng.choice([0, 0, 1, 3, 12, 40], n))
    late = rng.random(n) < 0.3
    times[late] = np.maximum(0, times[late] - rng.integers(1, 40, late.sum()))
    events = events_of(times, rng.integers(0, 9, n), rng.integers(0, 8, n), rng.integers(0, 2, n))
    for size in (0, 1, 9, 150):
        volume = TNTVolume(config)
        volume.open(0)
        expected = FullWindow(config, 5)
        for first in range(0, n, max(size, 1)):
            packet = events[first : first + max(size, 1)]
            if size:
                volume.update(packet)
            else:
                volume.update_one(*packet[0].tolist())
            for event in packet.tolist():
                expected.add(event)
            np.testing.assert_array_equal(volume.array, expected.array())
            counted = (volume.n_events, volume.n_left_early, volume.counts.dropped_late)
            assert counted == (len(expected.events), expected.n_left_early, expected.n_late)
    assert expected.n_left_early > 50 < expected.n_late


def small_model(**window):
    """A model of three classes that counts events of parts of the sensor."""
    config = config_of(**window)
    weight = np.random.default_rng(0).normal(size=(3, 2 * 8 * 9)).astype(np.float32)
    layers = [
        {"op": "flatten", "name": "flat", "inputs": ["volume"]},
        {"op": "dense", "name": "fc", "inputs": ["flat"], "weights": {"weight": "w"}},
    ]
    return Model(config, {"w": weight}, ["a", "b", "c"], network={"classifier": layers})


def logits_of(events, model):
    return model.weights["w"].astype(np.float64) @ image(events, model.config).reshape(-1)


@pytest.mark.parametrize("window", [{"last_events": 25}, {"last_us": 300}], ids=str)
def test_decisions_are_about_the_window_as_it_is_then(window):
    model = small_model(**window)
    events = random_events(200, duration_us=2_000, sensor=SENSOR, start_us=70)
    decisions = list(stream(events, model, every_events=3))
    *regular, end = decisions
    assert [d.trigger for d in regular] == ["every_events"] * (len(events) // 3)
    assert end.trigger == "end" and not any(d.complete for d in decisions)
    for k, decision in enumerate(regular, 1):
        inside, _ = held(events[: 3 * k], model.config)
        np.testing.assert_allclose(decision.logits, logits_of(inside, model), atol=1e-4)
        assert decision.events == len(inside)
        assert decision.time_us == events["t"][3 * k - 1]
        assert decision.window_start_us == inside["t"][0]


@pytest.mark.parametrize("stretch", [1, 500], ids=["in one compiled call", "one by one"])
def test_a_decision_of_every_us_is_about_the_events_that_are_in_the_window_then(
    stretch, monkeypatch
):
    """Also those that leave without a new event are gone."""
    monkeypatch.setattr("async_tnt.streaming.processor.STRETCH", stretch)
    model = small_model(last_us=300)
    events = random_events(40, duration_us=6_000, sensor=SENSOR)
    processor = Processor(model, every_us=250, start_us=0)
    decisions = processor.push(events) + processor.finish()
    moments = np.arange(250, events["t"][-1] + 1, 250)
    # a decision at a moment if events came since the last one, made when a later event comes
    expected = []
    n_before = 0
    for moment in moments:
        n = int(np.searchsorted(events["t"], moment))
        if n > n_before and n < len(events):
            inside, _ = held(events[:n], model.config, int(moment))
            expected.append((len(inside), logits_of(inside, model)))
            n_before = n
    assert [d.events for d in decisions[:-1]] == [n for n, _ in expected]
    for decision, (_, logits) in zip(decisions, expected, strict=False):
        np.testing.assert_allclose(decision.logits, logits, atol=1e-4)


def changes_of_class(decisions, level):
    """The decisions that name a class with this probability, and another one than before."""
    last = None
    for decision in decisions:
        if decision.probability >= level and decision.label != last:
            last = decision.label
            yield decision


def told(decision):
    return decision.time_us, decision.label, decision.events, decision.probabilities.tobytes()


@pytest.mark.parametrize("window", [{"last_events": 25}, {"last_us": 300}], ids=str)
@pytest.mark.parametrize("is_compiled", [True, False])
@pytest.mark.parametrize("other", [{}, {"every_events": 3}, {"every_us": 50}], ids=str)
def test_confidence_tells_when_the_class_changes(window, is_compiled, other):
    """No decision closes the window. A class that is named twice in a row is told once."""
    model = small_model(**window)
    events = random_events(400, duration_us=4_000, sensor=SENSOR)
    level = 0.45
    classifier = CompiledClassifier(model)
    how = {} if is_compiled else {"classifier": lambda volume: classifier(volume)}
    all_decisions = list(stream(events, model, **how, **(other or {"every_events": 1})))
    end = all_decisions.pop()
    expected = [told(decision) for decision in changes_of_class(all_decisions, level)]
    assert len(expected) > 5

    processor = Processor(model, confidence=level, **how, **other)
    decisions = []
    for first in range(0, len(events), 130):
        decisions += processor.push(events[first : first + 130])
    found = [decision for decision in decisions if decision.trigger == "confidence"]
    assert [told(decision) for decision in found] == expected
    assert not any(decision.complete for decision in decisions)
    assert processor.counts.dropped_decided == 0
    if other:  # the other decisions are as without it
        assert [told(decision) for decision in decisions] == [told(d) for d in all_decisions]
    assert [told(decision) for decision in processor.finish()] == [told(end)]

    # after a reset the first class is told again
    processor.reset()
    again = processor.push(events[:200])
    again = [told(decision) for decision in again if decision.trigger == "confidence"]
    assert again == expected[: len(again)] and again


@pytest.mark.parametrize("is_compiled", [True, False])
def test_a_window_that_is_empty_at_a_decision_begins_at_its_newest_event(is_compiled, monkeypatch):
    monkeypatch.setattr("async_tnt.streaming.processor.STRETCH", 1)  # in one compiled call
    model = small_model(last_us=30)
    classifier = CompiledClassifier(model)
    how = {} if is_compiled else {"classifier": lambda volume: classifier(volume)}
    events = events_of([10, 400], [1, 2], [1, 2], [1, 1])
    (decision,) = Processor(model, every_us=100, start_us=0, **how).push(events)
    about = (decision.trigger, decision.window_start_us, decision.time_us, decision.events)
    assert about == ("every_us", 10, 10, 0)


def test_decisions_may_be_farther_apart_than_the_window_is_long(recwarn):
    model = small_model(last_us=300)
    events = random_events(400, duration_us=6_000, sensor=SENSOR)
    decisions = list(stream(events, model, every_us=1_000, start_us=0))
    assert [d.trigger for d in decisions] == ["every_us"] * 5 + ["end"]
    assert not recwarn.list


@pytest.mark.parametrize("window", [{"last_events": 25}, {"last_us": 300}], ids=str)
def test_events_after_the_end_of_a_stream_begin_another_window(window):
    model = small_model(**window)
    events = random_events(120, duration_us=1_500, sensor=SENSOR)
    processor = Processor(model, confidence=1e-9)
    first = [told(d) for d in processor.push(events)]
    assert len(processor.finish()) == 1
    later = events.copy()
    later["t"] += 10_000
    again = processor.push(later)
    # the first class is told again, as of a new stream
    assert [told(d)[1:] for d in again] == [one[1:] for one in first] and first
    assert processor.counts.dropped_late == 0 and len(processor.finish()) == 1


def test_a_new_level_of_confidence_tells_the_class_again():
    processor = Processor(small_model(last_us=300), confidence=1e-9)
    packet = ([10], [1], [1], [1])
    assert len(processor.push(packet)) == 1
    assert processor.push(([11], [1], [1], [1])) == []
    processor.confidence = 1e-8
    assert len(processor.push(([12], [1], [1], [1]))) == 1


def test_fire_at_a_later_time():
    model = small_model(last_us=300)
    processor = Processor(model)
    processor.push(([10, 100, 200], [1, 2, 3], [1, 2, 3], [1, 1, 1]))
    assert processor.fire().events == 3 == processor.fire(at_us=100).events
    assert processor.fire(at_us=400).events == 1
    assert processor.fire(at_us=500).events == 0
    # events that have left do not come back
    assert processor.fire().events == 0 and processor.counts.received == 3
    with pytest.raises(TypeError, match="`at_us` must be"):
        processor.fire(at_us="now")


def test_the_log_and_the_network_follow_events_that_leave():
    """Thousands of events without a read, then single ones."""
    config = config_of(sensor=(40, 30), last_events=500)
    model = random_model(
        config.replace(sensor=(40, 32), grid=(40, 32)), classes=3, widths=(3, 4, 5)
    )
    events = random_events(6_000, sensor=(40, 32))
    slow = Processor(model)
    quick = Processor(model, every_events=1)
    quick.push(events[:5_000])
    for n in range(5_000, 5_300):
        (decision,) = quick.push(events[n : n + 1])
        slow.reset()
        slow.push(events[max(0, n - 600) : n + 1])
        assert decision.logits.tobytes() == slow.fire().logits.tobytes()


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"last_events": 0}, "`last_events` must be"),
        ({"last_us": -1}, "`last_us` must be"),
        ({"last_events": 5, "last_us": 7}, "`last_us` must not be given with `last_events`: a wi"),
        ({"window_us": 5, "last_us": 7}, "`last_us` must not be given with `window_us`: a window"),
        (
            {"last_us": 7, "representation": "volume"},
            '`last_us` needs representation="count" or "volume", transform="none"',
        ),
        (
            {"last_us": 7, "representation": "volume", "transform": "none", "bins": 2},
            "`last_us` must be a multiple of `bins`, 2, as bins are slices of equal length, got 7",
        ),
        (
            {"last_events": 7, "representation": "volume", "transform": "none"},
            '`last_events` needs representation="count", transform="none"',
        ),
        (
            {"last_us": 7, "grid": (5, 5)},
            '`last_us` needs representation="count" or "volume", transform="none"',
        ),
        ({"last_events": 7, "transform": "tnt"}, '`last_events` needs representation="count", tra'),
        (
            {"last_events": 7, "representation": "time_surface", "transform": "none"},
            '`last_events` needs representation="count": all pixels of a time surface decay with',
        ),
    ],
)
def test_what_cannot_slide_is_refused(settings, message):
    values = {"sensor": SENSOR, "grid": SENSOR, "representation": "count"} | settings
    with pytest.raises((ValueError, TypeError), match=f"^{re.escape(message)}"):
        TNTConfig(**values)


def test_settings_for_windows_that_end_are_refused():
    model = small_model(last_us=300)
    with pytest.raises(ValueError, match="`hop_us` must not be given with a window that slides"):
        Processor(model, hop_us=100)


def test_configurations_as_data(tmp_path):
    """Files of windows that end can be read by earlier releases: they have no new names."""
    for window in ({"last_events": 5}, {"last_us": 7}):
        config = config_of(**window)
        assert TNTConfig.from_dict(config.to_dict()) == config
        assert "window_us" not in config.to_dict()
        model = small_model(**window)
        assert load_model(model.save(tmp_path / "m.safetensors")).config == model.config
        assert config.replace(**{name: None for name in window}) == config_of()
    assert not {"last_events", "last_us"} & set(TNTConfig().to_dict())
    assert config_of(last_events=5).window_us == 3_600_000_000
    assert with_an_end(config_of(last_us=7)) == config_of(window_us=7)
    assert config_of(last_us=7).replace(last_us=9).last_us == 9
    assert config_of().replace(last_us=9) == config_of(last_us=9)


def test_the_ring_lies_behind_the_log():
    volume = TNTVolume(config_of(last_events=3))
    ints = volume.state().view(np.int64)
    assert ints[S.RING] == ints[S.LOG] + ints[S.LOG_SIZE]
    assert volume.state().size == ints[S.RING] + 2 * 3
