"""The compiled network against the torch reference."""

import numpy as np
import pytest
import tnt_reference
import torch
from made import random_events, random_model
from numba import njit

from async_tnt import CompiledClassifier, TNTConfig, TNTVolume
from async_tnt.kernels import conv_rows as strip
from async_tnt.kernels import pair

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
    from async_tnt import Model

    network = CompiledClassifier(Model(config, weights, ("a", "b")))
    volume = np.arange(16, dtype=np.float32).reshape(1, 4, 4)
    assert network(volume).tolist() == [2 * (7.5 + 0.5), 1 - (7.5 + 0.5)]
    assert network(-volume).tolist() == [2 * 0.5, 1 - 0.5]  # ReLU


def test_convolution_taps_are_not_flipped():
    """One tap left of the middle: out[y, x] = in[y, x - 1], zero beyond the border."""
    from async_tnt.kernels.convolve import convolve, frame

    volume = np.arange(1, 13, dtype=np.float32).reshape(1, 3, 4)
    framed = np.zeros((1, 32 + 2 * 6 + 2), np.float32)
    frame(volume, framed)
    weights = np.zeros((1, 1, 9, 8), np.float32)
    weights[0, 0, 3, 0] = 1
    out = np.zeros((8, 32), np.float32)
    convolve(framed, weights, np.zeros((1, 8), np.float32), 4, out)
    assert out[0, :18].reshape(3, 6)[:, :4].tolist() == [[0, 1, 2, 3], [0, 5, 6, 7], [0, 9, 10, 11]]


def test_strip_in_registers_gives_the_bits_of_its_plain_spelling():
    rng = np.random.default_rng(5)
    n_channels, row, n_blocks, n_places = 3, 7, 2, 96
    plane = n_places + 2 * row + 2
    framed = rng.normal(size=n_channels * plane).astype(np.float32)
    weights = rng.normal(size=n_blocks * n_channels * 9 * 8).astype(np.float32)
    bias = rng.normal(size=n_blocks * 8).astype(np.float32)

    def outputs_of(spelling):
        @njit
        def convolve_all(out):
            for block in range(n_blocks):
                for start in range(0, n_places, 32):
                    spelling(framed, plane, row, n_channels, start, weights, bias, block, out, n_places)

        out = np.zeros(n_blocks * 8 * n_places, np.float32)
        convolve_all(out)
        return out

    plain = outputs_of(strip._convolve_strip_checked)
    assert plain.all() and plain.tobytes() == outputs_of(strip._convolve_strip_in_registers).tobytes()


def test_pair_gives_the_bits_of_its_plain_spelling():
    shares = np.random.default_rng(6).normal(size=(500, 3))

    def cells_of(spelling):
        @njit
        def add_all(cells):
            for i in range(len(shares)):
                spelling(cells, np.uint64(2 * (i % 5)), shares[i, 0], shares[i, 1], shares[i, 2])

        cells = np.zeros(10)
        add_all(cells)
        return cells

    plain = cells_of(pair._add_pair_checked)
    assert plain.all() and plain.tobytes() == cells_of(pair._add_pair_vectorized).tobytes()


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
