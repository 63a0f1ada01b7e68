"""The layers in a model file.

A layer that does not fit, or cannot be run, is refused with its name.
"""

import copy
import json
import re

import numpy as np
import pytest
from made import thesis_network
from networks.small import SMALL, WITH_REGRESSOR, changed, small_model, write_file
from tnt_reference import Classifier, LandmarkRegressor, LayerNetwork

from async_tnt import CompiledClassifier, Model, load_model
from async_tnt.networks.layers import graph
from async_tnt.networks.layers.graph import layer_shapes
from async_tnt.networks.layers.lowering import steps_of
from async_tnt.networks.layers.steps import Map


def test_the_thesis_layers_are_those_of_the_references_modules():
    import torch

    model = small_model(seed=1, config=WITH_REGRESSOR)
    channels, height, width = model.config.shape
    classifier = Classifier(channels, (width, height), 3, (2, 3, 4))
    classifier.load_state_dict(
        {
            name: torch.tensor(w)
            for name, w in model.weights.items()
            if not name.startswith("regressor.")
        }
    )
    volume = torch.randn(2, channels, height, width, generator=torch.Generator().manual_seed(0))
    layers = {name: LayerNetwork(part, model.weights) for name, part in model.network.items()}
    assert torch.equal(layers["classifier"](volume), classifier(volume))
    even = LandmarkRegressor(channels, (width, height), 5)
    weights = {f"regressor.{name}": w.detach().numpy() for name, w in even.state_dict().items()}
    landmarks = LayerNetwork(model.network["regressor"], weights)(volume)
    assert torch.allclose(landmarks, even(volume), atol=1e-12)


def window(kernel, padding=0, stride=1):
    return {"kernel": [kernel] * 2, "padding": [padding] * 4, "stride": [stride] * 2}


def insert(place, **layer):
    return lambda layers: layers.insert(place, layer)


def update(place, **parameters):
    return lambda layers: layers[place].update(parameters)


CANNOT_RUN = [
    (
        update(1, op="mish"),
        "layer 'relu1' is a 'mish'; this release knows conv, dense, batch_norm, ",
    ),
    (update(1, inplace=True), "layer 'relu1' (relu) has inplace"),
]
DAMAGED = [
    (lambda layers: layers.clear(), "a network must have at least one layer"),
    (
        update(1, name=3),
        "layer 1 must be an object with `name` and `op`, got {'inputs': ['conv1'], 'name': 3, "
        "'op': ",
    ),
    (update(1, name="conv1"), "layer 'conv1' (relu): another layer has this name"),
    (update(1, inputs=["conv7"]), "layer 'relu1' (relu): no earlier layer is named 'conv7'"),
    (update(1, inputs=["conv1", "conv1"]), "layer 'relu1' (relu): must have 1 input, got 2"),
    (
        insert(1, op="add", name="sum", inputs=["conv1"]),
        "layer 'sum' (add): must have 2 inputs or more, got 1",
    ),
    (
        update(1, inputs="conv1"),
        "layer 'relu1' (relu): `inputs` must be a list of names, got 'conv1'",
    ),
    (
        insert(4, op="add", name="sum", inputs=["conv2", "pool1"]),
        "layer 'sum' (add): its inputs must have one shape, ",
    ),
    (lambda layers: layers[0].pop("stride"), "layer 'conv1' (conv): must have stride"),
    (
        update(0, stride=[0, 1]),
        "layer 'conv1' (conv): `stride` must be a list of 2 whole numbers from 1 on, got [0, 1",
    ),
    (
        update(0, stride=[True, True]),
        "layer 'conv1' (conv): `stride` must be a list of 2 whole numbers from 1 on, got [True, T",
    ),
    (
        update(0, kernel=[9, 9]),
        "layer 'conv1' (conv): its kernel reaches over 9 places, its input has 8 with the padd",
    ),
    (
        update(0, kernel=[1, 1]),
        "layer 'conv1' (conv): its weight must have shape (2, 2, 1, 1) here, got (2, 2, 3, 3)",
    ),
    (
        update(0, padding=[0, 16383, 0, 16382]),
        "layer 'conv1' (conv): its map (2, 4, 32768) must have sides below",
    ),
    (
        update(0, groups=3),
        "layer 'conv1' (conv): 3 groups must divide its 2 channels and 2 filters",
    ),
    (
        update(0, weights={"bias": "conv1.bias"}),
        "layer 'conv1' (conv): `weights` must be weight, bias, got bias",
    ),
    (
        update(
            0,
            weights={
                role: f"conv1.{role.replace('slope', 'bias')}"
                for role in ("weight", "bias", "slope")
            },
        ),
        "layer 'conv1' (conv): `weights` must be weight, bias, got ",
    ),
    (
        update(2, padding=[2, 0, 0, 0]),
        "layer 'pool1' (average_pool): padding [2, 0, 0, 0] must be less than kernel [2",
    ),
    (
        insert(1, op="clip", name="c", inputs=["conv1"], low=2, high=1),
        "layer 'c' (clip): `low` must be at most `high`",
    ),
    (
        lambda layers: layers.append({"op": "heatmap_centroid", "name": "h", "inputs": ["volume"]}),
        "layer 'h' (heatmap_c",
    ),
]


