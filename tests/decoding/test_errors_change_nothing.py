"""After an error everything is as before: the decoder, a volume, a processor, and what they say of later events."""

import re

import numpy as np
import pytest
from decoding.bad_events import BAD, GOOD, ONE, SENSOR
from made import random_events

from async_tnt import Processor, TNTConfig, TNTVolume
from async_tnt.events import EventDecoder

T, X, Y, P = GOOD.values()


def door_state(decoder):
    return decoder.newest_us, decoder.n_dropped


def volume_state(volume):
    state = volume.array.tobytes(), volume.counts, volume.landmark, volume.n_events, volume.start_us
    return *state, volume.newest_us, door_state(volume._decoder)


def processor_state(processor):
    decision = processor.fire()
    state = processor.volume().tobytes(), processor.counts, processor.landmark, door_state(processor._decoder)
    return *state, decision.logits.tobytes(), decision.events, decision.time_us, decision.window_start_us


def told(decisions):
    return [(d.logits.tobytes(), d.window_start_us, d.time_us, d.events, d.complete, d.trigger) for d in decisions]


@pytest.mark.parametrize("late", ["accept", "drop", "raise"])
def test_the_door_is_as_before(late):
    decoder = EventDecoder(SENSOR, late)
    decoder.decode((T, X, Y, P))
    before = door_state(decoder)
    for events, error, _ in BAD.values():
        with pytest.raises(error):
            decoder.decode(events)
        assert door_state(decoder) == before


@pytest.mark.parametrize("landmark", ["running", "line", "window"])
@pytest.mark.parametrize("late", ["accept", "drop", "raise"])
def test_volume_and_processor_are_as_before(late, landmark):
    config = TNTConfig(sensor=SENSOR, grid=(20, 16), bins=3, window_us=10_000, t_max=2.0, landmark=landmark)
    first, second = np.split(random_events(600, duration_us=25_000, sensor=SENSOR), 2)

    def new_processor():
        return Processor(config, classifier=lambda volume: volume.sum((1, 2)), hop_us=5_000, every_events=70, late=late)

    volume, volume_alone = TNTVolume(config, late=late), TNTVolume(config, late=late)
    processor, processor_alone = new_processor(), new_processor()
    assert volume.update(first) == volume_alone.update(first) == 1
    assert told(processor.push(first)) == told(processor_alone.push(first)) != []
    of_volume, of_processor = volume_state(volume), processor_state(processor)
    assert np.count_nonzero(volume.array) > 50

    for events, error, _ in BAD.values():
        with pytest.raises(error):
            volume.update(events)
        with pytest.raises(error):
            processor.push(events)
    assert volume_state(volume) == of_volume
    assert processor_state(processor) == of_processor

    assert volume.update(second) == volume_alone.update(second)
    assert told(processor.push(second)) == told(processor_alone.push(second)) != []
    assert told(processor.finish()) == told(processor_alone.finish())
    assert volume_state(volume) == volume_state(volume_alone)
    assert processor.counts == processor_alone.counts


def test_a_late_event_under_raise_leaves_everything_as_before():
    config = TNTConfig(sensor=SENSOR, grid=(20, 16), bins=3, window_us=10_000, t_max=2.0)
    events = random_events(300, duration_us=10_000, sensor=SENSOR)
    volume = TNTVolume(config, late="raise")
    processor = Processor(config, classifier=lambda volume: volume.sum((1, 2)), late="raise")
    volume.update(events)
    processor.push(events)
    of_volume, of_processor = volume_state(volume), processor_state(processor)
    wrong = events[-5:].copy()
    wrong["t"] = np.array([0, 5, 900_000, 899_999, 900_001]) + events["t"][-1]  # in a later window
    message = rf"^`t` must not run backwards .*got {wrong['t'][3]} after {wrong['t'][2]} at event 3; "
    with pytest.raises(ValueError, match=message):
        volume.update(wrong)
    with pytest.raises(ValueError, match=message):
        processor.push(wrong)
    assert volume_state(volume) == of_volume
    assert processor_state(processor) == of_processor


@pytest.mark.parametrize(("event", "error", "message"), ONE)
@pytest.mark.parametrize("fed", [False, True])
def test_one_event_at_a_time(event, error, message, fed):
    config = TNTConfig(sensor=SENSOR, grid=(20, 16), bins=3, window_us=10_000)
    volume, processor = TNTVolume(config), Processor(config, classifier=lambda volume: volume.sum((1, 2)))
    if fed:
        for t, x, y, p in zip(T, X, Y, P, strict=True):
            volume.update_one(t, x, y, p)
            processor.push_one(t, x, y, p)
        assert volume.n_events == 5
    before = volume_state(volume), processor_state(processor)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        volume.update_one(*event)
    with pytest.raises(error, match=f"^{re.escape(message)}$"):
        processor.push_one(*event)
    assert (volume_state(volume), processor_state(processor)) == before
    volume.update_one(14, 4, 4, 1)
    assert volume.n_events == (6 if fed else 1)
