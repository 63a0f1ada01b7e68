"""Networks of ReLUs as NIR graphs, computed by torch, and read again.

ASYNC_TNT_FUZZ_CASES makes it a long run.
"""

import os
import re
from dataclasses import replace

import h5py
import nir
import numpy as np
import pytest
import torch
from made import random_regressor_model, raw_model
from networks.nir.damaged_graphs import VALUES, Fields, damaged_fields
from networks.nir.graph_in_torch import outputs_of
from torch import nn

from async_tnt import CompiledNetwork, Model, TNTConfig, load_model
from async_tnt.networks import to_nir
from async_tnt.networks.models.compiled_network import compiled_network_of

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "60"))

CONFIG = TNTConfig(sensor=(12, 10), grid=(12, 10), bins=2, polarity="split", transform="none")

CLASSES = ("a", "b", "c")


class Residual(nn.Module):
    """A block whose output is added to its input."""

    def __init__(self, channels, has_norm):
        super().__init__()
        end = nn.BatchNorm2d(channels) if has_norm else nn.ReLU()
        self.inside = nn.Sequential(nn.Conv2d(channels, channels, 3, padding=1), end)

    def forward(self, x):
        return x + self.inside(x)


def random_module(seed):
    """A network of the layers that have a NIR form."""
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    channels, rows, columns = CONFIG.shape
    layers = []
    for _ in range(rng.integers(1, 4)):
        kind = rng.choice(["conv", "strided", "pool", "residual"])
        if kind == "conv":
            groups = int(rng.choice([1, channels]))
            filters = groups * int(rng.integers(1, 4))
            bias = bool(rng.integers(2))
            how = {"padding": 2, "dilation": 2, "groups": groups, "bias": bias}
            layers += [nn.Conv2d(channels, filters, 3, **how), nn.ReLU()]
            channels = filters
        elif kind == "strided":
            layers += [nn.Conv2d(channels, 3, 3, 2, 1), nn.BatchNorm2d(3), nn.ReLU()]
            channels, rows, columns = 3, -(-rows // 2), -(-columns // 2)
        elif kind == "pool" and min(rows, columns) > 3:
            layers.append(nn.AvgPool2d(2, divisor_override=rng.choice([None, 1])))
            rows, columns = rows // 2, columns // 2
        else:
            layers.append(Residual(channels, bool(rng.integers(2))))
    end = rng.integers(3)
    if end == 0:
        layers += [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(channels, len(CLASSES))]
    elif end == 1:
        n_features = channels * rows * columns
        layers += [nn.Flatten(), nn.Linear(n_features, 8, bias=False), nn.ReLU()]
        layers.append(nn.Linear(8, len(CLASSES)))
    else:
        layers.append(nn.Conv2d(channels, len(CLASSES) + 1, 1))  # a map model
    module = nn.Sequential(*layers).eval()
    for norm in module.modules():
        if isinstance(norm, nn.BatchNorm2d):
            norm.running_mean.normal_()
            norm.running_var.uniform_(0.5, 2.0)
            norm.weight.data.uniform_(0.5, 2.0)
            norm.bias.data.normal_()
            norm.eps = 0.25
    return module


def random_volume(seed):
    rng = np.random.default_rng(seed)
    return rng.normal(size=CONFIG.shape).astype(np.float32) * (rng.random(CONFIG.shape) < 0.3)


def numbers_of(model, volume):
    (numbers,) = CompiledNetwork(model)(volume)
    return numbers


def assert_close(own, expected):
    np.testing.assert_allclose(own, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(CASES))
def test_random_networks(seed):
    """The graph computes what the network computes, and the network comes back from it."""
    module = random_module(seed)
    classes = CLASSES if seed % 3 else None
    model = Model.from_torch(module, CONFIG, classes=classes, record={"seed": seed})
    graph = to_nir(model)
    again = Model.from_nir(graph)
    assert (again.config, again.classes, again.record) == (CONFIG, model.classes, {"seed": seed})
    assert again.outputs.keys() == model.outputs.keys()
    raw = Model.from_torch(module, CONFIG)
    raw_again = Model(CONFIG, again.weights, network=again.network, outputs={"out": last_of(again)})
    volume = random_volume(seed)
    expected = numbers_of(raw, volume)
    assert_close(outputs_of(graph, volume), expected)
    assert_close(numbers_of(raw_again, volume), expected)
    assert_same_network(Model.from_nir(to_nir(again)), again)


def last_of(model):
    return model.layers[-1]["name"]


def assert_same_network(model, other):
    assert model.network == other.network
    assert model.weights.keys() == other.weights.keys()
    for name, values in model.weights.items():
        np.testing.assert_array_equal(values, other.weights[name])


@pytest.mark.parametrize("name", ["digits.nir", "DIGITS.NIR"])
def test_a_bundled_model_comes_back_from_its_file_with_the_same_bits(name, tmp_path):
    model = load_model("digits")
    nir.write(tmp_path / name, to_nir(model))
    again = load_model(tmp_path / name)
    assert_same_network(again, model)
    assert again.config == model.config
    assert again.classes == model.classes
    assert again.record == model.record


def test_the_graph_of_a_file_says_what_it_is(tmp_path):
    nir.write(tmp_path / "a.nir", to_nir(load_model("digits")))
    with h5py.File(tmp_path / "a.nir") as file:
        assert file["node/metadata/activation"][()] == b"relu"
        assert file["node/nodes/relu1/type"][()] == b"IF"


def small_model(*layers, config=CONFIG):
    return Model.from_torch(nn.Sequential(*layers), config)


def test_neurons_fire_where_reset_says_so():
    """With a reset, the graph of a network that reads events is a spiking network."""
    config = TNTConfig(sensor=(4, 4), grid=(4, 4), representation="count", polarity="split")
    graph = to_nir(small_model(nn.Conv2d(2, 3, 3, bias=False), nn.ReLU(), config=config))
    spiking = Model.from_nir(graph, reset="subtract", polarity="on_first")
    assert [layer["op"] for layer in spiking.layers] == ["conv", "if"]
    assert [layer["op"] for layer in Model.from_nir(graph).layers] == ["conv", "relu"]


@pytest.mark.parametrize(
    "parameter, value",
    [("classes", ["a"]), ("window_us", 5), ("dt", 1e-3), ("polarity", "on_first"), ("record", {})],
)
def test_parameters_of_spiking_networks_are_refused(parameter, value):
    graph = to_nir(load_model("digits"))
    with pytest.raises(TypeError, match=f"`{parameter}` is for spiking networks, and this graph"):
        Model.from_nir(graph, **{parameter: value})


@pytest.mark.parametrize(
    "layer, message",
    [
        (nn.MaxPool2d(2), r"\(max_pool\): NIR 1.0 has no such node"),
        (nn.Sigmoid(), r"\(sigmoid\): NIR 1.0 has no such node"),
        (nn.BatchNorm2d(4), r"\(batch_norm\): it must be the only reader of a convolution"),
    ],
)
def test_layers_without_a_form(layer, message):
    model = small_model(layer, nn.Conv2d(4, 2, 3))
    with pytest.raises(NotImplementedError, match=message):
        to_nir(model)


def test_the_order_of_polarities_is_for_spiking_models():
    with pytest.raises(ValueError, match="`polarity` is for spiking models, got 'on_first'"):
        to_nir(load_model("digits"), polarity="on_first")


def test_what_no_graph_can_hold():
    with pytest.raises(ValueError, match="`model` must have no landmark network: it has no NIR"):
        to_nir(random_regressor_model())
    with pytest.raises(ValueError, match="`model` must have classes or one output, it has 3"):
        to_nir(raw_model())


def test_a_model_of_objects_by_share_is_one_when_it_is_read_again():
    model = Model.from_torch(nn.Conv2d(4, 4, 1), CONFIG, CLASSES)
    for by_share in (False, True):
        again = Model.from_nir(to_nir(replace(model, by_share=by_share)))
        assert again.by_share == by_share


def changed_metadata(**changes):
    graph = to_nir(load_model("digits"))
    graph.metadata.update(changes)
    return graph


def changed_node(name, **fields):
    graph = to_nir(load_model("digits"))
    for field, values in fields.items():
        setattr(graph.nodes[name], field, values)
    return graph


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: changed_metadata(config="{"), "`config` in its metadata cannot be read"),
        (lambda: changed_metadata(config="[]"), "config"),
        (lambda: changed_metadata(config=3.0), "no config in its metadata"),
        (lambda: changed_metadata(classes="3"), "classes"),
        (lambda: changed_metadata(classes='["a"]'), "must compute 1 logits"),
        (lambda: changed_metadata(outputs='["a"]'), "outputs"),
        (
            lambda: changed_node("relu1", v_threshold=np.full((8, 34, 34), 2.0)),
            "(IF): v_threshold must be 1 where a neuron stands for a ReLU; pass `reset`",
        ),
        (
            lambda: changed_node("relu1", r=np.full((8, 34, 34), 2.0)),
            "(IF): r must be 1 where a neuron stands for a ReLU; pass `reset`",
        ),
        (
            lambda: changed_node("relu1", v_reset=np.full((8, 34, 34), -1.0)),
            "(IF): v_reset must be 0 where a neuron stands for a ReLU; pass `reset`",
        ),
        (
            lambda: changed_node("input", input_type={"input": np.array([2, 34, 34])}),
            "(Input): its shape must be (9, 34, 34), as the graph's `config` says; got (2, 34, 34)",
        ),
    ],
)
def test_damaged_graphs(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Model.from_nir(make())


def test_neurons_stand_for_relus_where_the_metadata_say_relu():
    graph = changed_metadata(activation="tanh")
    with pytest.raises(TypeError, match=r"^`reset` must be subtract or value"):
        Model.from_nir(graph)


TEXTS = ('"a"', "[]", '["a", "b", "c"]', "{}", "null", "-1", "[[]]", "{", "1e999", "NaN", "x" * 99)
"""Values of metadata: JSON and what is none."""


def test_random_damage():
    """A model that runs, or an error of one line."""
    graph = to_nir(Model.from_torch(random_module(1), CONFIG, classes=CLASSES)).to_dict()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(10 * CASES):
        fields = damaged_fields(graph, rng)
        metadata = fields["metadata"]
        if isinstance(metadata, dict) and metadata and rng.integers(3) == 0:
            names = list(metadata)
            choices = VALUES if rng.integers(2) else TEXTS
            metadata[names[rng.integers(len(names))]] = choices[rng.integers(len(choices))]
        try:
            model = Model.from_nir(Fields(fields))
        except (ValueError, NotImplementedError, TypeError) as error:
            # without its metadata it is a graph of neurons, whose reset is asked for
            assert not isinstance(error, TypeError) or "`reset` must be subtract" in str(error)
            assert str(error).isprintable()
            assert len(str(error)) < 1200
            refused += 1
        else:
            compiled_network_of(model)(np.zeros(model.config.shape, np.float32))
    assert 3 * CASES < refused < 10 * CASES
