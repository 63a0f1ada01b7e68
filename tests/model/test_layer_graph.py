"""The layer graph in a model file says what the network computes, and only a graph that can be run is loaded."""

import json
import re

import numpy as np
import pytest
import torch
from made import random_model, random_regressor_model
from model.small import SMALL, changed, write_file
from safetensors import safe_open
from torch.nn import functional

from async_tnt import CompiledClassifier, TNTConfig, load_model
from async_tnt.networks.layer_graph import layer_graph
from async_tnt.networks.regressor import CompiledRegressor


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


@pytest.mark.parametrize("seed", range(3))
def test_the_graph_gives_the_compiled_networks_answers(tmp_path, seed):
    config = TNTConfig(sensor=(9, 8), grid=(13, 6 + seed), bins=2)
    model = random_regressor_model(config, classes=3, widths=(2, 3, 4), regressor_widths=(5, 6, 7), seed=seed)
    with safe_open(model.save(tmp_path / "m"), "numpy") as file:
        graph = json.loads(file.metadata()["network"])
        tensors = {name: file.get_tensor(name) for name in model.weights}
    volume = np.random.default_rng(seed).normal(size=config.shape).astype(np.float32)
    logits = run(graph["classifier"], tensors, volume)
    assert np.ptp(logits) > 1e-3
    np.testing.assert_allclose(CompiledClassifier(model)(volume), logits, atol=1e-4)  # summation order in float32
    landmark = run(graph["regressor"], tensors, volume)
    np.testing.assert_allclose(CompiledRegressor(model)(volume), landmark, atol=1e-4)
    assert not tensors


def test_without_a_regressor_there_is_one_network(tmp_path):
    with safe_open(random_model(SMALL, classes=3, widths=(2, 3, 4)).save(tmp_path / "m"), "numpy") as file:
        assert list(json.loads(file.metadata()["network"])) == ["classifier"]


def edited(edit):
    graph = layer_graph(SMALL)
    edit(graph["classifier"])
    return graph


BATCH_NORM = {"op": "batch_norm", "name": "bn1", "inputs": ["conv1"], "weights": {"weight": "bn1.weight"}}


@pytest.mark.parametrize(
    ("graph", "message"),
    [
        (
            edited(lambda layers: layers.insert(1, BATCH_NORM)),
            "layer 1 of its classifier has op 'batch_norm', expected 'relu'",
        ),
        (edited(lambda layers: layers[3].update(groups=2)), "layer 3 of its classifier has groups 2, expected 1"),
        (
            edited(lambda layers: layers[0].update(kernel=[5, 5])),
            "layer 0 of its classifier has kernel [5, 5], expected [3, 3]",
        ),
        (
            edited(lambda layers: layers[8].update(inputs=["fc1", "flatten"])),
            "layer 8 of its classifier has inputs ['fc1', 'flatten'], expected ['fc1']",
        ),
        (edited(lambda layers: layers[6].update(axis=1)), "layer 6 of its classifier has axis 1, expected nothing"),
        (
            edited(lambda layers: layers.append({"op": "softmax"})),
            "layer 10 of its classifier has op 'softmax', expected nothing",
        ),
        (edited(lambda layers: layers.append({})), "layer 10 of its classifier has op nothing, expected nothing"),
        (edited(lambda layers: layers.pop()), "layer 9 of its classifier has op nothing, expected 'dense'"),
        (edited(lambda layers: layers.insert(0, 5)), "layer 0 of its classifier has op 5, expected 'conv'"),
        (
            layer_graph(SMALL.replace(landmark="regressor")),
            "its networks are classifier, regressor, expected classifier",
        ),
        ({}, "its networks are none, expected classifier"),
    ],
)
def test_a_network_of_another_release_is_refused_by_name(tmp_path, graph, message):
    path = write_file(tmp_path / "m", changed(), network=json.dumps(graph))
    expected = f"{path} holds a network that this release cannot run: {message}"
    with pytest.raises(ValueError, match=f"^{re.escape(expected)}$"):
        load_model(path)
