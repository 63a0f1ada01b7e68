"""The layer graph in a model file states what the network computes, and only a graph that can be run is loaded."""

import json
import re

import numpy as np
import pytest
import torch
from model.small import SMALL, WITH_REGRESSOR, changed, small_model, write_file
from safetensors import safe_open
from torch.nn import functional

from async_tnt import CompiledClassifier, CompiledRegressor, load_model
from async_tnt.networks.layer_graph import layer_graph


def centroid(heatmap):
    weights = torch.softmax(heatmap[0, 0].double().flatten(), 0)
    y, x = torch.meshgrid(*(torch.arange(side) for side in heatmap.shape[2:]), indexing="ij")
    return torch.stack([(weights * x.flatten()).sum(), (weights * y.flatten()).sum()])


def conv(x, layer, weight, bias=None):
    top, left, bottom, right = layer["padding"]
    padded = functional.pad(x, (left, right, top, bottom))
    return functional.conv2d(padded, weight, bias, layer["stride"], 0, layer["dilation"], layer["groups"])


OPS = {
    "conv": conv,
    "relu": lambda x, layer: functional.relu(x),
    "average_pool": lambda x, layer: functional.avg_pool2d(x, layer["kernel"], layer["stride"], layer["padding"][:2]),
    "flatten": lambda x, layer: x.flatten(1),
    "dense": lambda x, layer, weight, bias: functional.linear(x, weight, bias),
    "heatmap_centroid": lambda x, layer: centroid(x),
}


def run(layers, tensors, volume):
    """What the layers of a file compute, one after the other; the tensors that they used are removed."""
    values = {"volume": torch.from_numpy(volume)[None]}
    for layer in layers:
        weights = {role: torch.from_numpy(tensors.pop(name)) for role, name in layer.get("weights", {}).items()}
        inputs = [values[name] for name in layer["inputs"]]
        values[layer["name"]] = OPS[layer["op"]](*inputs, layer, **weights)
    return values[layers[-1]["name"]].flatten().numpy()


@pytest.mark.parametrize("grid", [(13, 6), (13, 7), (5, 8)])
def test_the_graph_gives_the_compiled_networks_answers(tmp_path, grid):
    model = small_model(seed=1, config=WITH_REGRESSOR.replace(grid=grid))
    with safe_open(model.save(tmp_path / "m"), "numpy") as file:
        graph = json.loads(file.metadata()["network"])
        tensors = {name: file.get_tensor(name) for name in model.weights}
    volume = np.random.default_rng(1).normal(size=model.config.shape).astype(np.float32)
    logits = run(graph["classifier"], tensors, volume)
    assert np.ptp(logits) > 1e-3
    np.testing.assert_allclose(CompiledClassifier(model)(volume), logits, atol=1e-4)  # summation order in float32
    np.testing.assert_allclose(CompiledRegressor(model)(volume), run(graph["regressor"], tensors, volume), atol=1e-4)
    assert not tensors
    assert list(layer_graph(SMALL)) == ["classifier"]


BATCH_NORM = {"op": "batch_norm", "name": "bn1", "inputs": ["conv1"], "weights": {"weight": "bn1.weight"}}


@pytest.mark.parametrize(
    "edit, message",
    [
        (lambda layers: layers.insert(1, BATCH_NORM), "layer 1 of its classifier has op 'batch_norm', expected 'relu'"),
        (
            lambda layers: layers[0].update(kernel=[5, 5]),
            "layer 0 of its classifier has kernel [5, 5], expected [3, 3]",
        ),
        (lambda layers: layers[6].update(axis=1), "layer 6 of its classifier has axis 1, expected nothing"),
        (lambda layers: layers.pop(), "layer 9 of its classifier has op nothing, expected 'dense'"),
    ],
)
def test_a_network_of_another_release_is_refused_by_name(tmp_path, edit, message):
    graph = layer_graph(SMALL)
    edit(graph["classifier"])
    assert_cannot_run(tmp_path / "m", graph, message)


def test_other_networks_than_the_configurations_are_refused(tmp_path):
    assert_cannot_run(tmp_path / "m", {}, "its networks are none, expected classifier")
    both = "its networks are classifier, regressor, expected classifier"
    assert_cannot_run(tmp_path / "m", layer_graph(WITH_REGRESSOR), both)


def assert_cannot_run(path, graph, message):
    write_file(path, changed(), network=json.dumps(graph))
    with pytest.raises(
        ValueError, match=f"^{re.escape(f'{path} holds a network that this release cannot run: {message}')}$"
    ):
        load_model(path)
