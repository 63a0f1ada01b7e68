"""Laws for everything that takes a stream: volumes of every kind, processors with every trigger.

Decisions, volumes, landmarks and counts are the same, bit for bit, however the stream is cut into
packets; after a reset, in a copy, from a pickle; whatever invalid packets arrived and whatever was
read in between.
"""

import copy
import dataclasses
import itertools
import pickle
from functools import partial
from unittest import mock

import numpy as np
import pytest
from deciding import key, uneven
from hypothesis import given
from hypothesis import strategies as st
from made import (
    nasty_streams,
    random_events,
    random_model,
    random_regressor_model,
    raw_model,
)
from networks.random_spiking import random_spiking_model

from async_tnt import CompiledRegressor, Processor, SpikingVolume, TNTConfig, TNTVolume

CONFIG = TNTConfig(sensor=(30, 24), grid=(14, 12), bins=3, window_us=1000, t_max=2.0)
KINDS = {
    "center": CONFIG.replace(landmark="center"),
    "running": CONFIG,
    "line": CONFIG.replace(landmark="line", polarity="unsigned"),
    "line, flow removed": CONFIG.replace(landmark="line", remove_flow=True, polarity="split"),
    "window": CONFIG.replace(landmark="window", polarity="split"),
    "regressor": CONFIG.replace(landmark="regressor"),
    "of 60 events": CONFIG.replace(window_events=60, window_us=None),
    "of 50 events, flow removed": CONFIG.replace(
        window_events=50, landmark="line", remove_flow=True
    ),
    "of 70 events, regressor": CONFIG.replace(window_events=70, landmark="regressor"),
    "image of counts": CONFIG.replace(
        representation="count", bins=None, landmark="line", polarity="split"
    ),
    "image of counts and times": CONFIG.replace(
        representation="count_time", bins=None, transform="none", polarity="split"
    ),
    "image of mean times": CONFIG.replace(
        representation="mean_time", bins=None, transform="none", polarity="unsigned", grid=(30, 24)
    ),
    "time surface": CONFIG.replace(
        representation="time_surface", bins=None, transform="none", polarity="split"
    ),
    "last 60 events": CONFIG.replace(
        representation="count", grid=(30, 24), polarity="signed", last_events=60
    ),
    "last 700 us in slices": CONFIG.replace(
        representation="volume", transform="none", grid=(30, 24), bins=7, last_us=700
    ),
    "last 700 us": CONFIG.replace(representation="count", grid=(30, 24), last_us=700),
    "no transform": CONFIG.replace(transform="none", polarity="split"),
    "line of pixels": CONFIG.replace(transform="none", sensor=(30, 1), grid=(30, 1)),
    "one bin, large": CONFIG.replace(sensor=(300, 200), grid=(300, 200), bins=1),
}
SETTINGS = {
    "windows": {},
    "overlapping": {"hop_us": 300},
    "overlapping, uneven": {"hop_us": 999, "start_us": 40, "every_us": 90},
    "every_us": {"every_us": 170, "start_us": 60},
    "every_events": {"every_events": 7, "late": "drop"},
    "every event": {"every_events": 1},
    "confidence": {"confidence": 0.4},
    "confidence every 3 events, overlapping": {
        "confidence": 0.38,
        "every_events": 3,
        "hop_us": 250,
    },
    "every 5 events and every_us, overlapping": {"every_events": 5, "every_us": 300, "hop_us": 450},
}


class Copied:
    """Copied as what it holds is."""

    def __copy__(self):
        twin = object.__new__(type(self))
        vars(twin).update({name: copy.copy(value) for name, value in vars(self).items()})
        return twin


class Volume(Copied):
    """A TNTVolume, used like a Processor that never decides."""

    def __init__(self, config):
        regressor = None
        if config.needs_regressor:
            model = random_regressor_model(config, widths=(3, 4, 5), sharpness=20.0)
            regressor = CompiledRegressor(model)
        self.volume = TNTVolume(config, regressor=regressor)

    def push(self, events):
        return [1] * self.volume.update(events)

    def push_one(self, *event):
        return [1] * self.volume.update_one(*event)

    def reset(self):
        self.volume.reset()

    def look(self):
        volume = self.volume
        return (
            volume.array.tobytes(),
            volume.landmark,
            volume.counts,
            volume.start_us,
            volume.n_events,
        )


SPIKING = TNTConfig(sensor=(30, 24), grid=(30, 24), representation="count", window_us=1000)


class Neurons(Volume):
    """A SpikingVolume, used like a Processor that never decides."""

    def __init__(self, config, seed):
        self.volume = SpikingVolume(random_spiking_model(seed, config))

    def look(self):
        volume = self.volume
        layers = [volume.membranes(layer).tobytes() for layer in volume.network.layers]
        first, *others = super().look()
        return first, *others, volume.spike_counts().tobytes(), layers


