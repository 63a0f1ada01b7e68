"""A model's weights are in memory once, however many processors there are.

A state may be kept without them.
"""

import copy
import pickle

import numpy as np
import pytest
from deciding import CONFIG, key, total_and_size
from made import random_events, random_model, random_regressor_model

from async_tnt import CompiledClassifier, Processor, load_model

EVENTS = random_events(400, seed=3, duration_us=5_000)
MODEL = random_model(CONFIG)


def weights_of(processor):
    return processor.classifier.network.weights


def test_processors_and_their_copies_share_one_read_only_array():
    first = Processor(MODEL)
    second = Processor(MODEL, every_us=300)
    loaded = pickle.loads(pickle.dumps([first, second]))
    for other in (second, copy.deepcopy(first), copy.copy(second)):
        assert weights_of(other) is weights_of(first)
    assert weights_of(loaded[0]) is weights_of(loaded[1])
    for processor in (first, *loaded):
        assert not weights_of(processor).flags.writeable
    classifier = CompiledClassifier(MODEL)
    assert classifier.network.weights is weights_of(first)
    assert copy.deepcopy(classifier).network.weights is weights_of(first)


def test_models_do_not_share():
    """Each has its own, also one with the same weights for another sensor."""
    model = load_model("digits-everywhere")
    larger = model.for_sensor((80, 60))
    assert weights_of(Processor(model)) is not weights_of(Processor(larger))
    np.testing.assert_array_equal(weights_of(Processor(model)), weights_of(Processor(larger)))


CASES = {
    "classes": (MODEL, {"every_us": 300}, {}),
    "overlap": (MODEL, {"hop_us": 250, "late": "drop"}, {}),
    "regressor": (
        random_regressor_model(CONFIG.replace(landmark="regressor")),
        {"every_events": 9},
        {},
    ),
    "objects": (load_model("digits-everywhere").for_sensor((60, 60)), {"every_us": 2_000}, {}),
    "a function": (CONFIG, {"confidence": 0.99}, {"classifier": total_and_size}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_saved_state_goes_on_with_the_model_given_again(name):
    model, settings, networks = CASES[name]
    processor = Processor(model, **settings, **networks)
    processor.push(EVENTS[:170])
    state = processor.save_state()
    resumed = Processor.from_state(state, model, **networks)
    for one in (processor, resumed):
        one.fire()
    expected = [key(d) for d in processor.push(EVENTS[170:]) + processor.finish()]
    assert [key(d) for d in resumed.push(EVENTS[170:]) + resumed.finish()] == expected != []
    assert resumed.counts == processor.counts and resumed.every_us == processor.every_us
    if hasattr(processor.classifier, "network"):
        assert weights_of(resumed) is weights_of(Processor(model))
        whole = len(pickle.dumps(processor))
        assert len(state) < whole - weights_of(processor).nbytes


def test_a_state_of_another_model_or_none_is_refused():
    state = Processor(MODEL).save_state()
    with pytest.raises(ValueError, match="`state` must be of the configuration TNTConfig"):
        Processor.from_state(state, random_model(CONFIG.replace(bins=5)))
    with pytest.raises(
        ValueError, match=r"`state` must be of the classes .*'class 2'\), got .*'class 3'"
    ):
        Processor.from_state(state, random_model(CONFIG, classes=3))
    for damaged in (b"", b"what", state[:-50], pickle.dumps([1, 2])):
        with pytest.raises(ValueError, match="`state` must be what `save_state`"):
            Processor.from_state(damaged, MODEL)
