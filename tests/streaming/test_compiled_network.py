"""The compiled network against the torch reference."""

import numpy as np
import pytest
import tnt_reference
import torch
from made import random_events, random_model

from async_tnt import CompiledClassifier, Model, TNTConfig, TNTVolume
from async_tnt.kernels.conv import PLACES, convolve, frame

CASES = [  # grid, bins, polarity, widths, classes
    ((34, 34), 9, "signed", (16, 32, 64), 10),
    ((34, 34), 9, "split", (16, 32, 64), 10),
    ((32, 48), 5, "signed", (8, 12, 20), 2),
    ((35, 33), 3, "unsigned", (5, 7, 3), 4),
    ((4, 4), 1, "signed", (1, 1, 1), 1),
    ((7, 5), 2, "signed", (3, 2, 9), 101),
]


@pytest.mark.parametrize("grid, bins, polarity, widths, classes", CASES)
def test_logits_equal_the_reference_network(grid, bins, polarity, widths, classes):
    config = TNTConfig(sensor=grid, grid=grid, bins=bins, polarity=polarity, t_max=2.0)
    model = random_model(config, classes=classes, widths=widths, seed=3)
    network = CompiledClassifier(model)
    reference = tnt_reference.Classifier(config.channels, grid, classes, widths)
    reference.load_state_dict({name: torch.tensor(w) for name, w in model.weights.items()})
    volume = TNTVolume(config)
    volume.open(0)
    for packet in np.split(random_events(1200, sensor=grid, seed=4), 4):
        volume.update(packet)
        with torch.inference_mode():
            expected = reference(torch.tensor(volume.array)).numpy()
        logits = network(volume.array)
        assert np.abs(logits - expected).max() <= 1e-4 * max(1.0, np.abs(expected).max())
        assert logits.argmax() == expected.argmax()
    assert (volume.array.any() and np.ptp(logits) > 0) or classes == 1


def test_one_filter_by_hand():
    """A network that is the identity where it can be: the mean of a 4x4 block, through two poolings."""
    config = TNTConfig(sensor=(4, 4), grid=(4, 4), bins=1)
    weights = {
        "conv1.weight": np.zeros((1, 1, 3, 3)),
        "conv1.bias": np.zeros(1),
        "conv2.weight": np.zeros((1, 1, 3, 3)),
        "conv2.bias": np.zeros(1),
        "fc1.weight": np.ones((1, 1)),
        "fc1.bias": np.array([0.5]),
        "fc2.weight": np.array([[2.0], [-1.0]]),
        "fc2.bias": np.array([0.0, 1.0]),
    }
    weights["conv1.weight"][0, 0, 1, 1] = weights["conv2.weight"][0, 0, 1, 1] = 1
    network = CompiledClassifier(Model(config, weights, ("a", "b")))
    volume = np.arange(16, dtype=np.float32).reshape(1, 4, 4)
    assert network(volume).tolist() == [2 * (7.5 + 0.5), 1 - (7.5 + 0.5)]
    assert network(-volume).tolist() == [2 * 0.5, 1 - 0.5]  # ReLU


def test_convolution_taps_are_not_flipped():
    """One tap left of the middle: out[y, x] = in[y, x - 1], zero beyond the border."""
    volume = np.arange(1, 13, dtype=np.float32).reshape(1, 3, 4)
    framed = np.zeros((1, PLACES + 2 * 6 + 2), np.float32)
    frame(volume, framed)
    weights = np.zeros((1, 1, 9, 8), np.float32)
    weights[0, 0, 3, 0] = 1
    out = np.zeros((8, PLACES), np.float32)
    convolve(framed, weights, np.zeros((1, 8), np.float32), 4, out)
    assert out[0, :18].reshape(3, 6)[:, :4].tolist() == [[0, 1, 2, 3], [0, 5, 6, 7], [0, 9, 10, 11]]


def test_any_float_array_of_the_right_shape_will_do():
    model = random_model()
    network = CompiledClassifier(model)
    volume = np.random.default_rng(0).normal(size=(9, 34, 34)).astype(np.float32)
    expected = network(volume)
    assert np.array_equal(network(volume.astype(np.float64)), expected)
    assert np.array_equal(network(np.asfortranarray(volume)), expected)
    assert np.array_equal(network(volume), expected)


def test_wrong_shape():
    with pytest.raises(ValueError, match=r"`volume` must have shape \(9, 34, 34\), got \(9, 34, 33\)"):
        CompiledClassifier(random_model())(np.zeros((9, 34, 33), np.float32))
