"""Two calls on one object at the same time, by mistake: a RuntimeError, never a wrong result or a crash."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_events, random_model, random_regressor_model
from waiting import PATIENCE_S, meanwhile

from async_tnt import CompiledClassifier, CompiledRegressor, PixelFilter, Processor, TNTVolume
from async_tnt.networks import OnnxClassifier, to_onnx

REFUSED = r"^a {} was called while another call on it is running, in another thread or further up in this one; use one"
MODEL = random_model(CONFIG)


class Held:
    """A call that waits in the middle, and events or a volume whose reading is such a middle."""

    def __init__(self, values=None):
        self.begun, self.go_on, self.values = threading.Event(), threading.Event(), values

    def wait(self):
        self.begun.set()
        assert self.go_on.wait(PATIENCE_S)

    def numpy(self):  # of events
        self.wait()
        return self.values

    def __array__(self, dtype=None, copy=None):  # of a volume
        return self.numpy()

    shape = property(lambda self: self.values.shape)

    @contextmanager
    def during(self, function, *args):
        """The block runs while the function waits; the list yielded holds its answer afterwards."""
        answer = []
        with meanwhile(lambda: answer.append(function(*args))):
            assert self.begun.wait(PATIENCE_S)
            try:
                yield answer
            finally:
                self.go_on.set()


def set_to(name, value):
    return lambda processor: setattr(processor, name, value)


CALLS = {
    "push": lambda processor: processor.push(at([5, 6])),
    "push a tuple": lambda processor: processor.push((5, 1, 1, 1)),
    "push_one": lambda processor: processor.push_one(5, 1, 1, 1),
    "fire": Processor.fire,
    "finish": Processor.finish,
    "reset": Processor.reset,
    "volume": Processor.volume,
    "confidence": set_to("confidence", 0.5),
    "classifier": set_to("classifier", total_and_size),
}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
@pytest.mark.parametrize("landmark, settings", [("running", {}), ("running", {"every_events": 2}), ("window", {})])
def test_a_call_during_a_push_is_refused_and_changes_nothing(call, landmark, settings):
    config, held = CONFIG.replace(landmark=landmark), Held()

    def classifier(volume):
        held.wait()
        return total_and_size(volume)

    events = random_events(40, seed=1, duration_us=2500)
    untroubled = Processor(config, classifier=total_and_size, **settings)
    processor = Processor(config, classifier=classifier, **settings)
    with held.during(processor.push, events) as decided, pytest.raises(RuntimeError, match=REFUSED.format("Processor")):
        call(processor)
    expected = untroubled.push(events)
    assert [key(d) for d in decided[0]] == [key(d) for d in expected] != []
    assert processor.counts == untroubled.counts
    assert [key(d) for d in processor.finish()] == [key(d) for d in untroubled.finish()]


@pytest.mark.parametrize("call", [Processor.fire, CALLS["push"]])
def test_a_classifier_that_calls_its_own_processor_is_refused(call):
    """Reading numbers is fine. Once the error has passed, the processor is free."""
    seen = []

    def classifier(volume):
        seen.append((processor.landmark, processor.counts.received, processor.classes))
        call(processor)

    processor = Processor(CONFIG, classifier=classifier)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=REFUSED.format("Processor")):
            processor.fire()
    processor.classifier = total_and_size
    assert processor.push_one(5, 1, 1, 1) == [] and processor.fire().events == 1 and len(seen) == 2


@pytest.mark.parametrize(
    "network, names",
    [
        (CompiledClassifier(MODEL), ["refresh", "__call__", "push"]),
        (CompiledRegressor(random_regressor_model()), ["__call__"]),
        (OnnxClassifier(to_onnx(MODEL)), ["__call__"]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_network_shared_by_two_threads_refuses_the_second_call(network, names):
    held = Held(np.ones(network.shape, np.float32))
    volume = TNTVolume(CONFIG)
    calls = {
        "refresh": lambda: network.refresh(volume),
        "__call__": lambda: network(held.values),
        "push": lambda: Processor(CONFIG, classifier=network, every_events=1).push(at([5, 6])),
    }
    expected = network(held.values)
    with held.during(network, held) as answer:
        for name in names:
            with pytest.raises(RuntimeError, match=REFUSED.format(type(network).__name__)):
                calls[name]()
    assert np.array_equal(answer[0], expected) and np.array_equal(network(held.values), expected)


def test_a_volume_and_a_filter_refuse_events_while_they_read_others():
    events = random_events(40, seed=1, duration_us=2500)
    volume, chosen = TNTVolume(CONFIG), PixelFilter(CONFIG.sensor)
    for name, update, others in (
        ("TNTVolume", volume.update, [lambda: volume.update(events), lambda: volume.update_one(5000, 1, 1, 1)]),
        ("PixelFilter", chosen, [lambda: chosen(events)]),
    ):
        held = Held(events)
        with held.during(update, held):
            for other in others:
                with pytest.raises(RuntimeError, match=REFUSED.format(name)):
                    other()
    assert volume.counts.received == chosen.counts.received == 40
