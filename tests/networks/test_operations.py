"""Every operation has each of its forms: shape, steps, torch, ONNX and reference.

Where one is missing, its entry says why. All forms compute the same numbers.
"""

import re

import numpy as np
import pytest
import tnt_reference.layers
import torch
from networks.foreign import onnx
from networks.random_networks import DRAWN

from async_tnt import CompiledClassifier, CompiledNetwork, Model, TNTConfig
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.layers import operations
from async_tnt.networks.layers.graph import layer_shapes
from async_tnt.networks.layers.lowering import steps_of
from async_tnt.networks.layers.operations import OPERATIONS, described
from async_tnt.networks.layers.steps import Map
from async_tnt.networks.onnx import operations as onnx_operations
from async_tnt.networks.torch import operations as torch_operations
from async_tnt.networks.torch.from_torch import layers_from_torch

CONFIG = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=4)
SHAPE = (4, 6, 5)
WINDOW = {"kernel": [3, 2], "stride": [2, 1], "padding": [1, 0, 1, 1]}
PARAMETERS = {
    "conv": {**WINDOW, "dilation": [1, 2], "groups": 2},
    "batch_norm": {"epsilon": 0.5},
    "leaky_relu": {"slope": 0.3},
    "clip": {"low": -0.5, "high": None},
    "softshrink": {"lambd": 0.3},
    "max_pool": WINDOW,
    "average_pool": WINDOW,
    "sum_pool": WINDOW,
    "inside_average_pool": WINDOW,
    "adaptive_average_pool": {"size": [4, 3]},
    "layer_norm": {"epsilon": 1e-3},
    "group_norm": {"epsilon": 1e-3, "groups": 2},
    "zero_pad": {"padding": [1, 0, 2, 1]},
    "edge_pad": {"padding": [1, 0, 2, 1]},
    "depth_to_space": {"block": 2},
    "bilinear_corners": {"block": 2},
    "expand": {"size": [3, 2]},
    "pick": {"channels": [3, 1, 1]},
}
"""Operation -> the parameters of its example."""
OTHERS = [
    # whole numbers
    ("batch_norm", {"epsilon": 1}),
    ("leaky_relu", {"slope": 2}),
    ("softshrink", {"lambd": 0}),
    # limits of 0, and none
    ("clip", {"low": 0.0, "high": 6.0}),
    ("clip", {"low": None, "high": 0}),
]
"""Operations, each with parameters other than those of its example."""
WEIGHTS = {
    "conv": {"weight": (6, 2, 3, 2), "bias": (6,)},
    "dense": {"weight": (3, 4), "bias": (3,)},
    "batch_norm": {"mean": (4,), "variance": (4,), "weight": (4,), "bias": (4,)},
    "prelu": {"slope": (4,)},
    "layer_norm": {"weight": (4,), "bias": (4,)},
    "group_norm": {"weight": (4,), "bias": (4,)},
}
"""Operation -> the shapes of its example's weights."""
ONE_PLACE = {
    "kernel": [1, 1],
    "stride": [1, 1],
    "padding": [0] * 4,
    "dilation": [1, 1],
    "groups": 1,
}
"""Parameters of a convolution of one place."""
LANDMARK_ONLY = "heatmap_centroid"
"""The operation that no classifier has."""


def layer(op, name, *inputs, **parameters):
    return {"op": op, "name": name, "inputs": list(inputs), **parameters}


def example(op, changed=None):
    """A network of the operation, between layers that make its input and logits of its output.

    `changed` are parameters other than those of `PARAMETERS`.
    """
    weights = {
        role: np.random.default_rng(0).uniform(0.1, 1.0, shape).astype(np.float32)
        for role, shape in WEIGHTS.get(op, {}).items()
    }
    parameters = PARAMETERS.get(op, {}) | (changed or {})
    if weights:
        parameters["weights"] = {role: role for role in weights}
    # the logarithm has numbers above -1 only
    layers = [layer("clip", "input", "volume", low=-0.75, high=2.0)]
    inputs = ["input"]
    if op == "dense":
        layers.append(layer("global_average_pool", "mean", "input"))
        layers.append(layer("flatten", "numbers", "mean"))
        inputs = ["numbers"]
    if op == "expand":
        layers.append(layer("global_average_pool", "mean", "input"))
        inputs = ["mean"]
    if OPERATIONS[op].n_inputs == 2:
        layers.append(layer("tanh", "other", "input"))
        inputs = ["input", "other"]
    layers.append(layer(op, "tested", *inputs, **parameters))
    if op not in ("dense", "flatten"):
        layers.append(layer("global_average_pool", "last", "tested"))
    if op == "flatten":
        weights["matrix"] = np.random.default_rng(1).normal(size=(3, 120)).astype(np.float32)
        layers.append(layer("dense", "last", "tested", weights={"weight": "matrix"}))
    return layers, weights


