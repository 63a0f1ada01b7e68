"""What the compiled classifier computes.

It equals its twin in NumPy bit for bit, and numbers that were computed by hand. A volume's logits
are finite, or it is refused.
"""

from importlib import import_module
from pkgutil import walk_packages

import numpy as np
import pytest
import torch
from made import events_of, random_events, random_model, thesis_model
from networks.cases import NETWORKS
from numba.core.registry import CPUDispatcher
from oracles import forward
from torch import nn

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    Model,
    Processor,
    TNTConfig,
    TNTVolume,
    kernels,
)
from async_tnt.kernels.decisions import classify
from async_tnt.kernels.entry_points import ENTRY_POINTS
from async_tnt.kernels.network import program as P
from async_tnt.kernels.network.forward import LONGEST_PAUSE
from async_tnt.networks.layers.graph import CLASSIFIER
from async_tnt.networks.layers.program import make_program


def test_no_kernel_may_reorder_arithmetic():
    """The bits stay the same, however a stream is cut.

    For this, sums keep their order, and 1 / 0 is inf as in the equations.
    """
    compiled = []
    for module in walk_packages(kernels.__path__, f"{kernels.__name__}."):
        values = vars(import_module(module.name)).values()
        compiled += [kernel for kernel in values if isinstance(kernel, CPUDispatcher)]
    compiled += [entry.kernel for entry in ENTRY_POINTS]
    assert len(compiled) > 60
    for kernel in compiled:
        assert not kernel.targetoptions.get("fastmath")
        assert kernel.targetoptions["error_model"] == "numpy"
    # other threads run while a packet is decided
    assert classify.absorb_and_decide.kernel.targetoptions["nogil"]


@pytest.mark.parametrize("network", [network for network in NETWORKS if network.widths], ids=str)
def test_logits_are_those_of_the_twin_bit_for_bit(network):
    """The volumes are of events, with many empty channels, and arrays with few or none."""
    model = network.model()
    classifier = network.classifier()
    volume = network.volume()
    events = random_events(90, seed=1, duration_us=6000, sensor=network.config.sensor)
    for packet in np.split(events, 3):
        volume.update(packet)
        expected = forward(model.weights, volume.array).tobytes()
        assert classifier.refresh(volume).tobytes() == expected
    assert volume.array.any()
    if network in NETWORKS[:7]:
        array = np.random.default_rng(2).normal(size=network.config.shape).astype(np.float32)
        assert classifier(array).tobytes() == forward(model.weights, array).tobytes()
        array[::2] = 0
        assert classifier(array).tobytes() == forward(model.weights, array).tobytes()


CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), bins=1, window_us=1000, transform="none")


def by_hand() -> Model:
    """A network of 8 x 8 pixels and one bin, with simple weights.

    The first convolution is the middle tap and its negative. The second one adds the first map
    and four times the other map. The dense layer weighs the four places by 1, 10, 100, 1000.
    """
    weights = {
        name: np.zeros_like(w)
        for name, w in random_model(CONFIG, classes=2, widths=(2, 1, 1)).weights.items()
    }
    weights["conv1.weight"][:, 0, 1, 1] = 1, -1
    weights["conv2.weight"][0, :, 1, 1] = 1, 4
    weights["fc1.weight"][:] = 1, 10, 100, 1000
    weights["fc1.bias"][:] = 0.5
    weights["fc2.weight"][:, 0] = 2, -1
    weights["fc2.bias"][:] = 0, 1
    return thesis_model(CONFIG, weights, ("a", "b"))


def test_one_small_network_event_by_event():
    """Each ON event adds 1/16 to its quarter of the image, each OFF event 4/16.

    The hidden unit has a bias of 1/2.
    """
    classifier = CompiledClassifier(by_hand())
    volume = TNTVolume(CONFIG)
    hidden = 0.5
    volume.open(0)
    assert classifier.refresh(volume).tolist() == [2 * 0.5, 1 - 0.5]
    for x, y, p, sixteenths in [
        (0, 0, 1, 1),
        (4, 0, 1, 10),
        (0, 4, 1, 100),
        (7, 7, 1, 1000),
        (5, 6, 0, 4000),
        (2, 1, 0, 4),
        (2, 1, 1, -4),  # cancels the one before
    ]:
        volume.update_one(100, x, y, p)
        hidden += sixteenths / 16
        assert classifier.refresh(volume).tolist() == [2 * hidden, 1 - hidden]
    volume.open(0)
    assert classifier.refresh(volume).tolist() == [1.0, 0.5]