class Stream(Copied):
    """A Processor, its decisions as comparable values."""

    def __init__(self, config, compiled, settings):
        model = random_model(
            config, classes=3, widths=(3, 4, 5), regressor_widths=(3, 3, 3), sharpness=20.0
        )
        self.processor = Processor(model, classifier=None if compiled else uneven, **settings)

    def push(self, events):
        return [key(decision) for decision in self.processor.push(events)]

    def push_one(self, *event):
        return [key(decision) for decision in self.processor.push_one(*event)]

    def reset(self):
        self.processor.reset()

    def look(self):
        processor = self.processor
        fired = self.processor.fire()
        return processor.volume().tobytes(), processor.landmark, processor.counts, key(fired)


class OutputStream(Stream):
    """A Processor of a model of raw outputs, its answers as comparable values."""

    def __init__(self, config, settings):
        self.processor = Processor(raw_model(config), **settings)


class SpikingStream(Stream):
    """A Processor of a spiking model, its answers as comparable values."""

    def __init__(self, config, raw, settings):
        self.processor = Processor(random_spiking_model(SEEDS[raw], config, raw=raw), **settings)


SEEDS = {False: 9, True: 11}
"""Whether outputs are raw -> the seed of a network that has spikes in all layers."""

VOLUMES = {f"volume: {kind}": partial(Volume, config) for kind, config in KINDS.items()}
VOLUMES |= {f"neurons: {seed}": partial(Neurons, SPIKING, seed) for seed in SEEDS.values()}
OF_A_DURATION = {"hop_us", "start_us"}
# Each setting with both ways of deciding, and with one of the other landmarks.
OTHERS = zip(itertools.cycle(["line", "window", "regressor", "image of mean times"]), SETTINGS)
STREAMS = [
    *itertools.product(["running"], SETTINGS, (True, False)),
    *((kind, name, True) for kind, name in OTHERS),
    *(
        (kind, name, True)
        for kind in ("last 60 events", "last 700 us", "last 700 us in slices")
        for name, settings in SETTINGS.items()
        if "hop_us" not in settings
    ),
    *(
        ("of 60 events", name, name != "every_events")
        for name, settings in SETTINGS.items()
        if OF_A_DURATION.isdisjoint(settings)
    ),
]
"""Kind, name of settings, whether our compiled network decides."""
PROCESSORS = {}
for _kind, _name, _compiled in STREAMS:
    _decides = "network" if _compiled else "callable"
    _make = partial(Stream, KINDS[_kind], _compiled, SETTINGS[_name])
    PROCESSORS[f"{_kind}, {_name}, {_decides}"] = _make
OUTPUTS = {
    f"raw outputs, {name}": partial(OutputStream, CONFIG, settings)
    for name, settings in SETTINGS.items()
    if "confidence" not in settings
}
SPIKES = {}
for _name, _settings in SETTINGS.items():
    SPIKES[f"spiking, {_name}"] = partial(SpikingStream, SPIKING, False, _settings)
    if "hop_us" not in _settings:
        _kept = {**_settings, "keep_neurons": True}
        SPIKES[f"spiking, kept, {_name}"] = partial(SpikingStream, SPIKING, False, _kept)
    if "confidence" not in _settings:
        SPIKES[f"spiking, raw, {_name}"] = partial(SpikingStream, SPIKING, True, _settings)
ALL = VOLUMES | PROCESSORS | OUTPUTS | SPIKES
of_all = pytest.mark.parametrize("make", ALL.values(), ids=ALL)


def events_of(make, n=400, seed=1, start_us=50):
    """Four windows of events, some of them late."""
    sensor = make.args[0].sensor
    events = random_events(n, seed=seed, duration_us=4000, start_us=start_us, sensor=sensor)
    events["t"][::23] = np.maximum(start_us, events["t"][::23] - 700)
    return events


def fed(stream, events, sizes=(400,)):
    """The outputs of a stream cut into packets of these sizes, over and over.

    A size of 0 is one event by `push_one`.
    """
    outputs = []
    first = 0
    sizes = itertools.cycle(sizes)
    while first < len(events):
        size = next(sizes)
        if size == 0:
            outputs += stream.push_one(*events[first].tolist())
            first += 1
        else:
            outputs += stream.push(events[first : first + size])
            first += size
    return outputs