@pytest.mark.parametrize("op", OPERATIONS)
def test_an_operation_has_a_name_a_sentence_and_parameters_with_rules(op):
    operation = OPERATIONS[op]
    assert operation.name == op
    assert re.fullmatch(r"\S.*\.", operation.description)
    assert described(operation).startswith(f"{op}: ")
    assert described(operation) in operations.__doc__
    assert all(check.words for check in operation.parameters.values())


def test_every_table_has_every_operation():
    assert torch_operations.FORMS.keys() == OPERATIONS.keys()
    assert onnx_operations.FORMS.keys() == OPERATIONS.keys()
    assert tnt_reference.layers.OPERATIONS.keys() == OPERATIONS.keys()
    # The networks that are made at random have every operation.
    assert DRAWN | {LANDMARK_ONLY} == set(OPERATIONS)


@pytest.mark.parametrize("op", OPERATIONS)
def test_an_operation_has_ways_in_and_out_or_says_why_not(op):
    for form in torch_operations.FORMS[op]:
        assert form.modules or form.functions or form.methods
    assert torch_operations.FORMS[op]
    form = onnx_operations.FORMS[op]
    assert bool(form.read) != bool(form.not_read)
    assert (form.write is not None) != bool(form.not_written)


def test_a_name_of_torch_or_onnx_has_one_meaning():
    for form in torch_operations.ALL_FORMS:
        assert all(torch_operations.MODULES[module] is form for module in form.modules)
        assert all(torch_operations.FUNCTIONS[function] is form for function in form.functions)
        assert all(torch_operations.METHODS[method] is form for method in form.methods)
    for form in onnx_operations.FORMS.values():
        for operator, rule in form.read.items():
            assert onnx_operations.RULES[operator] is rule
            assert operator not in onnx_operations.NO_LAYERS
    known = {schema.name for schema in onnx.defs.get_all_schemas()}
    assert set(onnx_operations.RULES) <= known


@pytest.mark.parametrize(
    "op, changed", [*((op, {}) for op in OPERATIONS if op != LANDMARK_ONLY), *OTHERS]
)
def test_all_forms_of_an_operation_compute_the_same(op, changed):
    """Compiled, in ONNX, and in the reference, whose layers come back as they are."""
    layers, weights = example(op, changed)
    reference = tnt_reference.layers.LayerNetwork(layers, weights).double().eval()
    volume = np.random.default_rng(2).normal(size=SHAPE).astype(np.float32)
    with torch.no_grad():
        expected = reference(torch.tensor(volume).double()[None]).numpy().reshape(-1)
    assert np.abs(expected).min() > 0.001

    classes = [str(k) for k in range(expected.size)]
    model = Model(CONFIG, weights, classes, network={"classifier": layers})
    for classifier in (CompiledClassifier(model), OnnxClassifier(to_onnx(model))):
        assert np.abs(classifier(volume) - expected).max() <= 1e-5 * np.abs(expected).max()
    assert layers_from_torch(reference, SHAPE)[0] == layers


CHANGES = {
    "relu": ("relu", {}),
    "leaky": ("leaky_relu", {"slope": 0.5}),
    "steep": ("leaky_relu", {"slope": 3.0}),
    "prelu": ("prelu", {}),
    "below": ("clip", {"low": None, "high": -0.25}),
    "above": ("clip", {"low": 0.25, "high": None}),
    "norm": ("batch_norm", {"epsilon": 0.5}),
    "hardsigmoid": ("hardsigmoid", {}),
}
"""What may become part of the step before."""