@pytest.mark.parametrize("source", ["array", "window"])
def test_logits_that_were_answered_are_not_changed_by_the_next_call(source):
    classifier = CompiledClassifier(by_hand())
    empty, full = TNTVolume(CONFIG), TNTVolume(CONFIG)
    full.update_one(1, 5, 5, 1)

    def answer(volume):
        return classifier(volume.array) if source == "array" else classifier.refresh(volume)

    first = answer(empty)
    assert answer(full).tolist() != [1.0, 0.5]
    assert first.tolist() == [1.0, 0.5]
    first[:] = 7  # it is the caller's
    assert answer(empty).tolist() == [1.0, 0.5]


def test_a_volume_of_another_shape_is_refused():
    classifier = CompiledClassifier(by_hand())
    other = TNTVolume(CONFIG.replace(bins=2))
    message = r"^`volume` must have shape \(1, 8, 8\), got \(2, 8, 8\)$"
    with pytest.raises(ValueError, match=message):
        classifier.refresh(other)
    with pytest.raises(ValueError, match=message):
        classifier(other.array)


def test_joined_channels_that_become_blocks_follow_every_event():
    """Each of the two joined maps changes with events of its own sign alone."""
    config = CONFIG.replace(polarity="split")
    net = nn.Sequential(Joined(), nn.PixelShuffle(2), nn.Conv2d(1, 2, 2, stride=2), nn.Flatten())
    net.append(nn.Linear(2 * 8 * 8, 3))
    model = Model.from_torch(net, config, ["a", "b", "c"])
    classifier = CompiledClassifier(model)
    volume = TNTVolume(config)
    seen = set()
    for t, (x, y, p) in enumerate([(0, 0, 1), (7, 7, 0), (3, 2, 0), (3, 2, 1), (6, 1, 1)]):
        volume.update_one(t, x, y, p)
        logits = classifier.refresh(volume)
        assert logits.tobytes() == CompiledClassifier(model)(volume.array).tobytes()
        seen.add(logits.tobytes())
    assert len(seen) == 5


class Joined(nn.Module):
    """Two channels of ON events, then two of OFF events."""

    def __init__(self):
        super().__init__()
        self.on = nn.Conv2d(2, 2, 1)
        self.off = nn.Conv2d(2, 2, 1)
        with torch.no_grad():
            self.on.weight[:, 1] = 0
            self.off.weight[:, 0] = 0

    def forward(self, volume):
        return torch.cat([self.on(volume), self.off(volume)], 1)


def test_probabilities_of_logits_beyond_the_range_of_exp():
    weights = dict(by_hand().weights)
    weights["fc1.weight"] = np.zeros((1, 4))
    for biases, expected in (
        ([2000, 1999], 1 / (1 + np.exp(-1))),
        ([-2000, -1999], 1 / (1 + np.exp(1))),
    ):
        model = thesis_model(
            CONFIG,
            weights | {"fc2.weight": np.zeros((2, 1)), "fc2.bias": np.array(biases)},
            ("a", "b"),
        )
        for classifier in (None, lambda volume, biases=biases: biases):
            decision = Processor(model, classifier=classifier).fire()
            assert decision.probabilities.tolist() == pytest.approx(
                [expected, 1 - expected], rel=1e-12
            )


# -- weights so large that logits overflow: an error on every path, and the stream goes on ---------

FINITE = "^`classifier` must return finite logits, got"
LOUD = 7, 7  # an event here overflows; elsewhere events hardly count


def overflowing(**settings) -> list[Processor]:
    """An event at the lower right makes a logit infinite; on both paths."""
    weights = dict(by_hand().weights)
    weights["fc1.weight"] = np.array([[0.001, 0, 0, 3e38]])
    weights["fc2.weight"] = np.array([[20], [-1]])
    model = thesis_model(CONFIG, weights, ("a", "b"))
    general = Processor(
        CONFIG, classifier=CompiledClassifier(model).__call__, classes=["a", "b"], **settings
    )
    return [Processor(model, **settings), general]


