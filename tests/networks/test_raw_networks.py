"""Networks of raw outputs: their names from torch and ONNX, their files, what is refused."""

from collections import OrderedDict
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
import tnt_reference
import torch
from made import random_model, raw_model
from networks.small import SMALL
from torch import nn

from async_tnt import CompiledNetwork, Model, TNTConfig, load_model
from async_tnt.networks import to_onnx
from async_tnt.networks.layers.conversion_check import compare
from async_tnt.networks.torch.from_torch import layers_from_torch


class Flow(NamedTuple):
    x: torch.Tensor
    scales: list


class Net(nn.Module):
    """A network that returns what `answer` makes of three tensors."""

    def __init__(self, answer):
        super().__init__()
        self.first = nn.Conv2d(2, 4, 3, padding=1)
        self.second = nn.Conv2d(4, 3, 3, stride=2)
        self.last = nn.Linear(4, 2)
        self.answer = answer

    def forward(self, x):
        a = self.first(x)
        b = torch.relu(a)
        return self.answer(a, self.second(b), self.last(b.mean((2, 3))))


ANSWERS = {
    "a tensor": (lambda a, b, c: b, ["output"]),
    "a tuple": (lambda a, b, c: (a, b, c), ["output.0", "output.1", "output.2"]),
    "a list in a dictionary": (
        lambda a, b, c: {"flow": a, "scales": [b, (c,)]},
        ["flow", "scales.0", "scales.1.0"],
    ),
    "an ordered dictionary": (lambda a, b, c: OrderedDict(out=b, aux=a), ["out", "aux"]),
    "a named tuple": (lambda a, b, c: Flow(a, [b, c]), ["x", "scales.0", "scales.1"]),
    "one in a named tuple": (lambda a, b, c: (Flow(x=c, scales=[a]), b), None),
    "the same twice": (lambda a, b, c: (a, a), ["output.0", "output.1"]),
    "none beside": (lambda a, b, c: (b, None), ["output.0"]),
    "number keys": (lambda a, b, c: {1: a, 2: b}, ["output.1", "output.2"]),
}


