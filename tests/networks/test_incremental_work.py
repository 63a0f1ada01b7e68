"""What is computed after a change: the places that it reaches, counted, not timed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made import random_events
from networks.cases import NETWORKS
from networks.random_networks import CONFIG, random_models

from async_tnt import CompiledClassifier, TNTVolume
from async_tnt.networks.graph import VOLUME

RAW = NETWORKS[8]


def reached(before: np.ndarray, after: np.ndarray, layer) -> int:
    """How many places of a convolution or pooling see a place that differs; maps (H, W, C)."""
    top, left, bottom, right = layer["padding"]
    differs = np.pad((before != after).any(axis=2), ((top, bottom), (left, right)))
    (kernel_y, kernel_x), (stride_y, stride_x) = layer["kernel"], layer["stride"]
    dilation_y, dilation_x = layer.get("dilation", (1, 1))
    rows = (differs.shape[0] - (kernel_y - 1) * dilation_y - 1) // stride_y + 1
    columns = (differs.shape[1] - (kernel_x - 1) * dilation_x - 1) // stride_x + 1
    seen = np.zeros((rows, columns), bool)
    for i, j in np.ndindex(kernel_y, kernel_x):
        y, x = i * dilation_y, j * dilation_x
        seen |= differs[y : y + stride_y * rows : stride_y, x : x + stride_x * columns : stride_x][:rows, :columns]
    return int(seen.sum())


@given(random_models(), st.integers(0, 1000), st.sampled_from([1, 2, 5, 30]))
def test_the_first_layer_computes_what_the_changed_cells_reach(model, seed, n):
    """At most 1.5 times that: where three quarters of the places have changed, all are computed."""
    first = model.layers["classifier"][0]
    if "kernel" not in first or first["inputs"] != [VOLUME]:
        return
    network, volume = CompiledClassifier(model), TNTVolume(model.config)
    if network.work[0][0].layer != first["name"]:
        return  # no layer reads it
    events = random_events(40 + n, seed=seed, duration_us=900, sensor=CONFIG.sensor)
    volume.open(0)
    volume.update(events[:40])
    network.refresh(volume)
    before = volume.array.copy()
    volume.update(events[40:])
    network.refresh(volume)
    computed = [n for step, n in network.work if step.layer == first["name"]][-1]
    n_reached = reached(before.transpose(1, 2, 0), volume.array.transpose(1, 2, 0), first)
    assert computed <= 1.5 * n_reached


def test_one_event_in_the_thesis_network():
    """It changes 2 x 2 pixels, seen by 4 x 4 places of the first convolution; pooled, these are 2 or 3 places a side;
    seen by 4 or 5 places of the second convolution; pooled, by 2 or 3 again."""
    network, volume = RAW.classifier(), RAW.volume(RAW.config.replace(transform="tnt", landmark="center"))
    volume.open(0)
    network.refresh(volume)
    most = dict.fromkeys(step.layer for step, _ in network.work)
    for event in random_events(400, seed=1, duration_us=3900).tolist():
        volume.update_one(*event)
        network.refresh(volume)
        for step, n in network.work:
            most[step.layer] = max(most[step.layer] or 0, n)
    assert most == {"conv1": 16, "pool1": 9, "conv2": 25, "pool2": 9, "fc1": 9, "fc2": 1}


@pytest.mark.parametrize("network", NETWORKS[:8], ids=str)
def test_nothing_new_is_nothing_computed_and_an_array_everything(network):
    classifier, volume = network.classifier(), network.volume()
    volume.update(random_events(50, seed=2, duration_us=3000, sensor=network.config.sensor))
    first = classifier.refresh(volume).tobytes()
    assert all(n == step.places for step, n in classifier.work)
    assert classifier.refresh(volume).tobytes() == first
    assert not any(n for _, n in classifier.work)
    assert classifier(volume.array).tobytes() == first
    assert all(n == step.places for step, n in classifier.work)


def test_a_change_that_no_filter_sees_ends_there():
    """An event on a whole pixel, seen by 3 x 3 places of a convolution whose weights are zero."""
    model = RAW.model()
    model = replace(model, weights={**model.weights, "conv1.weight": 0 * model.weights["conv1.weight"]})
    network, volume = CompiledClassifier(model), RAW.volume()
    volume.open(0)
    network.refresh(volume)
    volume.update_one(100, 5, 5, 1)
    network.refresh(volume)
    assert [n for _, n in network.work] == [9, 0, 0, 0, 0, 0, 0, 0]
