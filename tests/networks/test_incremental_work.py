"""What is computed after a change: the places that it reaches, counted, not timed."""

from dataclasses import replace

import pytest
from made import random_events
from networks.cases import NETWORKS

from async_tnt import CompiledClassifier
from experiments.speed.work import work_of

RAW = NETWORKS[8]


def test_one_event_in_the_thesis_network():
    """One event changes 2 x 2 pixels, and so a few places of each layer.

    The pixels are seen by 4 x 4 places of the first convolution. After pooling, these are 2 or
    3 places a side. They are seen by 4 or 5 places of the second convolution, and after pooling
    by 2 or 3 again.
    """
    network = RAW.classifier()
    volume = RAW.volume(RAW.config.replace(transform="tnt", landmark="center"))
    volume.open(0)
    network.refresh(volume)
    most = dict.fromkeys(step.layer for step, _ in work_of(network))
    for event in random_events(400, seed=1, duration_us=3900).tolist():
        volume.update_one(*event)
        network.refresh(volume)
        for step, n in work_of(network):
            most[step.layer] = max(most[step.layer] or 0, n)
    assert most == {"conv1": 16, "pool1": 9, "conv2": 25, "pool2": 9, "fc1": 9, "fc2": 1}


@pytest.mark.parametrize("network", NETWORKS[:8], ids=str)
def test_nothing_new_is_nothing_computed_and_an_array_everything(network):
    classifier = network.classifier()
    volume = network.volume()
    volume.update(random_events(50, seed=2, duration_us=3000, sensor=network.config.sensor))
    first = classifier.refresh(volume).tobytes()
    assert classifier.refresh(volume).tobytes() == first
    assert not any(n for _, n in work_of(classifier))
    assert classifier(volume.array).tobytes() == first
    assert all(n == step.places for step, n in work_of(classifier))


@pytest.mark.parametrize("network", NETWORKS[:8], ids=str)
def test_a_new_window_computes_what_its_own_events_reach(network):
    """Whatever the windows before it have changed, and whatever else the network has computed."""
    used = network.classifier()
    new = network.classifier()
    volume = network.volume()
    for n in (200, 1, 50):
        volume.update(random_events(n, seed=n, duration_us=900, sensor=network.config.sensor))
        used.refresh(volume)
        volume.reset()
        event = random_events(1, seed=n + 1, sensor=network.config.sensor)
        volume.update(event)
        assert used.refresh(volume).tobytes() == new.refresh(volume).tobytes()
        assert work_of(used) == work_of(new)
        used(volume.array)
        new = network.classifier()
        volume = network.volume()


def test_a_change_that_no_filter_sees_ends_there():
    """An event on a whole pixel, seen by 3 x 3 places of a convolution whose weights are zero."""
    model = RAW.model()
    model = replace(
        model, weights={**model.weights, "conv1.weight": 0 * model.weights["conv1.weight"]}
    )
    network = CompiledClassifier(model)
    volume = RAW.volume()
    volume.open(0)
    network.refresh(volume)
    volume.update_one(100, 5, 5, 1)
    network.refresh(volume)
    assert [n for _, n in work_of(network)] == [9, 0, 0, 0, 0, 0, 0, 0]