def numbers_of(value):
    """The tensors in a value, in order, as arrays."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (tuple, list)):
        return [array for part in value for array in numbers_of(part)]
    return [] if value is None else [value.detach().numpy()]


@pytest.mark.parametrize("kind", ANSWERS)
def test_a_module_may_return_tensors_in_any_order_and_nesting(kind, tmp_path):
    answer, names = ANSWERS[kind]
    torch.manual_seed(0)
    module = Net(answer).eval()
    model = Model.from_torch(module, SMALL)
    if names is None:
        names = ["output.0.x", "output.0.scales.0", "output.1"]
    assert list(model.outputs) == names and model.classes == ()
    assert model.places is None and not model.has_sizes
    volume = np.random.default_rng(0).normal(size=SMALL.shape).astype(np.float32)
    expected = [array[0] for array in numbers_of(module(torch.tensor(volume)[None]))]
    assert list(model.output_shapes.values()) == [array.shape for array in expected]
    for one in (model, load_model(model.save(tmp_path / "m.safetensors"))):
        assert one.outputs == model.outputs
        for array, wanted in zip(CompiledNetwork(one)(volume), expected, strict=True):
            np.testing.assert_allclose(array, wanted, atol=1e-5)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_onnx_file_of_several_outputs_keeps_their_names(tmp_path):
    pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")
    torch.manual_seed(0)
    module = Net(lambda a, b, c: (b, a, c)).eval()
    path = tmp_path / "theirs.onnx"
    volume = np.random.default_rng(0).normal(size=SMALL.shape).astype(np.float32)
    example = torch.tensor(volume)[None]
    names = ["small", "large", "vector"]
    torch.onnx.export(module, (example,), path, output_names=names, dynamo=False)
    model = load_model(path, config=SMALL)
    assert list(model.outputs) == names
    ours = tmp_path / "ours.onnx"
    ours.write_bytes(to_onnx(model).SerializeToString())
    again = load_model(ours)
    assert (again.outputs, again.config) == (model.outputs, SMALL)
    for one in (model, again):
        for array, wanted in zip(CompiledNetwork(one)(volume), module(example), strict=True):
            np.testing.assert_allclose(array, wanted[0].detach().numpy(), atol=1e-5)
    with pytest.raises(ValueError, match="`classes` are for a network with one output; leave them"):
        load_model(path, config=SMALL, classes=["a", "b"])


def test_layers_of_the_reference_with_outputs_are_read_as_they_are():
    model = raw_model(SMALL)
    module = tnt_reference.LayerNetwork(
        model.network["classifier"], model.weights, list(model.outputs.values())
    )
    again = Model.from_torch(module, SMALL)
    assert again.network == model.network
    assert list(again.outputs.values()) == list(model.outputs.values())


def test_layers_that_no_output_needs_are_left_out():
    read = layers_from_torch(Net(lambda a, b, c: a), SMALL.shape)
    assert [layer["name"] for layer in read.layers] == ["first"]
    assert read.weights.keys() == {"first.weight", "first.bias"}


def test_an_output_inside_the_network_has_its_own_numbers():
    """Although an activation follows, which could have become part of its step."""
    torch.manual_seed(0)
    module = Net(lambda a, b, c: {"linear": a, "positive": b}).eval()
    network = CompiledNetwork(Model.from_torch(module, SMALL))
    linear, small = network(np.ones(SMALL.shape, np.float32))
    assert linear.min() < 0 and small.shape == (3, 2, 2)


def test_the_volume_itself_may_be_an_output(tmp_path):
    class Both(nn.Module):
        def __init__(self):
            super().__init__()
            self.net = Net(lambda a, b, c: b)

        def forward(self, x):
            return x, self.net(x)

    model = Model.from_torch(Both(), SMALL)
    volume = np.random.default_rng(0).normal(size=SMALL.shape).astype(np.float32)
    for one in (model, load_model(model.save(tmp_path / "m.safetensors"))):
        same, _ = CompiledNetwork(one)(volume)
        np.testing.assert_array_equal(same, volume)


def test_outputs_for_another_sensor():
    large = raw_model(SMALL).for_sensor((90, 80))
    assert large.output_shapes == {"flow": (2, 60, 50), "half": (3, 30, 25), "mean": (3,)}


def test_a_model_says_which_outputs_it_has_in_one_line():
    outputs = "flow 2x6x5, half 3x3x3, mean 3"
    assert repr(raw_model(SMALL)) == f"Model({outputs}, 9x8 -> 2x6x5, 2 conv, 90 weights)"


def test_a_model_keeps_its_outputs_whatever_becomes_of_the_mapping_it_was_made_of():
    model = raw_model(SMALL)
    given = dict(model.outputs)
    again = replace(model, outputs=given)
    given.clear()
    assert again.outputs == model.outputs


def test_outputs_that_were_answered_are_not_changed_by_the_next_call():
    network = CompiledNetwork(raw_model(SMALL))
    first = network(np.ones(SMALL.shape, np.float32))
    kept = [array.copy() for array in first]
    second = network(np.zeros(SMALL.shape, np.float32))
    for array, before, after in zip(first, kept, second, strict=True):
        np.testing.assert_array_equal(array, before)
        assert not np.array_equal(array, after)


def test_what_is_neither_or_both_is_refused():
    model = raw_model(SMALL)
    parts = {"network": model.network, "outputs": model.outputs}
    with pytest.raises(ValueError, match="`classes` are for a network of logits, and `outputs`"):
        Model(SMALL, model.weights, ("a", "b"), **parts)
    with pytest.raises(ValueError, match="`classes` must hold at least one name, or `outputs` be"):
        Model(SMALL, model.weights, network=model.network)
    with pytest.raises(TypeError, match="`outputs` must map names to names of layers"):
        Model(SMALL, model.weights, network=model.network, outputs=["flow"])
    with pytest.raises(TypeError, match="`outputs` must map names to names of layers"):
        Model(SMALL, model.weights, network=model.network, outputs={"flow": 3})
    with pytest.raises(ValueError, match="`outputs` must have names that can be printed"):
        Model(SMALL, model.weights, network=model.network, outputs={"": "flow"})
    with pytest.raises(ValueError, match="no layer is named 'flows', which is an output"):
        Model(SMALL, model.weights, network=model.network, outputs={"flow": "flows"})
    flat = nn.Sequential(nn.Conv2d(2, 3, 3), nn.Flatten())
    with pytest.raises(NotImplementedError, match="'1' is an output, and a flattened map"):
        Model.from_torch(flat, SMALL)
    with pytest.raises(ValueError, match="a network must have at least one layer"):
        Model.from_torch(nn.Identity(), SMALL, ["a"])
    with pytest.raises(NotImplementedError, match="must return a tensor, got none"):
        Model.from_torch(Net(lambda a, b, c: None), SMALL)
    with pytest.raises(ValueError, match="are for a network with one output; leave them out"):
        Model.from_torch(Net(lambda a, b, c: (a, c)), SMALL, ["a", "b"])
    with pytest.raises(ValueError, match="a model of raw outputs has no logits"):
        _ = model.logits_shape
    assert random_model(SMALL).outputs == {} == random_model(SMALL).output_shapes


def test_a_refused_module_names_a_way_that_there_is():
    with pytest.raises(NotImplementedError) as raised:
        Model.from_torch(nn.Sequential(nn.Conv2d(2, 3, 3), nn.Softmax(1)), SMALL)
    assert str(raised.value).endswith(
        "; volumes(source, config) yields the volumes for a network of any kind"
    )


@pytest.mark.parametrize(
    "changes", [{"outputs": "[]"}, {"outputs": '{"a": 1}'}, {"outputs": "{"}, {"outputs": "{}"}]
)
def test_damaged_outputs_in_a_file_are_told(changes, tmp_path):
    from async_tnt.networks.models.model_file import checksum_of, tensor_bytes

    model = raw_model(TNTConfig())
    path = model.save(tmp_path / "m.safetensors")
    from safetensors import safe_open

    with safe_open(path, "numpy") as file:
        metadata = file.metadata() | changes
    metadata["sha256"] = checksum_of(model.weights, metadata)
    path.write_bytes(tensor_bytes(model.weights, metadata))
    with pytest.raises(ValueError, match=r"m\.safetensors holds a damaged model: [^\n]*$"):
        load_model(path)


def alias_then_in_place(change):
    """A module that changes a volume in place under a second name."""

    class Aliased(nn.Module):
        def __init__(self):
            super().__init__()
            self.first = nn.Conv2d(2, 4, 3, padding=1)

        def forward(self, x):
            a = self.first(x)
            b = a
            b = change(b)
            return a + b.relu()

    torch.manual_seed(0)
    return Aliased().eval()


def add_to(b):
    b += 1
    return b


def subtract_from(b):
    b -= 1
    return b


def multiply(b):
    b *= 2
    return b


def divide(b):
    b /= 2
    return b


@pytest.mark.parametrize("change", [add_to, subtract_from, multiply, divide])
def test_a_change_in_place_holds_for_every_name_of_a_tensor(change):
    module = alias_then_in_place(change)
    volume = np.random.default_rng(0).normal(size=SMALL.shape).astype(np.float32)
    with torch.no_grad():
        expected = module(torch.tensor(volume)[None])[0].numpy()
    try:
        model = Model.from_torch(module, SMALL)
    except NotImplementedError as error:
        assert "in place" in str(error)
        return
    (found,) = CompiledNetwork(model)(volume)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def beside_large(n_small, factor):
    """A network with large numbers beside small ones, which are `factor` times as large as told."""

    def network(volume):
        small = np.full((n_small, 3, 3), 1e-3)
        return [np.concatenate([np.full((2, 3, 3), 1e3), factor * small]), factor * small]

    return network


def test_a_small_channel_beside_a_large_one_is_compared_by_itself():
    compare(beside_large(1, 1.0), beside_large(1, 1 + 1e-5), SMALL.shape, is_raw=True)
    with pytest.raises(ValueError, match="its layers compute other numbers"):
        compare(beside_large(1, 1.0), beside_large(1, 1.1), SMALL.shape, is_raw=True)


@pytest.mark.parametrize(("rest", "is_same"), [(0.5e-6, True), (2e-6, False)])
def test_what_is_left_where_numbers_cancel_may_be_a_billionth_of_the_largest(rest, is_same):
    """In a channel of zeros, beside one of 1000."""

    def network(volume, rest=0.0):
        return [np.stack([np.full((3, 3), 1e3), np.full((3, 3), rest)])]

    expected = nullcontext()
    if not is_same:
        expected = pytest.raises(ValueError, match="its layers compute other numbers")
    with expected:
        compare(network, partial(network, rest=rest), SMALL.shape, is_raw=True)


def test_raw_outputs_must_have_the_shape_of_their_layers():
    def turned(volume):
        return [array.transpose(1, 2, 0) for array in beside_large(1, 1.0)(volume)]

    with pytest.raises(ValueError, match=r"numbers of shape \(3, 3, 3\)|its layers \("):
        compare(turned, beside_large(2, 1.0), SMALL.shape, is_raw=True)


def test_two_outputs_of_one_name_are_refused():
    module = Net(lambda a, b, c: {"flow.0": a, "flow": [b]})
    with pytest.raises(NotImplementedError, match=r"two outputs of one name, 'flow\.0',"):
        Model.from_torch(module, SMALL)


def test_a_name_that_cannot_be_printed_is_refused():
    with pytest.raises(ValueError, match="`outputs` must have names that can be printed"):
        Model.from_torch(Net(lambda a, b, c: {"a\nb": a}), SMALL)


@pytest.mark.parametrize(
    "answer",
    [
        lambda a, b, c: a.chunk(0, 1)[0],
        lambda a, b, c: a.split(0, 1)[0],
        lambda a, b, c: a.view(0, -1),
        lambda a, b, c: a[:, :, :: a.dim() - 4],
        lambda a, b, c: a.permute(0, 1, 2, 9),
        lambda a, b, c: a.mean((2, 7)),
        lambda a, b, c: torch.cat([a, "b"], 1),
    ],
)
def test_arguments_that_torch_refuses_are_refused_in_one_line(answer):
    with pytest.raises(NotImplementedError) as raised:
        Model.from_torch(Net(answer), SMALL)
    assert "\n" not in str(raised.value)
    assert str(raised.value).endswith("yields the volumes for a network of any kind")


class NormOfFar(nn.Module):
    """A norm of numbers that are far from zero, in comparison with their differences."""

    def __init__(self, norm):
        super().__init__()
        self.norm = norm

    def forward(self, x):
        if isinstance(self.norm, nn.LayerNorm):
            return self.norm((x + 1000).permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        return self.norm(x + 1000)


@pytest.mark.parametrize("norm", [nn.GroupNorm(1, 6), nn.GroupNorm(3, 6), nn.LayerNorm(6)])
def test_a_norm_of_numbers_far_from_zero_is_exact(norm):
    """Torch's own has errors of 4e-5 to 2e-4 here, and one mean less would have 1e-4."""
    config = SMALL.replace(bins=6)
    module = NormOfFar(norm).eval()
    volume = np.random.default_rng(0).normal(size=config.shape).astype(np.float32)
    volume[:, 0, 0] = 0.25  # their variance is zero
    model = Model.from_torch(module, config)
    with torch.no_grad():
        shifted = torch.tensor(volume + np.float32(1000) - np.float32(1000), dtype=torch.float64)
        expected = module.double()(shifted[None])[0].numpy()
    (found,) = CompiledNetwork(model)(volume)
    assert np.abs(found - expected).max() <= 1e-6


def test_the_weights_of_a_norm_grow_with_its_channels():
    """They hold a mean for each group, not a row of weights for each channel."""

    def n_weights(channels):
        config = SMALL.replace(bins=channels)
        layers = nn.Sequential(nn.GroupNorm(1, channels), nn.Conv2d(channels, 1, 1))
        return CompiledNetwork(Model.from_torch(layers.eval(), config)).network.weights.size

    assert n_weights(800) < 2.1 * n_weights(400)
