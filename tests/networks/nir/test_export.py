"""A spiking model as a NIR graph, and read again.

ASYNC_TNT_FUZZ_CASES makes it a long run: it was 5,000 graphs once.
"""

import os
import re
from dataclasses import replace

import h5py
import nir
import numpy as np
import pytest
from networks.nir.random_graphs import RandomGraph
from networks.random_spiking import random_spiking_model

from async_tnt import Model, SpikingVolume, TNTConfig, load_model
from async_tnt.networks import to_nir

CASES = int(os.environ.get("ASYNC_TNT_FUZZ_CASES", "100"))


def assert_equal(model, other):
    """Two models have the same layers, weights and configuration."""
    assert model.network == other.network
    assert model.config == other.config
    assert model.outputs == other.outputs
    assert model.weights.keys() == other.weights.keys()
    for name, values in model.weights.items():
        np.testing.assert_array_equal(values, other.weights[name])


def spikes_of(model, seed):
    """What the neurons of the output do for random events."""
    rng = np.random.default_rng(seed)
    width, height = model.config.sensor
    n = 300
    columns = (
        np.sort(rng.integers(0, 100_000, n)),
        rng.integers(0, width, n),
        rng.integers(0, height, n),
        rng.integers(0, 2, n),
    )
    volume = SpikingVolume(model)
    volume.update(columns)
    counts = volume.spike_counts() if volume.network.fires else np.zeros(0)
    return counts, volume.membranes()


@pytest.mark.parametrize("seed", range(CASES))
def test_a_graph_that_was_read_goes_out_as_it_came(seed):
    drawn = RandomGraph(seed)
    model = Model.from_nir(drawn.graph, **drawn.meaning)
    graph = to_nir(model, polarity=drawn.meaning["polarity"])
    assert_equal(Model.from_nir(graph, **drawn.meaning), model)


@pytest.mark.parametrize("seed", range(0, CASES, 20))
def test_the_same_in_a_file(tmp_path, seed):
    drawn = RandomGraph(seed)
    model = Model.from_nir(drawn.graph, **drawn.meaning, window_us=70_000)
    nir.write(tmp_path / "a.nir", to_nir(model, polarity=drawn.meaning["polarity"]))
    again = Model.from_nir(tmp_path / "a.nir", **drawn.meaning, window_us=70_000)
    assert_equal(again, model)


@pytest.mark.parametrize("seed", range(0, CASES, 5))
def test_the_other_order_of_channels_computes_the_same(seed):
    drawn = RandomGraph(seed)
    model = Model.from_nir(drawn.graph, **drawn.meaning)
    for order in ("off_first", "on_first"):
        again = Model.from_nir(to_nir(model, polarity=order), **drawn.meaning | {"polarity": order})
        for own, other in zip(spikes_of(model, seed), spikes_of(again, seed), strict=True):
            np.testing.assert_allclose(other, own, rtol=1e-6, atol=1e-6)


def test_a_published_graph(data, tmp_path):
    path = data / "nir" / "cnn_sinabs.nir"
    model = Model.from_nir(path, reset="subtract")
    graph = to_nir(model)
    nir.write(tmp_path / "again.nir", graph)
    assert_equal(Model.from_nir(tmp_path / "again.nir", reset="subtract"), model)
    # the library checks the types of all nodes here
    published = nir.read(path)
    again = nir.read(tmp_path / "again.nir")
    assert again.nodes.keys() == published.nodes.keys()
    assert sorted(again.edges) == sorted(set(published.edges))
    for name, node in published.nodes.items():
        for field in ("weight", "r", "v_threshold", "v_reset", "kernel_size"):
            if hasattr(node, field):
                ours = np.asarray(getattr(again.nodes[name], field))
                np.testing.assert_array_equal(ours, np.asarray(getattr(node, field)))


def test_metadata_says_what_a_graph_leaves_open(tmp_path):
    drawn = RandomGraph(0)
    meaning = {"reset": drawn.meaning["reset"], "dt": 1e-3}
    model = Model.from_nir(drawn.graph, **meaning, window_us=50_000)
    nir.write(tmp_path / "a.nir", to_nir(model))
    with h5py.File(tmp_path / "a.nir") as file:
        metadata = file["node/metadata"]
        assert metadata["polarity"][()] == b"off_first"
        assert metadata["window_us"][()] == 50_000
        assert metadata["producer"][()].startswith(b"async_tnt ")
        assert "classes" not in metadata
    metadata = to_nir(load_model("digits")).metadata
    assert metadata.keys() >= {"producer", "config", "classes", "record"}
    assert "format" not in metadata  # it is that of a .safetensors file