@pytest.mark.parametrize(
    # `late="drop"` has seen all times of a packet, also of one that is absorbed in part
    "settings, size",
    [
        ({"every_events": 1}, 1500),
        ({"confidence": 1.0}, 7),
        ({"every_events": 1, "late": "drop"}, 1),
    ],
)
def test_a_packet_is_absorbed_up_to_the_error_and_the_stream_goes_on(settings, size):
    """Its later events are not: pushed again, the stream continues there.

    After the next event, which cancels it, the stream is as without both.
    """
    loud = [4, 9, 700, 1303]
    k = np.arange(1500)
    events = events_of(100 + k, k % 3, (k + 1) % 3, [1] * 1500)  # quiet ones, at the upper left
    for at in loud:
        events["x"][at : at + 2], events["y"][at : at + 2] = LOUD
        events["p"][at : at + 2] = 1, 0
    found = []
    for processor in overflowing(**settings):
        first = 0
        errors = []
        messages = []
        decisions = []
        while first < len(events):
            last = min(first + size, len(events))
            try:
                decisions += processor.push(events[first:last])
                first = last
            except ValueError as error:
                messages.append(str(error))
                first = processor.counts.received
                errors.append(first - 1)
                # The same event must not fail again and again.
                assert len(errors) <= len(loud)
        decisions += processor.finish()
        assert errors == loud and processor.counts.received == 1500
        assert all(message.startswith(FINITE[1:]) for message in messages)
        last = decisions[-1]
        found.append((processor.counts, last.logits.tobytes(), last.events, messages))
    assert found[0] == found[1]


@pytest.mark.parametrize("weight", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("name", ["conv1.weight", "conv2.weight", "fc1.weight", "fc2.weight"])
def test_a_weight_that_is_not_finite_makes_nan_of_0(name, weight):
    """A model refuses such a weight, but a batch norm that becomes part of it may overflow."""
    model = by_hand()
    volume = np.zeros(model.config.shape, np.float32)
    biased = {layer: np.zeros_like(w) for layer, w in model.weights.items()}
    for is_finite in (True, False):
        weights = {layer: w.copy() for layer, w in biased.items()}
        if not is_finite:
            weights[name].flat[0] = weight
        program = make_program(model.network[CLASSIFIER], model.config.shape, weights)
        assert np.isfinite(program.run(volume)[0]) == is_finite


@pytest.mark.parametrize("bias", [-0.0, 0.0])
@pytest.mark.parametrize("scale", [1.0, 1e-38, 1e-45])
def test_no_zero_of_a_sum_is_negative(bias, scale):
    """Products of 0 and of denormals with negative weights are -0; so are the biases."""
    model = random_model(CONFIG, classes=2, widths=(3, 4, 5), seed=3)
    weights = {
        name: np.full_like(w, bias) if name.endswith("bias") else -np.abs(w) * np.float32(scale)
        for name, w in model.weights.items()
    }
    model = thesis_model(CONFIG, weights, ("a", "b"))
    classifier = CompiledClassifier(model)
    volume = TNTVolume(CONFIG)
    volume.open(0)
    for t, (x, y, p) in enumerate([(0, 0, 0), (7, 7, 1), (3, 2, 0), (3, 2, 1), (6, 1, 0)]):
        logits = classifier.refresh(volume)
        assert logits.tobytes() == CompiledClassifier(model)(volume.array).tobytes()
        with_negative_zeros = np.where(volume.array == 0, np.float32(-0.0), volume.array)
        assert logits.tobytes() == CompiledClassifier(model)(with_negative_zeros).tobytes()
        assert logits.tobytes() == forward(model.weights, volume.array).tobytes()
        assert not np.signbit(logits[logits == 0]).any()
        volume.update_one(t, x, y, p)


def test_no_zero_of_the_input_is_negative():
    """A network that copies its input shows that."""
    layers = [{"op": "pick", "name": "copy", "inputs": ["volume"], "channels": [0]}]
    model = Model(CONFIG, {}, network={"classifier": layers}, outputs={"out": "copy"})
    network = CompiledNetwork(model)
    (copied,) = network(np.full(CONFIG.shape, -0.0, np.float32))
    assert not copied.any() and not np.signbit(copied).any()


def test_a_map_may_be_sparse_here_and_dense_there():
    """Looking for zeros pauses where there are few, and whether it does changes no bit."""
    config = CONFIG.replace(sensor=(40, 40), grid=(40, 40))
    net = nn.Sequential(nn.Conv2d(1, 9, 3, padding=1), nn.ReLU(), nn.Conv2d(9, 70, 3, padding=1))
    net.append(nn.Flatten()).append(nn.Linear(70 * 40 * 40, 2))
    model = Model.from_torch(net, config, ["a", "b"])
    rng = np.random.default_rng(5)
    array = rng.normal(size=config.shape).astype(np.float32)
    array[:, :, :25] = 0.0
    array[:, 20:] *= -1.0
    used = CompiledClassifier(model)
    pauses = set()
    for shown in (array, rng.normal(size=config.shape).astype(np.float32), 0 * array, array):
        assert used(shown).tobytes() == CompiledClassifier(model)(shown).tobytes()
        at = np.arange(len(used.steps)) * P.STEP_SIZE + P.FIRST_STEP
        pauses |= set(used.network.program[at + P.PAUSE].tolist())
    assert 0 in pauses
    assert max(pauses) == LONGEST_PAUSE
