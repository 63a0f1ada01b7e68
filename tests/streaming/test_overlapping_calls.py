"""Two calls on one object at the same time, by mistake.

They give a RuntimeError, never a wrong result or a crash.
"""

import copy
import pickle
import threading

import numpy as np
import pytest
from deciding import CONFIG, at, key, total_and_size
from made import random_events, random_model, random_regressor_model
from waiting import PATIENCE_S, meanwhile

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    CompiledRegressor,
    Model,
    PixelFilter,
    Processor,
    TNTVolume,
)
from async_tnt.networks import OnnxClassifier, to_onnx

REFUSED = (
    r"^a {} was called while another call on it is running, in another thread or further up in "
    r"this one; use one"
)
MODEL = random_model(CONFIG)
EVENTS = random_events(40, seed=1, duration_us=2500)


class Held:
    """Events or a volume whose reading waits, so that a call stays in its middle until `go_on`."""

    def __init__(self, values):
        self.begun = threading.Event()
        self.go_on = threading.Event()
        self.values = values
        self.shape = np.shape(values)

    def numpy(self):  # packets of events are read by this
        self.begun.set()
        assert self.go_on.wait(PATIENCE_S)
        return self.values

    def __array__(self, dtype=None, copy=None):  # volumes are read by this
        return self.numpy()


def assert_refused_during(function, values, others, name):
    """Call `function` with values; while it reads them, the other calls must be refused.

    Returns its answer.
    """
    held = Held(values)
    answer = []
    with meanwhile(lambda: answer.append(function(held))):
        assert held.begun.wait(PATIENCE_S)
        try:
            for other in others:
                with pytest.raises(RuntimeError, match=REFUSED.format(name)):
                    other()
        finally:
            held.go_on.set()
    return answer[0]


CALLS = [
    lambda processor: processor.push(at([5, 6])),
    lambda processor: processor.push((5, 1, 1, 1)),
    lambda processor: processor.push_one(5, 1, 1, 1),
    Processor.fire,
    Processor.finish,
    Processor.reset,
    Processor.volume,
    copy.copy,
    copy.deepcopy,
    pickle.dumps,
    lambda processor: setattr(processor, "confidence", 0.5),
    lambda processor: setattr(processor, "classifier", total_and_size),
]


@pytest.mark.parametrize(
    "landmark, settings", [("running", {}), ("running", {"every_events": 2}), ("window", {})]
)
def test_calls_during_a_push_are_refused_and_change_nothing(landmark, settings):
    config = CONFIG.replace(landmark=landmark)
    processor = Processor(config, classifier=total_and_size, **settings)
    untroubled = Processor(config, classifier=total_and_size, **settings)
    others = [lambda call=call: call(processor) for call in CALLS]
    decided = assert_refused_during(processor.push, EVENTS, others, "Processor")
    expected = untroubled.push(EVENTS)
    assert [key(d) for d in decided] == [key(d) for d in expected] != []
    assert processor.counts == untroubled.counts
    assert [key(d) for d in processor.finish()] == [key(d) for d in untroubled.finish()]


@pytest.mark.parametrize("call", CALLS)
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


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    "begin",
    [lambda processor: processor.push(at([5])), lambda processor: processor.push_one(5, 1, 1, 1)],
    ids=["push", "push_one"],
)
def test_a_decision_that_an_event_makes_due_is_in_the_middle_of_its_call(begin, call):
    processor = Processor(CONFIG, classifier=lambda volume: call(processor), every_events=1)
    with pytest.raises(RuntimeError, match=REFUSED.format("Processor")):
        begin(processor)
    processor.classifier = total_and_size
    assert processor.fire().events == 1


PLAIN = CONFIG.replace(transform="none", landmark="center")


def model_of_a_map(classes=None):
    """It has raw outputs if there are no classes, otherwise it finds objects of one class."""
    layers = [{"op": "pick", "name": "map", "inputs": ["volume"], "channels": [0, 1]}]
    outputs = {} if classes else {"map": "map"}
    return Model(PLAIN, {}, classes or (), network={"classifier": layers}, outputs=outputs)


@pytest.mark.parametrize(
    "network",
    [
        CompiledClassifier(MODEL),
        CompiledClassifier(model_of_a_map(["a"])),
        CompiledNetwork(model_of_a_map()),
        CompiledRegressor(random_regressor_model()),
        OnnxClassifier(to_onnx(MODEL)),
    ],
    ids=lambda network: type(network).__name__,
)
def test_a_network_shared_by_two_threads_refuses_the_second_call(network):
    volume = np.ones(network.shape, np.float32)
    others = [lambda: network(volume)]
    if isinstance(network, (CompiledClassifier, CompiledNetwork)):
        others.append(lambda: network.refresh(TNTVolume(PLAIN)))
    if isinstance(network, CompiledClassifier):
        others.append(lambda: Processor(PLAIN, classifier=network, every_events=1).push(at([5, 6])))
    expected = network(volume)
    assert np.array_equal(
        assert_refused_during(network, volume, others, type(network).__name__), expected
    )
    assert np.array_equal(network(volume), expected)


def test_a_volume_and_a_filter_refuse_events_while_they_read_others():
    volume = TNTVolume(CONFIG)
    chosen = PixelFilter(CONFIG.sensor)
    others = [
        lambda: volume.update(EVENTS),
        lambda: volume.update_one(5000, 1, 1, 1),
        lambda: volume.open(0),
    ]
    others += [lambda: volume.array, lambda: copy.copy(volume)]
    assert_refused_during(volume.update, EVENTS, others, "TNTVolume")
    assert_refused_during(chosen, EVENTS, [lambda: chosen(EVENTS)], "PixelFilter")
    assert volume.counts.received == chosen.counts.received == 40
    # a window is open
    others = [lambda: volume.update_one(volume.start_us + 1, 1, 1, 1), volume.reset, volume.close]
    assert_refused_during(volume.update, EVENTS, others, "TNTVolume")