NO_FORM = "its padding must be the same|layers differ in `(reset|dt)`|it adds a layer to itself"


def test_random_models_that_came_from_no_graph():
    """What has a NIR form computes the same; the last neurons may have another name."""
    n_written = 0
    for seed in range(2 * CASES):
        model = random_spiking_model(seed)
        try:
            graph = to_nir(model)
        except NotImplementedError as error:
            assert re.search(NO_FORM, str(error))
            continue
        neurons = [layer for layer in model.layers if "reset" in layer or "dt" in layer]
        meaning = {
            name: next((layer[name] for layer in neurons if name in layer), None)
            for name in ("reset", "dt")
        }
        window_us = model.config.window_us
        again = Model.from_nir(graph, classes=model.classes, window_us=window_us, **meaning)
        for own, other in zip(spikes_of(model, seed), spikes_of(again, seed), strict=True):
            np.testing.assert_allclose(other, own, rtol=1e-6, atol=1e-6)
        n_written += 1
    assert n_written > CASES // 4


# -- models that came from no graph ----------------------------------------------------------------

ONES = np.ones((2, 4, 4), np.float32)


def model_of(layers, **weights):
    """A spiking model with sum pooling over its 4 x 4 pixels and neurons at its end."""
    last = layers[-1]["name"] if layers else "volume"
    ends = [
        {
            "op": "sum_pool",
            "name": "pool",
            "inputs": [last],
            "kernel": [2, 2],
            "stride": [2, 2],
            "padding": [0, 0, 0, 0],
        },
        {
            "op": "if",
            "name": "out",
            "inputs": ["pool"],
            "reset": "subtract",
            "weights": {"r": "r", "v_threshold": "h"},
        },
    ]
    weights = {"r": ONES[:, :2, :2], "h": 2.5 * ONES[:, 0, 0], **weights}
    config = TNTConfig(sensor=(4, 4), grid=(4, 4), representation="count")
    outputs = dict.fromkeys(("spikes", "membranes", "first_spike_us"), "out")
    return Model(config, weights, network={"spiking": [*layers, *ends]}, outputs=outputs)


def scale(name, source, weights="s"):
    return {"op": "scale", "name": name, "inputs": [source], "weights": {"scale": weights}}


def add(name, *sources):
    return {"op": "add", "name": name, "inputs": list(sources)}


@pytest.mark.parametrize(
    "layers",
    [
        [],  # gains for each place, one threshold for each channel, no v_reset
        [scale("a/b", "volume"), scale("a.b", "a/b")],
        [scale("input", "volume"), scale("output", "input")],
        [scale("x", "volume"), scale("y", "volume"), add("sum", "x", "y", "volume")],
        [
            scale("x", "volume"),
            add("one", "x", "volume"),
            scale("y", "one"),
            add("two", "one", "y"),
        ],
    ],
)
def test_the_same_spikes(layers, tmp_path):
    model = model_of(layers, **({"s": 0.75 * ONES} if layers else {}))
    nir.write(tmp_path / "a.nir", to_nir(model))
    again = Model.from_nir(tmp_path / "a.nir", reset="subtract")
    for own, other in zip(spikes_of(model, 0), spikes_of(again, 0), strict=True):
        np.testing.assert_array_equal(other, own)
        assert own.any()


def conv(weight, stride=(1, 1), padding=(0, 0, 0, 0)):
    """A convolution of one pixel that reads the volume, and its weights."""
    layer = {
        "op": "conv",
        "name": "conv",
        "inputs": ["volume"],
        "kernel": [1, 1],
        "stride": list(stride),
        "padding": list(padding),
        "dilation": [1, 1],
        "groups": 1,
        "weights": {"weight": "w"},
    }
    return layer, np.array(weight, np.float32).reshape(1, 2, 1, 1)