def test_a_clip_between_equal_limits_gives_them(tmp_path):
    network = copy.deepcopy(thesis_network(SMALL))
    last = network["classifier"][-1]["name"]
    network["classifier"].append(
        {"name": "all", "op": "clip", "inputs": [last], "low": 0.25, "high": 0.25}
    )
    model = Model(SMALL, changed(), ("a", "b", "c"), network=network)
    for one in (model, load_model(model.save(tmp_path / "m.safetensors"))):
        assert CompiledClassifier(one)(np.ones(SMALL.shape, np.float32)).tolist() == [0.25] * 3


@pytest.mark.parametrize("edit, message", CANNOT_RUN + DAMAGED)
def test_what_does_not_fit_is_one_error_that_names_the_layer(tmp_path, edit, message):
    """The layers come from Python, and from a file with a valid checksum."""
    network = copy.deepcopy(thesis_network(SMALL))
    path = tmp_path / "m"
    edit(network["classifier"])
    cannot_run = (edit, message) in CANNOT_RUN
    with pytest.raises(
        NotImplementedError if cannot_run else ValueError, match=f"^{re.escape(message)}"
    ):
        Model(SMALL, changed(), ("a", "b", "c"), network=network)
    write_file(path, changed(), network=json.dumps(network))
    kind = "a network that this release cannot run" if cannot_run else "a damaged model"
    with pytest.raises(ValueError, match=f"^{re.escape(f'{path} holds {kind}: {message}')}"):
        load_model(path)


@pytest.mark.parametrize(
    "op, parameters, message",
    [
        ("clip", {"low": np.nan, "high": None}, "`low` must be a number, or null, got nan"),
        ("clip", {"low": None, "high": 1 << 63}, "`high` must be a number, or null, got 9223"),
        ("clip", {"low": None, "high": True}, "`high` must be a number, or null, got True"),
        ("leaky_relu", {"slope": np.inf}, "`slope` must be a finite number, got inf"),
        ("leaky_relu", {"slope": np.nan}, "`slope` must be a finite number, got nan"),
        ("leaky_relu", {"slope": None}, "`slope` must be a finite number, got None"),
        ("depth_to_space", {"block": 0}, "`block` must be a positive whole number, got 0"),
        ("depth_to_space", {"block": 1.0}, "`block` must be a positive whole number, got 1.0"),
    ],
)
def test_parameters_have_their_kind_of_number(op, parameters, message):
    layers = chain((op, parameters))
    where = f"layer '{op} 0' ({op}): "
    with pytest.raises(ValueError, match=f"^{re.escape(where + message)}"):
        layer_shapes(layers, (4, 6, 5), {})