@of_all
@pytest.mark.parametrize("sizes", [(2, 0, 7), (399,)], ids=str)
def test_packets_of_any_size_give_the_same(make, sizes):
    """The whole is decided in one compiled call where there is one, as a longer packet would be."""
    events = events_of(make)
    whole = make()
    cut = make()
    with mock.patch("async_tnt.streaming.processor.STRETCH", 1):
        outputs = fed(whole, events)
    assert outputs == fed(cut, events, sizes)
    # the stream of a sliding window without triggers has no answers
    assert outputs or any(name in str(make.args[0]) for name in ("last_events=60", "last_us=700"))
    assert cut.look() == whole.look()
    assert any(whole.look()[0]) or isinstance(whole, Stream)  # whose window may be closed early


# a stream of hypothesis may look like one whose clock has begun again
@pytest.mark.filterwarnings("ignore:times went back")
@given(data=st.data())
def test_any_packets_of_any_stream_give_the_same(data):
    """A stream may even be pickled in between."""
    name = data.draw(st.sampled_from(list(ALL)))
    make = ALL[name]
    start_us = data.draw(st.sampled_from([0, 123_456_789, 1_700_000_000_000_000]))
    events = data.draw(nasty_streams(make.args[0].sensor, 3500, start_us, max_events=60))
    sizes = data.draw(st.lists(st.integers(0, 40), min_size=1, max_size=6))
    stop = data.draw(st.integers(0, 60))
    whole = make()
    cut = make()
    expected = fed(whole, events)
    got = fed(cut, events[:stop], sizes)
    cut = pickle.loads(pickle.dumps(cut))
    got += fed(cut, events[stop:], sizes)
    assert got == expected
    assert cut.look() == whole.look()


@pytest.mark.parametrize("make", VOLUMES.values(), ids=VOLUMES)
def test_blocks_of_events_have_the_bits_of_single_events(make):
    """Long packets run in vector registers, single events in scalars."""
    events = random_events(1500, seed=2, duration_us=1000, sensor=make.args[0].sensor)
    one = make()
    many = make()
    fed(one, events, (0,))
    fed(many, events, (1500,))
    assert one.look() == many.look() and any(one.look()[0])


@of_all
@pytest.mark.parametrize("few", [False, True])
def test_after_a_reset_it_is_as_new(make, few):
    """Few events, close together: not all cells have to be emptied."""
    used = make()
    new = make()
    events = events_of(make, seed=5, start_us=90_000)
    if few:
        events = events[:2]
        events["x"] = (0, 1)
        events["y"] = 0
        events["p"] = 1
    fed(used, events)
    used.look()
    used.reset()
    assert used.look() == new.look()
    assert fed(used, events_of(make)) == fed(new, events_of(make))
    assert used.look() == new.look()


@of_all
@pytest.mark.parametrize(
    "duplicate", [copy.copy, copy.deepcopy, lambda stream: pickle.loads(pickle.dumps(stream))]
)
def test_a_copy_continues_like_the_original_and_shares_nothing(make, duplicate):
    original = make()
    alone = make()
    events = events_of(make)
    fed(original, events[:170], (13,))
    fed(alone, events[:170], (13,))
    twin = duplicate(original)
    before = original.look()
    outputs = fed(twin, events[170:], (11,))
    assert original.look() == before
    assert fed(original, events[170:], (11,)) == outputs == fed(alone, events[170:], (11,))
    assert original.look() == twin.look() == alone.look()


@of_all
def test_invalid_packets_change_nothing(make):
    stream = make()
    alone = make()
    events = events_of(make)
    width = make.args[0].sensor[0]
    fed(stream, events[:170])
    fed(alone, events[:170])
    for invalid in (
        ([9000, 9001], [1, width], [1, 1], [1, 1]),
        ([9000, -1], [1, 1], [1, 1], [0, 1]),
        [1, 2, 3],
        "abc",
    ):
        with pytest.raises((ValueError, TypeError)):
            stream.push(invalid)
    for invalid in ((9000, width, 1, 1), (-1, 1, 1, 1), (9000, 1, 1, 2), (9000.5, 1, 1, 1)):
        with pytest.raises((ValueError, TypeError)):
            stream.push_one(*invalid)
    assert stream.look() == alone.look()
    assert fed(stream, events[170:]) == fed(alone, events[170:])
    assert stream.look() == alone.look()


@of_all
def test_reading_changes_nothing(make):
    read = make()
    unread = make()
    events = events_of(make)
    outputs = []
    for first in range(0, len(events), 9):
        outputs += fed(read, events[first : first + 9])
        assert read.look() == read.look()
    expected = fed(unread, events, (9,))
    assert outputs == expected and read.look() == unread.look()


@of_all
def test_every_event_is_counted_once(make):
    stream = make()
    events = events_of(make)
    fed(stream, events, (50,))
    counts = stream.look()[2]
    assert counts.received == len(events)
    if isinstance(stream, Volume) or "hop_us" not in make.args[-1]:  # else once in every window
        assert sum(dataclasses.astuple(counts)) == 2 * len(events)  # received, and kept or dropped