@pytest.mark.parametrize(
    "how, n_channels",
    [
        ({"weight": [1, 1]}, 1),
        ({"weight": [1, 0.5]}, 2),
        ({"weight": [1, 1], "stride": [2, 2]}, 2),
        ({"weight": [1, 1], "padding": [1, 1, 1, 1]}, 2),
    ],
    ids=str,
)
def test_an_input_of_one_channel_is_a_plain_sum_of_polarities(how, n_channels):
    layer, weight = conv(**how)
    one = np.ones(1, np.float32)
    model = model_of([layer], w=weight, r=one, h=2.5 * one)
    graph = to_nir(model)
    (node,) = [node for node in graph.nodes.values() if isinstance(node, nir.Input)]
    assert node.input_type["input"].tolist() == [n_channels, 4, 4]
    again = Model.from_nir(graph, reset="subtract")
    for own, other in zip(spikes_of(model, 0), spikes_of(again, 0), strict=True):
        np.testing.assert_array_equal(other, own)
        assert own.any()


def test_an_input_of_one_channel_has_no_reader_beside_the_sum():
    layer, weight = conv([1, 1])
    other = {**layer, "name": "other", "weights": {"weight": "v"}}
    one = np.ones(1, np.float32)
    layers = [layer, other, add("sum", "conv", "other")]
    model = model_of(layers, w=weight, v=0.5 * weight, r=one, h=2.5 * one)
    again = Model.from_nir(to_nir(model), reset="subtract")
    for own, other in zip(spikes_of(model, 0), spikes_of(again, 0), strict=True):
        np.testing.assert_array_equal(other, own)


@pytest.mark.parametrize(
    "model", [lambda: model_of([scale("a", "volume")], s=0.75 * ONES), lambda: load_model("digits")]
)
def test_a_graph_shares_no_memory_with_its_model(model):
    model = model()
    before = {name: values.copy() for name, values in model.weights.items()}
    for node in to_nir(model).nodes.values():
        for values in vars(node).values():
            if isinstance(values, np.ndarray):
                values[...] = 7
    for name, values in model.weights.items():
        np.testing.assert_array_equal(values, before[name])


def uneven(model):
    layers = [dict(layer) for layer in model.network["spiking"]]
    layers[-2]["padding"] = [0, 0, 1, 1]
    return replace(model, network={"spiking": layers})


@pytest.mark.parametrize(
    "model, message",
    [
        (
            lambda: uneven(model_of([])),
            r"layer 'pool' \(sum_pool\): its padding must be the same on",
        ),
        (
            lambda: model_of([add("a", "volume", "volume")]),
            r"layer 'a' \(add\): it adds a layer to",
        ),
    ],
)
def test_no_form(model, message):
    with pytest.raises(NotImplementedError, match=message):
        to_nir(model())


def test_neurons_that_differ_in_their_reset():
    model = model_of([])
    layers = [dict(layer) for layer in model.network["spiking"]]
    first = {**layers[-1], "name": "first", "inputs": ["volume"], "reset": "value"}
    first["weights"] = {"r": "h", "v_threshold": "h"}
    layers[0]["inputs"] = ["first"]
    model = replace(model, network={"spiking": [first, *layers]})
    with pytest.raises(NotImplementedError, match=r"differ in `reset` \(subtract, value\)"):
        to_nir(model)


def test_neurons_that_differ_in_their_time_step():
    layers = []
    for name, source, dt in (("one", "volume", 1e-3), ("two", "one", 1e-4)):
        roles = {"tau": "h", "r": "h", "v_leak": "zeros", "v_threshold": "h"}
        layer = {"op": "lif", "name": name, "inputs": [source], "reset": "value", "dt": dt}
        layers.append({**layer, "weights": roles})
    weights = {"h": ONES[:, 0, 0], "zeros": 0 * ONES[:, 0, 0], "r": ONES[:, :2, :2]}
    model = model_of([])
    last = {**model.network["spiking"][-1], "reset": "value"}
    network = {"spiking": [*layers, {**model.network["spiking"][0], "inputs": ["two"]}, last]}
    model = replace(model, network=network, weights=weights)
    with pytest.raises(NotImplementedError, match=r"differ in `dt` \(0\.0001, 0\.001\)"):
        to_nir(model)


def test_refused_arguments():
    with pytest.raises(ValueError, match="`polarity` must be off_first or on_first, got 'both'"):
        to_nir(model_of([]), polarity="both")
