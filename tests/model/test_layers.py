"""The layers in a model file: what does not fit, or cannot be run, is refused with the layer's name."""

import copy
import json
import re

import numpy as np
import pytest
from hypothesis import given
from incremental.random_networks import random_models
from model.small import SMALL, WITH_REGRESSOR, assert_same, changed, small_model, write_file
from tnt_reference import Classifier, LandmarkRegressor, LayerNetwork

from async_tnt import CompiledClassifier, Model, load_model
from async_tnt.networks.thesis import thesis_network


@given(random_models())
def test_a_saved_network_is_the_same(tmp_path_factory, model):
    path = tmp_path_factory.mktemp("model") / "m.safetensors"
    loaded = load_model(model.save(path))
    assert_same(loaded, model)
    assert loaded.layers == model.layers
    volume = np.random.default_rng(0).normal(size=model.config.shape).astype(np.float32)
    assert CompiledClassifier(loaded)(volume).tobytes() == CompiledClassifier(model)(volume).tobytes()


def test_the_thesis_layers_are_those_of_the_references_modules():
    import torch

    model = small_model(seed=1, config=WITH_REGRESSOR)
    channels, height, width = model.config.shape
    classifier = Classifier(channels, (width, height), 3, (2, 3, 4))
    classifier.load_state_dict(
        {name: torch.tensor(w) for name, w in model.weights.items() if not name.startswith("regressor.")}
    )
    volume = torch.randn(2, channels, height, width, generator=torch.Generator().manual_seed(0))
    layers = {name: LayerNetwork(part, model.weights) for name, part in model.layers.items()}
    assert torch.equal(layers["classifier"](volume), classifier(volume))
    even = LandmarkRegressor(channels, (width, height), 5)
    weights = {f"regressor.{name}": w.detach().numpy() for name, w in even.state_dict().items()}
    landmarks = LayerNetwork(model.layers["regressor"], weights)(volume)
    assert torch.allclose(landmarks, even(volume), atol=1e-12)


def edited(edit):
    network = copy.deepcopy(thesis_network(SMALL))
    edit(network["classifier"])
    return network


def insert(place, **layer):
    return lambda layers: layers.insert(place, layer)


def update(place, **parameters):
    return lambda layers: layers[place].update(parameters)


CANNOT_RUN = [
    (update(1, op="gelu"), "layer 'relu1' is a 'gelu'; this release knows conv, dense, batch_norm, relu, "),
    (update(1, inplace=True), "layer 'relu1' (relu) has inplace"),
]
DAMAGED = [
    (lambda layers: layers.clear(), "a network must have at least one layer"),
    (update(1, name=3), "layer 1 must be an object with `name` and `op`, got {'inputs': ['conv1'], 'name': 3, 'op': "),
    (update(1, name="conv1"), "layer 'conv1' (relu): another layer has this name"),
    (update(1, inputs=["conv7"]), "layer 'relu1' (relu): no earlier layer is named 'conv7'"),
    (update(1, inputs=["fc1"]), "layer 'relu1' (relu): no earlier layer is named 'fc1'"),
    (update(1, inputs="conv1"), "layer 'relu1' (relu): `inputs` must be a list of names, got 'conv1'"),
    (update(1, inputs=["conv1", "conv1"]), "layer 'relu1' (relu): must have 1 input, got 2"),
    (insert(1, op="add", name="sum", inputs=["conv1"]), "layer 'sum' (add): must have 2 inputs or more, got 1"),
    (
        insert(4, op="add", name="sum", inputs=["conv2", "pool1"]),
        "layer 'sum' (add): its inputs must have one shape, got (3, 3, 2), (2, 3, 2)",
    ),
    (lambda layers: layers[0].pop("stride"), "layer 'conv1' (conv): must have stride"),
    (
        update(0, stride=[0, 1]),
        "layer 'conv1' (conv): `stride` must be a list of 2 whole numbers from 1 on, got [0, 1]",
    ),
    (
        update(0, padding=[1, 1]),
        "layer 'conv1' (conv): `padding` must be a list of 4 whole numbers from 0 on, got [1, 1]",
    ),
    (
        update(0, kernel=[9, 9]),
        "layer 'conv1' (conv): its kernel reaches over 9 places, its input has 8 with the paddi",
    ),
    (update(0, kernel=[1, 1]), "layer 'conv1' (conv): its weight must have shape (2, 2, 1, 1) here, got (2, 2, 3, 3)"),
    (update(0, groups=3), "layer 'conv1' (conv): 3 groups must divide its 2 channels and 2 filters"),
    (update(0, weights={"bias": "conv1.bias"}), "layer 'conv1' (conv): `weights` must be weight, bias, got bias"),
    (
        update(2, padding=[2, 0, 0, 0]),
        "layer 'pool1' (average_pool): padding [2, 0, 0, 0] must be less than kernel [2, 2]",
    ),
    (
        insert(1, op="clip", name="c", inputs=["conv1"], low=2, high=1),
        "layer 'c' (clip): `low` must be at most `high`, ",
    ),
    (
        insert(1, op="leaky_relu", name="l", inputs=["conv1"], slope=1e999),
        "layer 'l' (leaky_relu): `slope` must be a fini",
    ),
    (
        insert(7, op="prelu", name="p", inputs=["flatten"], weights={"slope": "fc1.bias"}),
        "layer 'p' (prelu): its slope must have shape (3,) here, got (4,)",
    ),
    (
        update(7, inputs=["pool2"]),
        "layer 'fc1' (dense): its input must be flat, got (3, 1, 1): a flatten belongs before it",
    ),
    (lambda layers: layers.pop(), "the network must compute 3 logits, one for each class, got (4,)"),
    (
        lambda layers: layers.append({"op": "heatmap_centroid", "name": "h", "inputs": ["volume"]}),
        "layer 'h' (heatmap_c",
    ),
]