SOURCES = [
    {"op": "max_pool", "name": "pooled", "inputs": ["volume"], **window(2, 0, 2)},
    {"op": "pick", "name": "first", "inputs": ["volume"], "channels": [0]},
    {"op": "pick", "name": "two", "inputs": ["volume"], "channels": [0, 1]},
    {"op": "global_average_pool", "name": "place", "inputs": ["volume"]},
    {"op": "flatten", "name": "four", "inputs": ["place"]},
    {"op": "dense", "name": "one", "inputs": ["four"], "weights": {"weight": "1 x 4"}},
]
"""Inputs (4, 3, 2), (1, 6, 5), (2, 6, 5), (4, 1, 1), (4,) and (1,), of a volume (4, 6, 5)."""

TENSORS = {
    "1": (1,),
    "3": (3,),
    "4": (4,),
    "0 x 4": (0, 4),
    "1 x 4": (1, 4),
    "3 x 4": (3, 4),
    "3 x 5": (3, 5),
    "()": (),
}
"""Name -> shape of weights."""


def weights(**names):
    return {"weights": names}


@pytest.mark.parametrize(
    ("op", "inputs", "parameters", "shape"),
    [
        ("add", ["volume"] * 3, {}, (4, 6, 5)),
        ("add", ["place", "volume"], {}, (4, 6, 5)),
        ("add", ["first", "place"], {}, (4, 6, 5)),
        ("multiply", ["volume", "first"], {}, (4, 6, 5)),
        ("multiply", ["four", "four"], {}, (4,)),
        ("concat", ["volume", "first"], {}, (5, 6, 5)),
        ("concat", ["one", "four"], {}, (5,)),
        ("pick", ["volume"], {"channels": [3]}, (1, 6, 5)),
        ("depth_to_space", ["volume"], {"block": 2}, (1, 12, 10)),
        ("expand", ["place"], {"size": [3, 2]}, (4, 3, 2)),
        ("heatmap_centroid", ["first"], {}, (2,)),
        ("dense", ["four"], weights(weight="3 x 4", bias="3"), (3,)),
        ("prelu", ["volume"], weights(slope="1"), (4, 6, 5)),
        ("prelu", ["volume"], weights(slope="4"), (4, 6, 5)),
        ("max_pool", ["volume"], window(2) | {"stride": [32767, 1]}, (4, 1, 4)),
        ("bilinear_corners", ["volume"], {"block": 64}, (4, 384, 320)),
        ("softshrink", ["volume"], {"lambd": 0}, (4, 6, 5)),
    ],
)
def test_the_shape_of_what_fits(op, inputs, parameters, shape):
    layer = {"op": op, "name": "tested", "inputs": inputs, **parameters}
    assert layer_shapes([*SOURCES, layer], (4, 6, 5), TENSORS)["tested"] == shape


NO_MAP = "its input must be a map (C, H, W), got (4,)"
ONE_SHAPE = "its inputs must have one shape"