@pytest.mark.parametrize("first", CHANGES)
def test_two_changes_of_a_step_are_done_one_after_the_other(first):
    """A step has one activation, so most second ones need another step."""
    rng = np.random.default_rng(0)
    shapes = {"kernel": (4, 4, 1, 1), **WEIGHTS["batch_norm"], **WEIGHTS["prelu"]}
    values = {name: rng.uniform(0.1, 1.0, shape).astype("f4") for name, shape in shapes.items()}
    values["kernel"] = rng.normal(size=shapes["kernel"]).astype("f4")
    volume = rng.normal(size=SHAPE).astype(np.float32)
    for second in CHANGES:
        layers = [layer("conv", "conv", "volume", weights={"weight": "kernel"}, **ONE_PLACE)]
        used = {"kernel"}
        for name, (op, parameters) in (("one", CHANGES[first]), ("two", CHANGES[second])):
            roles = {role: role for role in WEIGHTS.get(op, {})}
            used |= set(roles)
            fields = parameters | ({"weights": roles} if roles else {})
            layers.append(layer(op, name, layers[-1]["name"], **fields))
        weights = {name: values[name] for name in used}
        reference = tnt_reference.layers.LayerNetwork(layers, weights).double().eval()
        with torch.no_grad():
            expected = reference(torch.tensor(volume).double()[None])[0].numpy()
        model = Model(CONFIG, weights, network={"classifier": layers}, outputs={"out": "two"})
        (found,) = CompiledNetwork(model)(volume)
        np.testing.assert_allclose(found, expected, atol=1e-5, err_msg=second)


@pytest.mark.parametrize("op", ["average_pool", "sum_pool", "inside_average_pool"])
def test_padding_of_a_pooling_in_onnx(op):
    """A corner of four ones is padded to nine places: their sum, or the mean over nine or four."""
    parameters = {"kernel": [3, 3], "stride": [1, 1], "padding": [1, 1, 1, 1]}
    layers = [layer(op, "pooled", "volume", **parameters), layer("flatten", "flat", "pooled")]
    layers.append(layer("dense", "corner", "flat", weights={"weight": "first"}))
    config = TNTConfig(sensor=(5, 6), grid=(5, 6), bins=1)
    network = {"classifier": layers}
    model = Model(config, {"first": np.eye(1, 30, dtype=np.float32)}, ["a"], network=network)
    expected = {"average_pool": 4 / 9, "sum_pool": 4.0, "inside_average_pool": 1.0}[op]
    for classifier in (CompiledClassifier(model), OnnxClassifier(to_onnx(model))):
        assert classifier(np.ones((1, 6, 5), np.float32)) == pytest.approx([expected])


@pytest.mark.parametrize("op", [op for op in OPERATIONS if op != LANDMARK_ONLY])
def test_the_shape_of_an_operation_is_that_of_the_reference_and_of_its_steps(op):
    layers, weights = example(op)
    last = next(k for k, one in enumerate(layers) if one["name"] == "tested")
    layers = layers[: last + 1]
    tensors = {name: w.shape for name, w in weights.items()}
    shape = layer_shapes(layers, SHAPE, tensors, outputs=())["tested"]
    with torch.no_grad():
        value = tnt_reference.layers.LayerNetwork(layers, weights)(torch.zeros(1, *SHAPE))
    assert shape == tuple(value.shape[1:])
    if op != "flatten":  # whose numbers stay where they are
        _, (output,) = steps_of(layers, Map(*SHAPE), weights)
        assert shape in ((output.channels, *output.sides), (output.channels,))


def test_the_landmark_operation_is_read_from_torch():
    layers, *_ = layers_from_torch(
        torch.nn.Sequential(torch.nn.Tanh(), torch_operations.HeatmapCentroid()), (1, 6, 5)
    )
    assert [one["op"] for one in layers] == ["tanh", LANDMARK_ONLY]


def test_functions_at_their_borders():
    """log(0) is -inf, and the logarithm of less is no number, as in torch."""
    layers = [
        layer("conv", "number", "volume", weights={"weight": "zeros", "bias": "bias"}, **ONE_PLACE),
        layer("log1p", "log", "number"),
        layer("global_average_pool", "mean", "log"),
        layer("flatten", "logits", "mean"),
    ]
    weights = {
        "zeros": np.zeros((3, 4, 1, 1), np.float32),
        "bias": np.array([-1.0, -2.0, 0.0], np.float32),
    }
    model = Model(CONFIG, weights, ["a", "b", "c"], network={"classifier": layers})
    found = CompiledClassifier(model)(np.zeros(SHAPE, np.float32))
    assert found[0] == -np.inf and np.isnan(found[1]) and found[2] == 0
