"""Networks of ReLUs as spiking networks, whose spikes count what the ReLUs compute."""

import json

import numpy as np
import pytest
import torch
from torch import nn

from async_tnt import (
    CompiledClassifier,
    CompiledNetwork,
    Model,
    SpikingVolume,
    TNTConfig,
    TNTVolume,
)
from async_tnt.networks import spiking_from_rates, to_nir
from async_tnt.networks.models import rate_conversion

CONFIG = TNTConfig(sensor=(8, 8), grid=(8, 8), representation="count", polarity="split")
CLASSES = ("a", "b", "c", "d")


def conv(inputs, outputs, **how):
    return nn.Conv2d(inputs, outputs, 3, padding=1, bias=False, **how)


def dense(inputs, outputs):
    return nn.Linear(inputs, outputs, bias=False)


def sum_pool():
    return nn.AvgPool2d(2, divisor_override=1)


def events_of_class(index, rng, n=400):
    """Events mostly of one quadrant, and there mostly ON in two classes and OFF in the others."""
    t = np.sort(rng.integers(0, 100_000, n))
    x, y = rng.integers(0, 8, (2, n))
    is_noise = rng.random(n) < 0.4
    x = np.where(is_noise, x, x // 2 + 4 * (index % 2))
    y = np.where(is_noise, y, y // 2 + 4 * (index // 2))
    p = np.where(rng.random(n) < 0.3, rng.integers(0, 2, n), index in (0, 3))
    return t, x, y, p.astype(np.uint8)


def window_of(events):
    volume = TNTVolume(CONFIG)
    volume.open(0)
    volume.update(events)
    return np.asarray(volume.array, np.float32)


def spikes_of(model, events):
    volume = SpikingVolume(model)
    volume.open(0)
    volume.update(events)
    return volume


@pytest.fixture(scope="module")
def made():
    """Events of each class to train and to test with, and their classes."""
    rng = np.random.default_rng(0)
    labels = np.arange(160) % 4
    return [events_of_class(label, rng) for label in labels], labels


def trained(module, made):
    """A model that was trained with the first half of the events."""
    torch.manual_seed(0)
    for parameter in module.parameters():
        nn.init.kaiming_uniform_(parameter, nonlinearity="relu")
    events, labels = made
    windows = torch.tensor(np.stack([window_of(one) for one in events[:80]]))
    is_relu_last = isinstance(module, nn.Sequential) and isinstance(module[-1], nn.ReLU)
    logits_of = module[:-1] if is_relu_last else module  # a ReLU would keep logits at 0
    optimizer = torch.optim.Adam(module.parameters(), 3e-3)
    for _ in range(60):
        optimizer.zero_grad()
        loss = nn.functional.cross_entropy(logits_of(windows), torch.tensor(labels[:80]))
        loss.backward()
        optimizer.step()
    return Model.from_torch(module, CONFIG, CLASSES)


class Residual(nn.Module):
    """Two branches of different sizes are added; global pooling at the end."""

    def __init__(self):
        super().__init__()
        self.first = conv(2, 8)
        self.second = conv(8, 8)
        self.last = dense(8 * 4, 4)

    def forward(self, x):
        x = torch.relu(self.first(x))
        x = x + torch.relu(self.second(x))
        return self.last(nn.functional.avg_pool2d(x, 4).flatten(1))


MODULES = {
    "pools": lambda: nn.Sequential(
        conv(2, 8),
        nn.ReLU(),
        sum_pool(),
        conv(8, 8, groups=2),
        nn.ReLU(),
        nn.AvgPool2d(2),
        nn.Flatten(),
        dense(8 * 4, 16),
        nn.ReLU(),
        dense(16, 4),
    ),
    "dense": lambda: nn.Sequential(nn.Flatten(), dense(128, 32), nn.ReLU(), dense(32, 4)),
    "ReLU at the end": lambda: nn.Sequential(
        conv(2, 8), nn.ReLU(), sum_pool(), nn.Flatten(), dense(8 * 16, 4), nn.ReLU()
    ),
    "residual": Residual,
    "flattened ReLUs": lambda: nn.Sequential(
        conv(2, 8), sum_pool(), nn.Flatten(), nn.ReLU(), dense(8 * 16, 4)
    ),
    "global pooling": lambda: nn.Sequential(
        conv(2, 16, stride=2), nn.ReLU(), conv(16, 4), nn.AdaptiveAvgPool2d(1), nn.Flatten()
    ),
}


@pytest.mark.parametrize("name", MODULES)
def test_the_classes_are_mostly_the_same(made, name):
    """On events that neither training nor normalization has seen."""
    events, labels = made
    model = trained(MODULES[name](), made)
    spiking = spiking_from_rates(model, [window_of(one) for one in events[:80]])
    network = CompiledClassifier(model)
    theirs = np.array([network(window_of(one)).argmax() for one in events[80:]])
    ours = np.array([spikes_of(spiking, one).spike_counts().argmax() for one in events[80:]])
    assert len(set(theirs.tolist())) == 4
    assert (theirs == labels[80:]).mean() > 0.9
    assert (ours == theirs).mean() > 0.9


def positive_model(module, outputs=True):
    """A model of positive weights: no spike would have to be taken back."""
    torch.manual_seed(0)
    for parameter in module.parameters():
        nn.init.uniform_(parameter, 0.0, 1.0)
    return Model.from_torch(module, CONFIG, None if outputs else CLASSES)


def test_spikes_count_activations(made):
    """n = s a, less what the layers have not passed on: a threshold each, times the weights."""
    events = made[0]
    model = positive_model(
        nn.Sequential(conv(2, 3), nn.ReLU(), sum_pool(), nn.Flatten(), dense(48, 5), nn.ReLU())
    )
    windows = [window_of(one) for one in events[:20]]
    network = CompiledNetwork(model)
    activations = np.stack([network(window)[0].copy() for window in windows])
    errors = []
    for spikes in (10.0, 100.0, 1000.0):
        spiking = spiking_from_rates(model, windows, spikes=spikes, percentile=100)
        counts = np.stack([spikes_of(spiking, one).spike_counts() for one in events[:20]])
        found = counts * activations.max() / spikes
        assert (found <= activations * (1 + 1e-5)).all()
        errors.append(np.abs(found - activations).max() / activations.max())
        assert counts.max() == pytest.approx(spikes, rel=0.25)
    assert errors[2] < 0.01 and errors[1] < 0.1
    assert errors[2] < errors[1] < errors[0]


def test_thresholds_by_hand():
    """One pixel, weights 2 and 3, 6 ON events: activations 12 and 36; thresholds 12/4 and 3."""
    module = nn.Sequential(
        nn.Conv2d(2, 1, 1, bias=False), nn.ReLU(), nn.Conv2d(1, 1, 1, bias=False)
    )
    for layer, weight in ((module[0], [2.0, 0.0]), (module[2], [3.0])):
        layer.weight.data[:] = torch.tensor(weight).reshape(1, -1, 1, 1)
    model = Model.from_torch(module, CONFIG)
    events = (np.arange(6), np.full(6, 3), np.full(6, 5), np.ones(6, int))
    spiking = spiking_from_rates(model, [window_of(events)], spikes=4, percentile=100)
    layers = [layer for layer in spiking.network["spiking"] if layer["op"] == "if"]
    thresholds = [spiking.weights[layer["weights"]["v_threshold"]] for layer in layers]
    assert [layer["name"] for layer in layers] == ["1", "2.neurons"]
    assert thresholds[0].shape == (1, 8, 8) and (thresholds[0] == 3.0).all()
    assert (thresholds[1] == 3.0).all()
    volume = spikes_of(spiking, events)
    # 12 = 3 spikes of 3 and a membrane of 3, which is not above the threshold
    assert volume.membranes("1")[0, 5, 3] == 3.0 and volume.spikes("1") == 3
    assert volume.spike_counts()[0, 5, 3] == 2 and volume.membranes()[0, 5, 3] == 3.0


def test_batch_norms_become_part_of_weights(made):
    module = nn.Sequential(
        nn.Conv2d(2, 4, 3, bias=False), nn.BatchNorm2d(4), nn.ReLU(), nn.Flatten(), dense(144, 4)
    ).eval()
    torch.manual_seed(0)
    module[1].running_var.uniform_(0.5, 4.0)
    module[1].weight.data.uniform_(0.5, 2.0)
    model = Model.from_torch(module, CONFIG, CLASSES)
    assert any(layer["op"] == "batch_norm" for layer in model.network["classifier"])
    factor = (module[1].weight / (module[1].running_var + module[1].eps).sqrt()).detach()
    module[0].weight.data *= factor.reshape(-1, 1, 1, 1)
    plain = Model.from_torch(nn.Sequential(module[0], *module[2:]), CONFIG, CLASSES)
    windows = [window_of(one) for one in made[0][:10]]
    ours = spiking_from_rates(model, windows)
    theirs = spiking_from_rates(plain, windows)
    assert [layer["op"] for layer in ours.layers] == [layer["op"] for layer in theirs.layers]
    for one in made[0][:10]:
        np.testing.assert_allclose(
            spikes_of(ours, one).membranes(), spikes_of(theirs, one).membranes(), atol=1e-3
        )


def test_it_goes_out_as_a_nir_graph(made):
    events = made[0]
    model = trained(MODULES["pools"](), made)
    spiking = spiking_from_rates(model, [window_of(one) for one in events[:20]], record={"a": 1})
    assert spiking.record == {"a": 1} and spiking.config == CONFIG
    for order in ("off_first", "on_first"):
        graph = to_nir(spiking, polarity=order)
        assert json.loads(graph.metadata["classes"]) == list(CLASSES)
        again = Model.from_nir(graph, reset="subtract", classes=CLASSES, polarity=order)
        for one in events[:5]:
            np.testing.assert_array_equal(
                spikes_of(again, one).spike_counts(), spikes_of(spiking, one).spike_counts()
            )


def test_a_percentile_by_hand():
    """Activations 1 to 64, of which 50 % are up to 32.5."""
    module = nn.Sequential(nn.Conv2d(2, 1, 1, bias=False), nn.ReLU())
    module[0].weight.data[:] = 0.5
    window = np.stack([np.arange(1.0, 65.0).reshape(8, 8)] * 2).astype(np.float32)
    model = Model.from_torch(module, CONFIG)
    for percentile, threshold in ((50, 32.5), (100, 64.0)):
        spiking = spiking_from_rates(model, [window], spikes=1, percentile=percentile)
        assert (spiking.weights["1.v_threshold"] == threshold).all()


def last_threshold(window, *, percentile, weights=(0.5, 0.5)):
    """The threshold of one convolution whose logit is told by a window of equal channels."""
    module = nn.Sequential(nn.Conv2d(2, 1, 1, bias=False))
    module[0].weight.data[:] = torch.tensor(weights).reshape(1, 2, 1, 1)
    model = Model.from_torch(module, CONFIG)
    spiking = spiking_from_rates(model, [np.stack([window] * 2)], spikes=1, percentile=percentile)
    (name,) = (layer["name"] for layer in spiking.layers if layer["op"] == "if")
    return float(spiking.weights[f"{name}.v_threshold"].max())


def test_logits_below_zero_count_as_zero():
    """Half of them are -1 to -32, the others 1 to 32: 80 % are up to about 19."""
    window = np.arange(1.0, 33.0).reshape(4, 8).astype(np.float32)
    window = np.concatenate([-window, window])
    assert last_threshold(window, percentile=80) == pytest.approx(19.4, abs=0.01)
    # between the largest of those and 1 it is between 0 and 1
    assert last_threshold(window, percentile=50.4) == pytest.approx(0.752, abs=0.001)


def test_where_the_percentile_is_zero_the_largest_activation_stands_for_it():
    window = np.zeros((8, 8), np.float32)
    window[3, 4] = 7.0
    assert last_threshold(window, percentile=50) == 7.0


def test_evenly_spread_activations_of_a_large_layer_are_read(monkeypatch):
    """At most 21 of 64 are each fourth, from the first on."""
    monkeypatch.setattr(rate_conversion, "MOST_OF_A_WINDOW", 21)
    window = np.arange(1.0, 65.0).reshape(8, 8).astype(np.float32)
    assert last_threshold(window, percentile=100) == 61.0
    monkeypatch.setattr(rate_conversion, "MOST_OF_A_WINDOW", 32)
    assert last_threshold(window, percentile=100) == 63.0


@pytest.mark.parametrize(
    "layers", [[nn.ReLU(), conv(2, 3)], [nn.Flatten(), nn.ReLU(), dense(128, 3)]]
)
def test_a_relu_may_read_the_volume_itself(layers):
    """A count of 1 gives 4 spikes, by a threshold of 1/4."""
    model = positive_model(nn.Sequential(*layers))
    spiking = spiking_from_rates(model, ONE_WINDOW, spikes=4, percentile=100)
    first = next(layer for layer in spiking.layers if layer["op"] == "if")
    assert (spiking.weights[first["weights"]["v_threshold"]] == 0.25).all()


def test_names_that_a_network_has_already_are_no_obstacle():
    """They are names of layers and of weights that the conversion adds."""
    shape = {"kernel": [1, 1], "stride": [1, 1], "padding": [0] * 4, "dilation": [1, 1]}
    layers = []
    for name, source, weight in (
        ("one", "volume", "two.neurons_.r"),
        ("two.neurons", "one", "two.neurons_.v_threshold"),
        ("two", "two.neurons", "two"),
    ):
        layer = {"op": "conv", "name": name, "inputs": [source], **shape, "groups": 1}
        layers.append(layer | {"weights": {"weight": weight}})
    weights = {
        "two.neurons_.r": np.full((1, 2, 1, 1), 2.0),
        "two.neurons_.v_threshold": np.full((1, 1, 1, 1), 3.0),
        "two": np.full((1, 1, 1, 1), 5.0),
    }
    model = Model(CONFIG, weights, network={"classifier": layers}, outputs={"out": "two"})
    spiking = spiking_from_rates(model, ONE_WINDOW, spikes=1)
    assert [layer["name"] for layer in spiking.layers][-1] == "two.neurons_"
    for name, values in weights.items():
        np.testing.assert_array_equal(spiking.weights[name], values)
    # 2 x 2 x 3 x 5
    threshold = spiking.layers[-1]["weights"]["v_threshold"]
    assert (spiking.weights[threshold] == 60.0).all()


# -- what is refused -------------------------------------------------------------------------------

ONE_WINDOW = [np.ones((2, 8, 8), np.float32)]


def refused(module, message, error=NotImplementedError, **how):
    model = Model.from_torch(module.eval(), how.pop("config", CONFIG))
    with pytest.raises(error, match=message):
        spiking_from_rates(model, how.pop("windows", ONE_WINDOW), **how)


@pytest.mark.parametrize(
    "module, message",
    [
        (nn.Sequential(conv(2, 3), nn.ReLU(), nn.MaxPool2d(2)), r"layer '2' \(max_pool\): spikes"),
        (nn.Sequential(conv(2, 3), nn.Sigmoid()), r"layer '1' \(sigmoid\) has no spiking form"),
        (nn.Sequential(nn.BatchNorm2d(2), conv(2, 3)), r"'0' \(batch_norm\): it must be the only"),
    ],
)
def test_layers_without_a_form(module, message):
    refused(module, message)


def test_biases():
    module = nn.Sequential(nn.Conv2d(2, 3, 3), nn.ReLU())
    module[0].bias.data[:] = torch.tensor([0.0, -0.5, 0.25])
    refused(module, r"layer '0' \(conv\): its bias, .* must be 0, got up to 0.5", ValueError)
    norm = nn.Sequential(conv(2, 3), nn.BatchNorm2d(3))
    norm[1].running_mean[:] = 1.0
    refused(norm, r"layer '0' \(conv\): its bias, with that of a batch norm", ValueError)


def test_biases_of_zeros():
    module = nn.Sequential(nn.Conv2d(2, 3, 3), nn.ReLU())
    module[0].weight.data[:] = 1.0
    module[0].bias.data[:] = 0.0
    model = spiking_from_rates(Model.from_torch(module, CONFIG), ONE_WINDOW)
    assert "0.bias" not in model.weights


def test_arguments():
    module = nn.Sequential(conv(2, 3), nn.ReLU())
    module[0].weight.data[:] = 1.0
    refused(module, "`spikes` must be a positive number, got 0", ValueError, spikes=0)
    refused(module, r"`percentile` must be in \(0, 100\], got 101", ValueError, percentile=101)
    refused(module, "`windows` must have at least one window", ValueError, windows=[])
    zeros = [np.zeros((2, 8, 8), np.float32)]
    refused(module, "`windows` must make layer '1' larger than 0", ValueError, windows=zeros)
    refused(module, "`spikes` must be a positive number, got inf", ValueError, spikes=np.inf)
    refused(module, r"`percentile` must be in \(0, 100\], got 0", ValueError, percentile=0)
    with pytest.raises(TypeError, match="`model` must be a Model, got 3"):
        spiking_from_rates(3, [])
    spiking = spiking_from_rates(Model.from_torch(module, CONFIG), ONE_WINDOW)
    with pytest.raises(ValueError, match="`model` must be a network of ReLUs"):
        spiking_from_rates(spiking, ONE_WINDOW)


@pytest.mark.parametrize(
    "settings",
    [
        {"grid": (4, 4)},
        {"representation": "time_surface"},
        {"polarity": "signed"},
        {"transform": "tnt"},
        {"window_events": 100, "window_us": None},
    ],
)
def test_a_network_of_something_else_than_counts_at_pixels(settings):
    config = CONFIG.replace(**settings)
    module = nn.Sequential(conv(config.shape[0], 3), nn.ReLU())
    refused(module, "`model` must read counts of events", ValueError, config=config)


class Sum(nn.Module):
    """The sum of two convolutions of the volume."""

    def __init__(self):
        super().__init__()
        self.first = conv(2, 3)
        self.second = conv(2, 3)

    def forward(self, x):
        return self.first(x) + self.second(x)


def test_a_sum_of_equal_scales_needs_no_scaling():
    spiking = spiking_from_rates(positive_model(Sum()), ONE_WINDOW)
    assert [layer["op"] for layer in spiking.layers] == ["conv", "conv", "add", "if"]


class OfTwo(nn.Module):
    """Two raw outputs."""

    def __init__(self):
        super().__init__()
        self.first = conv(2, 3)

    def forward(self, x):
        x = self.first(x)
        return x, torch.relu(x)


def test_networks_of_several_outputs_or_of_objects():
    refused(OfTwo(), "`model` must have classes or one output, and no map", ValueError)
    objects = Model.from_torch(conv(2, len(CLASSES) + 1), CONFIG, CLASSES)
    with pytest.raises(ValueError, match="`model` must have classes or one output, and no map"):
        spiking_from_rates(objects, ONE_WINDOW)


def network_with_a_norm():
    """A convolution and a norm behind it, of which the norm doubles its numbers."""
    layers = [
        {
            "op": "conv",
            "name": "conv",
            "inputs": ["volume"],
            "kernel": [1, 1],
            "stride": [1, 1],
            "padding": [0] * 4,
            "dilation": [1, 1],
            "groups": 1,
            "weights": {"weight": "w"},
        },
        {
            "op": "batch_norm",
            "name": "norm",
            "inputs": ["conv"],
            "epsilon": 0.0,
            "weights": {"mean": "m", "variance": "v"},
        },
        {"op": "add", "name": "sum", "inputs": ["norm", "conv"]},
    ]
    weights = {"w": np.ones((1, 2, 1, 1)), "m": np.zeros(1), "v": np.full(1, 0.25)}
    return weights, layers


@pytest.mark.parametrize("n_layers, output", [(3, "sum"), (2, "conv")])
@pytest.mark.parametrize("use", [to_nir, lambda model: spiking_from_rates(model, ONE_WINDOW)])
def test_a_norm_becomes_no_part_of_a_layer_whose_numbers_another_reads(use, n_layers, output):
    """The other is a layer, or the caller."""
    weights, layers = network_with_a_norm()
    model = Model(
        CONFIG, weights, network={"classifier": layers[:n_layers]}, outputs={"out": output}
    )
    with pytest.raises(NotImplementedError, match=r"layer 'norm' \(batch_norm\): it must be the o"):
        use(model)