@pytest.mark.parametrize(
    ("op", "inputs", "parameters", "message"),
    [
        ("add", ["volume", "place", "place"], {}, f"{ONE_SHAPE}, got (4, 6, 5), (4, 1, 1), (4, "),
        ("add", ["volume", "pooled"], {}, f"{ONE_SHAPE}, or one place or channel for all, got (4"),
        ("add", ["volume", "two"], {}, f"{ONE_SHAPE}, or one place or channel for all, got (4, 6"),
        ("multiply", ["four", "place"], {}, f"{ONE_SHAPE}, or one place or channel for all, got ("),
        ("multiply", ["four", "one"], {}, f"{ONE_SHAPE}, or one place or channel for all, got (4,"),
        ("multiply", ["volume"] * 3, {}, "must have 2 inputs, got 3"),
        ("concat", ["volume", "pooled"], {}, "its inputs must differ in their channels only, got "),
        (
            "concat",
            ["four", "place"],
            {},
            "its inputs must differ in their channels only, got (4,)",
        ),
        ("pick", ["volume"], {"channels": [0, 4]}, "its channels must be below 4, got 4"),
        (
            "pick",
            ["volume"],
            {"channels": []},
            "`channels` must be a list of at least one whole nu",
        ),
        (
            "pick",
            ["volume"],
            {"channels": [-1]},
            "`channels` must be a list of at least one whole ",
        ),
        ("depth_to_space", ["volume"], {"block": 4}, "blocks of 4 x 4 must divide its 4 channels"),
        ("expand", ["volume"], {"size": [3, 2]}, "its input must be a map of one place, got (4, 6"),
        ("expand", ["four"], {"size": [3, 2]}, "its input must be a map of one place, got (4,)"),
        ("heatmap_centroid", ["two"], {}, "its input must be a heatmap (1, H, W), got (2, 6, 5)"),
        ("heatmap_centroid", ["one"], {}, "its input must be a heatmap (1, H, W), got (1,)"),
        ("dense", ["volume"], weights(weight="3 x 4"), "its input must be flat, got (4, 6, 5): a "),
        ("dense", ["four"], weights(weight="0 x 4"), "it must have at least one unit"),
        ("dense", ["four"], weights(weight="()"), "it must have at least one unit"),
        (
            "dense",
            ["four"],
            weights(weight="3 x 5"),
            "its weight must have shape (3, 4) here, got ",
        ),
        (
            "dense",
            ["four"],
            weights(weight="3 x 4", bias="4"),
            "its bias must have shape (3,) here",
        ),
        ("prelu", ["volume"], weights(slope="3"), "its slope must have shape (4,) here, got (3,)"),
        (
            "prelu",
            ["volume"],
            weights(slope=4),
            "`weights` must map roles to names of tensors, got",
        ),
        ("prelu", ["volume"], weights(slope="5"), "no tensor is named '5'"),
        ("relu", [3], {}, "`inputs` must be a list of names, got [3]"),
        (
            "layer_norm",
            ["volume"],
            {"epsilon": 0, **weights(bias="3")},
            "its bias must have shape (",
        ),
        (
            "group_norm",
            ["volume"],
            {"epsilon": 0, "groups": 3, **weights()},
            "its 3 groups must divide its 4 channels",
        ),
        ("group_norm", ["four"], {"epsilon": 0, "groups": 2, **weights()}, NO_MAP),
        ("depth_to_space", ["four"], {"block": 2}, NO_MAP),
        ("bilinear_corners", ["four"], {"block": 2}, NO_MAP),
        ("zero_pad", ["four"], {"padding": [1, 0, 0, 0]}, NO_MAP),
        ("edge_pad", ["four"], {"padding": [1, 0, 0, 0]}, NO_MAP),
        ("max_pool", ["four"], window(1), NO_MAP),
        ("global_average_pool", ["four"], {}, NO_MAP),
        ("adaptive_average_pool", ["four"], {"size": [1, 1]}, NO_MAP),
        # the rules of values
        (
            "max_pool",
            ["volume"],
            window(2) | {"stride": [32768, 1]},
            "`stride` must be a list of 2 whole numbers from 1 on, got [32768, 1]",
        ),
        (
            "zero_pad",
            ["volume"],
            {"padding": [0, 0, 0, -1]},
            "`padding` must be a list of 4 whole numbers from 0 on, got [0, 0, 0, -1]",
        ),
        (
            "bilinear_corners",
            ["volume"],
            {"block": 65},
            "`block` must be a whole number from 1 to 64, got 65",
        ),
        (
            "softshrink",
            ["volume"],
            {"lambd": -1e-9},
            "`lambd` must be a finite number from 0 on, got -1e-09",
        ),
    ],
)
def test_what_does_not_fit_an_operation_is_refused(op, inputs, parameters, message):
    layer = {"op": op, "name": "tested", "inputs": inputs, **parameters}
    where = f"layer 'tested' ({op}): "
    with pytest.raises(ValueError, match=f"^{re.escape(where + message)}"):
        layer_shapes([*SOURCES, layer], (4, 6, 5), TENSORS)


