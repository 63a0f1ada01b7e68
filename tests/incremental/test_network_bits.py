"""The compiled network against its twin in NumPy, bit for bit, and by hand."""

from fractions import Fraction

import numpy as np
import pytest
from incremental.cases import CASES, model_of
from incremental.float32 import fma, forward
from made import random_events

from async_tnt import CompiledClassifier, Model, TNTConfig, TNTVolume


def nearest_float32(exact: Fraction) -> np.float32:
    """By trial: the candidate that is closest, or, of two, the even one."""
    near = np.float32(float(exact))
    candidates = [np.nextafter(near, np.float32(-np.inf)), near, np.nextafter(near, np.float32(np.inf))]
    return min(candidates, key=lambda c: (abs(Fraction(float(c)) - exact), int(c.view(np.int32)) & 1))


def test_the_twins_fma_rounds_once():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 3000)).astype(np.float32)
    c = rng.normal(size=3000).astype(np.float32)
    c[1000:2000] = -(a * b)[1000:2000]  # cancels: what is left is the product's own rounding
    ulp = np.float32(2**-23)
    a[2000:2500], b[2000:2500], c[2000:2500] = 1 + ulp, 1 + ulp, np.float32(2**-60)  # just beside a tie
    a[2500:], b[2500:] = np.float32(2**-30), rng.normal(size=500)
    found = fma(a, b, c)
    expected = [
        nearest_float32(Fraction(float(x)) * Fraction(float(y)) + Fraction(float(z)))
        for x, y, z in zip(a, b, c, strict=True)
    ]
    assert found.tobytes() == np.array(expected).tobytes()
    assert (found != np.float32(np.float64(a * b) + c)).sum() > 500  # two roundings would not do


@pytest.mark.parametrize("case", [case for case in CASES if case.grid != (40, 30)], ids=str)
def test_logits_are_those_of_the_twin_bit_for_bit(case):
    model = model_of(case)
    network, volume = CompiledClassifier(model), case.volume()
    for packet in np.split(random_events(90, seed=1, duration_us=6000, sensor=case.config.sensor), 3):
        volume.update(packet)
        assert network.refresh(volume).tobytes() == forward(model.weights, volume.array).tobytes()
    assert volume.array.any()


@pytest.mark.parametrize("case", CASES[:7], ids=str)
def test_logits_of_dense_arrays_are_those_of_the_twin(case):
    """No channel is empty, or each second one."""
    model = model_of(case)
    array = np.random.default_rng(2).normal(size=case.config.shape).astype(np.float32)
    network = CompiledClassifier(model)
    assert network(array).tobytes() == forward(model.weights, array).tobytes()
    array[::2] = 0
    assert network(array).tobytes() == forward(model.weights, array).tobytes()


def small_network() -> Model:
    """8 x 8 pixels, one bin, all weights by hand: the first convolution is the identity and its negative, the second
    adds the one and four times the other, the dense layer weighs the four places by 1, 10, 100, 1000."""
    middle = np.zeros((2, 1, 3, 3))
    middle[:, 0, 1, 1] = 1, -1
    both = np.zeros((1, 2, 3, 3))
    both[0, :, 1, 1] = 1, 4
    weights = {
        "conv1.weight": middle,
        "conv1.bias": np.zeros(2),
        "conv2.weight": both,
        "conv2.bias": np.zeros(1),
        "fc1.weight": np.array([[1, 10, 100, 1000]]),
        "fc1.bias": np.array([0.5]),
        "fc2.weight": np.array([[2], [-1]]),
        "fc2.bias": np.array([0, 1]),
    }
    config = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=1, transform="none", window_us=1000)
    return Model(config, weights, ("a", "b"))


def test_one_small_network_by_hand_event_by_event():
    """Each ON event adds 1/16 to its quarter of the image, each OFF event 4/16; the hidden unit has a bias of 1/2."""
    model = small_network()
    network, volume = CompiledClassifier(model), TNTVolume(model.config)
    volume.open(0)
    assert network.refresh(volume).tolist() == [2 * 0.5, 1 - 0.5]
    hidden = 0.5
    for x, y, p, adds in [
        (0, 0, 1, 1 / 16),
        (3, 3, 1, 1 / 16),
        (4, 0, 1, 10 / 16),
        (0, 4, 1, 100 / 16),
        (7, 7, 1, 1000 / 16),
        (5, 6, 0, 4000 / 16),
        (2, 1, 0, 4 / 16),
        (0, 0, 1, 1 / 16),
    ]:
        volume.update_one(100, x, y, p)
        hidden += adds
        assert network.refresh(volume).tolist() == [2 * hidden, 1 - hidden]
    volume.update_one(100, 2, 1, 1)  # cancels the OFF event there
    assert network.refresh(volume).tolist() == [2 * (hidden - 0.25), 1 - (hidden - 0.25)]
    volume.open(0)
    assert network.refresh(volume).tolist() == [1.0, 0.5]


def test_a_tap_reaches_its_neighbour_only():
    """A convolution of the left neighbour: an event changes the cell on its right, across the pool's
    border, and falls off at the image's."""
    weights = {name: w.copy() for name, w in small_network().weights.items()}
    weights["conv1.weight"][0, 0] = [[0, 0, 0], [1, 0, 0], [0, 0, 0]]
    model = Model(small_network().config, weights, ("a", "b"))
    for x, place in ((0, 1), (3, 10), (4, 10), (7, 0)):
        network, volume = CompiledClassifier(model), TNTVolume(model.config)
        volume.open(0)
        network.refresh(volume)
        volume.update_one(100, x, 1, 1)
        assert network.refresh(volume)[0] == 2 * (0.5 + place / 16)