@pytest.mark.parametrize(
    "edit, message", CANNOT_RUN + DAMAGED, ids=[message[:50] for _, message in CANNOT_RUN + DAMAGED]
)
def test_what_does_not_fit_is_one_error_that_names_the_layer(tmp_path, edit, message):
    """From Python, and from a file with a valid checksum."""
    network, path = edited(edit), tmp_path / "m"
    error, kind = (NotImplementedError, "a network that this release cannot run")
    if (edit, message) in DAMAGED:
        error, kind = ValueError, "a damaged model"
    with pytest.raises(error) as raised:
        Model(SMALL, changed(), ("a", "b", "c"), network=network)
    assert str(raised.value).startswith(message)
    write_file(path, changed(), network=json.dumps(network))
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} holds {kind}: {message}')}"):
        load_model(path)


def flat_map(*layers):
    """A map of 3 x 2 places, flattened, and what follows."""
    return [
        {"op": "max_pool", "name": "p", "inputs": ["volume"], "kernel": [2, 2], "stride": [2, 2], "padding": [0] * 4},
        {"op": "flatten", "name": "f", "inputs": ["p"]},
        *layers,
    ]


@pytest.mark.parametrize(
    "layers, message",
    [
        (flat_map(), "layer 'f' is the output, and a flattened map: a dense layer belongs behind it"),
        (
            flat_map({"op": "add", "name": "s", "inputs": ["f", "f"]}),
            "layer 's' (add): 'f' is a flattened map: a dense layer belongs between",
        ),
    ],
)
def test_only_a_dense_layer_knows_the_order_of_a_flattened_map(layers, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        Model(SMALL, {}, list("abcdefghijkl"), network={"classifier": layers})


@pytest.mark.parametrize("network, error", [({}, ValueError), ({"classifier": 3}, TypeError), ([], TypeError)])
def test_networks_that_are_none(network, error):
    with pytest.raises(error, match=r"^`network` must "):
        Model(SMALL, changed(), ("a", "b", "c"), network=network)
    with pytest.raises(ValueError, match=r"^`network` must hold classifier, regressor here, got classifier$"):
        Model(WITH_REGRESSOR, changed(), ("a", "b", "c"), network=thesis_network(SMALL))


def test_a_heatmap_of_other_places_than_the_volumes_is_refused():
    """Its places are grid pixels; the kernel reads as many as the volume has."""
    network = copy.deepcopy(thesis_network(WITH_REGRESSOR))
    pool = {
        "op": "max_pool",
        "name": "p",
        "inputs": ["heatmap"],
        "kernel": [2, 2],
        "stride": [2, 2],
        "padding": [0] * 4,
    }
    network["regressor"].insert(-1, pool)
    network["regressor"][-1]["inputs"] = ["p"]
    message = r"^the heatmap must be of shape \(1, 6, 5\), as the volume, got \(1, 3, 2\)$"
    with pytest.raises(ValueError, match=message):
        Model(WITH_REGRESSOR, changed(WITH_REGRESSOR), ("a", "b", "c"), network=network)


@pytest.mark.parametrize("padding", [[20_000] * 4, [30_000, 0, 30_000, 0], [0, 16_384, 0, 16_384]])
def test_padding_that_would_fill_the_memory_or_the_numbers_of_places_is_refused(padding):
    network = edited(update(0, padding=padding))
    with pytest.raises(ValueError, match=r"^layer 'conv1' \(conv\): .* more than 268_435_456 numbers"):
        Model(SMALL, changed(), ("a", "b", "c"), network=network)