def test_limits_may_be_infinite():
    layers = chain(("clip", {"low": -np.inf, "high": np.inf}))
    assert layer_shapes(layers, (4, 6, 5), {})["clip 0"] == (4, 6, 5)


@pytest.mark.parametrize(("variance", "epsilon"), [(0.0, 0.0), (-0.5, 0.5), (-1.0, 0.5)])
def test_a_batch_norm_never_divides_by_zero(variance, epsilon):
    """A channel of several."""
    weights = {"mean": np.zeros(3), "variance": np.array([1.0, variance, 1.0])}
    layers = chain(
        ("batch_norm", {"epsilon": epsilon, "weights": {role: role for role in weights}}),
        ("global_average_pool", {}),
    )
    message = r"^layer 'batch_norm 0' \(batch_norm\): variance \+ epsilon must be positive$"
    with pytest.raises(ValueError, match=message):
        Model(SMALL.replace(bins=3), weights, list("abc"), network={"classifier": layers})


def test_a_classifier_is_no_landmark_network():
    """Although its two numbers would do for two classes."""
    network = {"classifier": chain(("heatmap_centroid", {}))}
    message = "a heatmap_centroid must be the last layer of a regressor, and nowhere else"
    with pytest.raises(ValueError, match=f"^{message}$"):
        Model(SMALL.replace(bins=1), {}, ["a", "b"], network=network)


@pytest.mark.parametrize(
    ("channels", "filters", "groups"), [(3, 4, 2), (4, 3, 2), (4, 2, 4), (4, 0, 2), (4, 0, 1)]
)
def test_groups_divide_channels_and_filters(channels, filters, groups):
    op, parameters = conv()
    layers = chain((op, parameters | {"groups": groups}))
    shapes = {"w": (filters, channels // groups, 1, 1)}
    message = f"{groups} groups must divide its {channels} channels and {filters} filters"
    with pytest.raises(ValueError, match=rf"^layer 'conv 0' \(conv\): {message}$"):
        layer_shapes(layers, (channels, 6, 5), shapes)


@pytest.mark.parametrize("side", range(4))
def test_the_padding_of_a_pooling_is_less_than_its_kernel_on_each_side(side):
    """The kernel has 4 rows and 2 columns."""
    kernel = [4, 2]
    padding = [0, 0, 0, 0]
    padding[side] = kernel[side % 2] - 1
    parameters = {"kernel": kernel, "stride": [1, 1], "padding": padding}
    assert layer_shapes(chain(("max_pool", parameters)), (1, 6, 5), {})["max_pool 0"]
    padding[side] += 1
    message = f"padding {padding} must be less than kernel {kernel}"
    with pytest.raises(ValueError, match=re.escape(message)):
        layer_shapes(chain(("max_pool", parameters)), (1, 6, 5), {})


BATCH_NORM = ("mean", "variance", "weight", "bias")


@pytest.mark.parametrize("role", BATCH_NORM)
def test_a_batch_norm_has_a_number_for_each_channel(role):
    """Not one for all, which NumPy would take."""
    layers = chain(("batch_norm", {"epsilon": 0.5, "weights": {role: role for role in BATCH_NORM}}))
    shapes = dict.fromkeys(BATCH_NORM, (4,))
    assert layer_shapes(layers, (4, 6, 5), shapes)["batch_norm 0"] == (4, 6, 5)
    message = f"layer 'batch_norm 0' (batch_norm): its {role} must have shape (4,) here, got (1,)"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        layer_shapes(layers, (4, 6, 5), shapes | {role: (1,)})


def test_networks_that_do_not_fit_the_model():
    flat = chain(("max_pool", window(2, 0, 2)), ("flatten", {}))
    twice = {"op": "add", "name": "s", "inputs": ["flatten 1", "flatten 1"]}
    # the kernel reads as many places as the volume has
    other_heatmap = copy.deepcopy(thesis_network(WITH_REGRESSOR))
    other_heatmap["regressor"].insert(
        -1, {"op": "max_pool", "name": "p", "inputs": ["heatmap"], **window(2, 0, 2)}
    )
    other_heatmap["regressor"][-1]["inputs"] = ["p"]
    for config, network, error, message in (
        (SMALL, {}, ValueError, "`network` must hold classifier here, got "),
        (SMALL, {"classifier": 3}, TypeError, "`network` must "),
        (SMALL, [], TypeError, "`network` must "),
        (
            WITH_REGRESSOR,
            thesis_network(SMALL),
            ValueError,
            "`network` must hold classifier, regressor here, got clas",
        ),
        (
            WITH_REGRESSOR,
            other_heatmap,
            ValueError,
            "the heatmap must be of shape (1, 6, 5), as the volume, got (1, 3",
        ),
        (
            SMALL,
            {"classifier": flat},
            ValueError,
            "layer 'flatten 1' is an output, and a flattened map: a dense lay",
        ),
        (
            SMALL,
            {"classifier": [*flat, twice]},
            ValueError,
            "layer 's' (add): 'flatten 1' is a flattened map: a dense",
        ),
    ):
        with pytest.raises(error, match=f"^{re.escape(message)}"):
            Model(config, changed(config), ("a", "b", "c"), network=network)


def conv(kernel=1, padding=0, stride=1, weight="w"):
    more = {"weights": {"weight": weight}, "dilation": [1, 1], "groups": 1}
    return "conv", window(kernel, padding, stride) | more


def chain(*layers, source="volume"):
    """Each of the one before."""
    made = []
    for k, (op, parameters) in enumerate(layers):
        made.append(
            {
                "op": op,
                "name": f"{op} {k}",
                "inputs": [made[-1]["name"] if made else source],
                **parameters,
            }
        )
    return made


@pytest.mark.parametrize(
    "layers, limit, at",
    [
        ([conv(padding=8013)], "MAX_NUMBERS", "conv 0"),  # a large map
        # a megabyte of weights, many times
        ([conv(weight="shared")] * 17, "MAX_NUMBERS", "conv 15"),
        ([("max_pool", window(1700, 1699, 1700))], "MAX_NUMBERS", "max_pool 0"),  # tables of places
        # weights of each place
        ([("inside_average_pool", window(200, 199))], "MAX_NUMBERS", "inside_average_pool 0"),
        (
            [("adaptive_average_pool", {"size": [300, 300]})],
            "MAX_NUMBERS",
            "adaptive_average_pool 0",
        ),
        ([("average_pool", window(99, 98))] * 9, "MAX_PRODUCTS", "average_pool 5"),
    ],
)
def test_the_sum_of_all_layers_is_limited_and_a_program_may_raise_the_limit(
    layers, limit, at, monkeypatch
):
    shared = layers[0][1].get("weights") == {"weight": "shared"}
    shapes = {"w": (1, 1, 1, 1), "shared": (4096, 4096, 1, 1)}
    volume = (4096, 1, 1) if shared else (1, 8, 8)
    arguments = (chain(*layers), volume, shapes)
    name = at.split()[0]
    too_much = r"up to here .* [\d_]+ (numbers|multiplications), more than [\d_]+"
    advice = rf"\(a program may raise async_tnt.networks.layers.graph.{limit}\)"
    with pytest.raises(ValueError, match=rf"^layer '{at}' \({name}\): {too_much} {advice}$"):
        layer_shapes(*arguments)
    monkeypatch.setattr(graph, limit, 1 << 40)
    assert len(layer_shapes(*arguments)) == len(layers) + 1


@pytest.mark.parametrize(
    "layers, n_numbers, n_products",
    [
        # of a volume of 2 x 6 x 5 = 60 numbers
        ([("relu", {})], 60, 60),
        ([("global_average_pool", {})], 2, 60),  # it reads 60
        # 3 filters of 2 weights; 100 for the window; 2 x (8 x 7 - 6 x 5) places beside the volume
        ([conv(padding=1)], 3 * 8 * 7 + 6 + 100 + 52, 3 * 8 * 7 * 2),
        # an addition of a pooling takes as long as 16 multiplications
        ([("average_pool", window(2, 0, 2))], 2 * 3 * 2 + 400, 2 * 3 * 2 * 4 * 16),
        # four taps at each of 3 x 2 places have weights of their own: one a channel, and 16 beside
        (
            [("inside_average_pool", window(2, 0, 2))],
            2 * 3 * 2 + 400 + 4 * 3 * 2 * (2 + 16),
            2 * 3 * 2 * 4 * 16,
        ),
        # two inputs
        ([("add", {"inputs": ["volume", "volume"]})], 60, 2 * 60),
        # the sum of the layers
        ([("relu", {}), ("relu", {}), ("global_average_pool", {})], 60 + 60 + 2, 60 + 60 + 60),
    ],
)
def test_the_cost_of_a_network_by_hand(layers, n_numbers, n_products, monkeypatch):
    """It is just within the limits, which are one less then."""
    arguments = (chain(*layers), (2, 6, 5), {"w": (3, 2, 1, 1)})
    monkeypatch.setattr(graph, "MAX_NUMBERS", n_numbers)
    monkeypatch.setattr(graph, "MAX_PRODUCTS", n_products)
    layer_shapes(*arguments)
    for limit, n, words in (
        ("MAX_NUMBERS", n_numbers, f"maps and weights are {n_numbers} numbers"),
        ("MAX_PRODUCTS", n_products, f"a pass has {n_products:_} multiplications"),
    ):
        with monkeypatch.context() as one_less:
            one_less.setattr(graph, limit, n - 1)
            with pytest.raises(ValueError, match=f"up to here {words}, more than {n - 1:_} "):
                layer_shapes(*arguments)


def test_small_networks_by_hand():
    """An activation that nothing reads; a pooling of the size of its map, with padding; the sum of
    a number and its activation, both read through a flatten."""
    mean = ("global_average_pool", {})
    whole = {"kernel": [6, 5], "padding": [1, 0, 1, 0], "stride": [2, 1]}
    unread = [
        *chain(mean, conv(), ("relu", {})),
        {"op": "flatten", "name": "output", "inputs": ["conv 1"]},
    ]
    pooled = chain(("average_pool", whole), mean, conv())
    both = [
        *chain(mean, conv(), ("relu", {})),
        {"op": "flatten", "name": "number", "inputs": ["conv 1"]},
        {"op": "flatten", "name": "positive", "inputs": ["relu 2"]},
        {"op": "add", "name": "sum", "inputs": ["number", "positive"]},
    ]
    for layers, logit in ((unread, -1.0), (pooled, -5 / 6), (both, -1.0)):
        model = Model(
            SMALL.replace(bins=1),
            {"w": -np.ones((1, 1, 1, 1))},
            ["a"],
            network={"classifier": layers},
        )
        assert CompiledClassifier(model)(np.ones((1, 6, 5))) == pytest.approx(logit)


def test_an_activation_behind_a_flatten_needs_no_step():
    """It becomes part of the step before the flatten, as without one."""
    mean = ("global_average_pool", {})
    n_steps = [
        len(steps_of(chain(mean, *between, ("relu", {})), Map(2, 6, 5), {})[0])
        for between in ([], [("flatten", {})])
    ]
    assert n_steps == [2, 2]


@pytest.mark.parametrize("order", [1, -1])
def test_what_one_reader_of_a_map_leaves_out_is_there_for_another(order):
    """A pooling of 4 x 4 of 6 x 5 places, and a mean of all, whichever is listed first."""
    of_map = [
        {"op": "max_pool", "name": "pool", "inputs": ["map"], **window(4, 0, 4)},
        {"op": "global_average_pool", "name": "mean", "inputs": ["map"]},
    ]
    layers = [
        {**chain(conv())[0], "name": "map"},
        *of_map[::order],
        {"op": "concat", "name": "both", "inputs": ["pool", "mean"]},
    ]
    model = Model(
        SMALL.replace(bins=1),
        {"w": np.full((1, 1, 1, 1), 2.0)},
        ["a", "b"],
        network={"classifier": layers},
    )
    volume = np.random.default_rng(0).normal(size=(1, 6, 5)).astype(np.float32)
    expected = [2 * volume[0, :4, :4].max(), 2 * volume.mean()]
    assert CompiledClassifier(model)(volume) == pytest.approx(expected, abs=1e-6)


def test_sums_of_maps_that_other_sums_widen():
    """A sum is listed before the one by which its second map gets the frame of the third, which a
    convolution reads beyond its border."""
    maps = [{**chain(conv(weight=f"w{k}"))[0], "name": name} for k, name in enumerate("abc")]
    mean = "global_average_pool"
    layers = [
        *maps,
        {"op": "add", "name": "a + b", "inputs": ["a", "b"]},
        {"op": "add", "name": "b + c", "inputs": ["b", "c"]},
        {**chain(conv(padding=3, weight="w0"), source="c")[0], "name": "beyond"},
        *({"op": mean, "name": f"{one} mean", "inputs": [one]} for one in ("a + b", "b + c")),
        {"op": mean, "name": "beyond mean", "inputs": ["beyond"]},
        {"op": "concat", "name": "all", "inputs": ["a + b mean", "b + c mean", "beyond mean"]},
    ]
    weights = {f"w{k}": np.full((1, 1, 1, 1), 2.0**k) for k in range(3)}
    model = Model(SMALL.replace(bins=1), weights, ("x", "y", "z"), network={"classifier": layers})
    volume = np.random.default_rng(0).normal(size=(1, 6, 5)).astype(np.float32)
    mean = volume.mean()
    expected = [3 * mean, 6 * mean, 4 * mean * 30 / (12 * 11)]
    assert CompiledClassifier(model)(volume) == pytest.approx(expected, abs=1e-6)


def test_maps_that_are_added_have_the_frame_of_each_other(monkeypatch):
    """Many such maps take more memory than the layers say.

    A program that is made knows so before it takes any.
    """
    many = [{**chain(conv())[0], "name": f"map {k}"} for k in range(12)]
    layers = [
        *many,
        *chain(conv(padding=60, stride=120), ("global_average_pool", {}), source="map 0"),
        {"op": "add", "name": "sum", "inputs": [layer["name"] for layer in many]},
        {**chain(("global_average_pool", {}), source="sum")[0], "name": "mean"},
        {"op": "add", "name": "last", "inputs": ["global_average_pool 1", "mean"]},
    ]
    model = Model(
        SMALL.replace(bins=1), {"w": np.ones((1, 1, 1, 1))}, ["a"], network={"classifier": layers}
    )
    assert CompiledClassifier(model)(np.ones((1, 6, 5))).shape == (1,)
    monkeypatch.setattr(graph, "MAX_NUMBERS", 1 << 16)
    with pytest.raises(
        ValueError, match=r"^the network's maps need [\d_]+ numbers, more than 2 \* 65_536"
    ) as refused:
        CompiledClassifier(model)
    n_numbers = int(re.search(r"[\d_]+", str(refused.value))[0])
    assert n_numbers % 2 == 0
    monkeypatch.setattr(graph, "MAX_NUMBERS", n_numbers // 2)
    CompiledClassifier(model)
    monkeypatch.setattr(graph, "MAX_NUMBERS", n_numbers // 2 - 1)
    with pytest.raises(ValueError, match=f"maps need {n_numbers:_} numbers"):
        CompiledClassifier(model)
