"""Networks of other programs: torch modules and ONNX files compute what they computed there, or are refused by name."""

import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from incremental.random_networks import random_models
from model.small import SMALL, assert_same
from tnt_reference import LayerNetwork
from torch import nn
from torch.nn import functional as F

from async_tnt import CompiledClassifier, Model, TNTConfig, load_model
from async_tnt.networks import OnnxClassifier, to_onnx
from async_tnt.networks.from_torch import layers_from_torch

CONFIG = TNTConfig(sensor=(20, 18), grid=(20, 18), bins=3)
WAY_OUT = (
    "; TorchClassifier(module) runs any module, and OnnxClassifier what torch exports to ONNX, whole at every decision"
)


class Block(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.conv1, self.norm1 = nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels)
        self.conv2, self.norm2 = nn.Conv2d(channels, channels, 3, padding=1), nn.BatchNorm2d(channels, affine=False)

    def forward(self, x):
        y = F.relu(self.norm1(self.conv1(x)))
        return torch.relu(self.norm2(self.conv2(y)) + x)


class Branches(nn.Module):
    """Residual blocks, a concatenation, a mean, a view: methods, functions and modules."""

    def __init__(self):
        super().__init__()
        self.stem = nn.Sequential(nn.Conv2d(3, 6, 5, stride=2, padding=2), nn.ReLU6())
        self.block, self.pool = Block(6), nn.MaxPool2d(3, 2, 1)
        self.depthwise, self.drop = nn.Conv2d(12, 12, (3, 2), groups=12, padding="same"), nn.Dropout2d(0.5)
        self.head = nn.Linear(12, 4)

    def forward(self, x):
        x = self.pool(self.block(self.stem(x)))
        x = torch.cat([x, self.block(x).clamp(min=0.1)], 1)
        x = F.max_pool2d(F.leaky_relu(self.depthwise(x), 0.2), kernel_size=2)
        x = F.dropout(self.drop(x), training=self.training).mean((2, 3))
        return self.head(x.view(x.size(0), -1))


class Functions(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv, self.head = nn.Conv2d(3, 5, 3, dilation=2, bias=False), nn.Linear(5, 4, bias=False)

    def forward(self, x):
        x = F.hardtanh(self.conv(x), -0.5, 2.0).relu()
        x = F.avg_pool2d(x, (2, 3), stride=1, padding=1)
        x += F.relu6(x)
        return self.head(torch.flatten(F.adaptive_avg_pool2d(x, 1), 1))


MODULES = {
    "branches": Branches,
    "functions": Functions,
    "sequential": lambda: nn.Sequential(
        nn.BatchNorm2d(3),
        nn.Conv2d(3, 4, 3, groups=1),
        nn.PReLU(4),
        nn.AvgPool2d(2, divisor_override=1),
        nn.Hardtanh(-3, 3),
        nn.Identity(),
        nn.Flatten(),
        nn.Dropout(),
        nn.Linear(4 * 9 * 8, 7),
        nn.BatchNorm1d(7),
        nn.LeakyReLU(),
        nn.Linear(7, 4),
    ),
}


def module_of(name):
    torch.manual_seed(0)
    module = MODULES[name]()
    for part in module.modules():
        if isinstance(part, (nn.BatchNorm1d, nn.BatchNorm2d)):
            part.running_mean.uniform_(-1, 1)
            part.running_var.uniform_(0.5, 2)
            if part.weight is not None:
                nn.init.uniform_(part.weight, -1, 1)
                nn.init.uniform_(part.bias, -1, 1)
    return module


VOLUMES = np.random.default_rng(0).normal(size=(3, *CONFIG.shape)).astype(np.float32)


def logits_of(module):
    with torch.no_grad():
        return module.eval()(torch.tensor(VOLUMES)).numpy()


EVEN_KERNEL = pytest.mark.filterwarnings("ignore:Using padding='same' with even kernel")


@EVEN_KERNEL
@pytest.mark.parametrize("name", MODULES)
def test_a_torch_module_computes_what_it_did(name, tmp_path):
    """As in eval mode, whichever it is in; saved and loaded, too."""
    module = module_of(name).train()
    model = Model.from_torch(module, CONFIG, list("abcd"), record={"by": "hand"})
    assert module.training and (model.classes, model.record) == (tuple("abcd"), {"by": "hand"})
    state = module.state_dict()
    assert all(np.array_equal(w, state[key].numpy()) for key, w in model.weights.items())
    expected = logits_of(module)
    assert np.ptp(expected) > 0.1
    for one in (model, load_model(model.save(tmp_path / "m.safetensors"))):
        found = [CompiledClassifier(one)(volume) for volume in VOLUMES]
        assert np.abs(found - expected).max() <= 1e-5


def test_a_module_of_layers_is_those_layers():
    model = Model.from_torch(module_of("branches"), CONFIG, list("abcd"))
    again = Model.from_torch(LayerNetwork(model.layers["classifier"], model.weights), CONFIG, list("abcd"))
    assert_same(again, model)
    assert again.layers == model.layers


class Loop(nn.Module):
    def forward(self, x):
        return x if x.sum() > 0 else -x


class Two(nn.Module):
    def forward(self, x, y):
        return x + y


class Scaled(nn.Module):
    def __init__(self):
        super().__init__()
        self.factor = nn.Parameter(torch.ones(1))

    def forward(self, x):
        return torch.relu(x * self.factor)


@pytest.mark.parametrize(
    "module, message",
    [
        (nn.Sequential(nn.Conv2d(3, 4, 3), nn.GELU()), "layer '1' is a GELU, which has no compiled form"),
        (
            nn.Sequential(nn.Sequential(nn.Conv2d(3, 4, 3, padding=1, padding_mode="reflect"))),
            "layer '0.0' (Conv2d): padding_mode 'reflect' has no compiled form",
        ),
        (nn.MaxPool2d(2, ceil_mode=True), "layer '' (MaxPool2d): ceil_mode has no compiled form"),
        (nn.Sequential(nn.MaxPool2d(2, dilation=2)), "layer '0' (MaxPool2d): dilation has no compiled form"),
        (
            nn.Sequential(nn.AvgPool2d(3, padding=1, count_include_pad=False)),
            "layer '0' (AvgPool2d): padding with count_include_pad=False has no compiled form",
        ),
        (
            nn.Sequential(nn.AdaptiveAvgPool2d(2)),
            "layer '0' (AdaptiveAvgPool2d): an output size of 2, not 1, has no compiled form",
        ),
        (
            nn.Sequential(nn.Flatten(2)),
            "layer '0' (Flatten): a flatten from axis 2 to -1, not from 1 to -1, has no compiled form",
        ),
        (Scaled(), "operation 'factor' (factor) has no compiled form"),
        (Two(), "the module must take one volume, got 2 arguments"),
        (
            Loop(),
            "torch.fx cannot trace this module: symbolically traced variables cannot be used as inputs to control fl",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_module_without_a_compiled_form_is_refused_by_name(module, message):
    with pytest.raises(NotImplementedError) as raised:
        layers_from_torch(module if isinstance(module, (nn.Sequential, Loop, Two, Scaled)) else nn.Sequential(module))
    assert str(raised.value).startswith(message.replace("layer ''", "layer '0'"))
    assert str(raised.value).endswith(WAY_OUT)


class Preactivated(nn.Module):
    """The sum reads what the ReLU has changed."""

    def __init__(self, inplace=True):
        super().__init__()
        self.conv, self.relu, self.head = nn.Conv2d(3, 3, 3, padding=1), nn.ReLU(inplace), nn.Conv2d(3, 4, 1)

    def forward(self, x):
        h = self.conv(x)
        return self.head(self.relu(h) + h).mean((2, 3))


class Conv2d(nn.Conv2d):
    def forward(self, x):
        return super().forward(x) * 2


class InEvaluation(nn.Sequential):
    def forward(self, x):
        return super().forward(x if self.training else F.relu6(x))


def head(first, kind=nn.Sequential):
    return kind(first, nn.AdaptiveAvgPool2d((1, 1)), nn.Flatten())


def test_a_module_that_does_more_than_its_trace_shows_is_refused():
    torch.manual_seed(0)
    hooked = head(nn.Conv2d(3, 4, 3))
    hooked[0].register_forward_hook(lambda module, inputs, output: output + 1)
    for module in (Preactivated(), head(Conv2d(3, 4, 3)), hooked):
        with pytest.raises(
            NotImplementedError, match=r"layers compute other values than the module \(by [\d.]+\): it ch"
        ):
            Model.from_torch(module, CONFIG, list("abcd"))
    for module in (Preactivated(inplace=False), head(nn.Conv2d(3, 4, 3), InEvaluation)):
        model = Model.from_torch(module.train(), CONFIG, list("abcd"))
        assert all(part.training for part in module.modules())
        found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
        assert np.abs(found - logits_of(module)).max() <= 1e-5
    half = head(nn.Conv2d(3, 4, 3)).bfloat16()
    assert Model.from_torch(half, CONFIG, list("abcd")).weights["0.weight"].dtype == np.float32


onnx = pytest.importorskip("onnx", reason="needs onnx: pip install '.[onnx]'")


@given(random_models())
def test_every_model_can_be_exported_and_read_again(tmp_path_factory, model):
    """onnxruntime computes the same logits; the layers that come back do, too."""
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("onnx") / "m.onnx"
    path.write_bytes(to_onnx(model).SerializeToString())
    volume = np.random.default_rng(1).normal(size=model.config.shape).astype(np.float32)
    logits = CompiledClassifier(model)(volume)
    tolerance = 1e-4 * max(1, np.abs(logits).max())
    assert np.abs(OnnxClassifier(path)(volume) - logits).max() <= tolerance
    again = load_model(path)
    assert (again.config, again.classes) == (model.config, model.classes)
    assert np.abs(CompiledClassifier(again)(volume) - logits).max() <= tolerance


@EVEN_KERNEL
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", MODULES)
def test_what_torch_exports_to_onnx_computes_the_same(name, tmp_path):
    if name == "sequential":
        pytest.skip("torch does not export divisor_override")
    module, path = module_of(name), tmp_path / "net.onnx"
    torch.onnx.export(module.eval(), torch.tensor(VOLUMES[:1]), str(path), dynamo=False)
    model = load_model(path, config=CONFIG)
    assert model.classes == ("0", "1", "2", "3")
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    assert np.abs(found - logits_of(module)).max() <= 1e-5


def graph_of(nodes, constants=(), outputs=("y",)):
    make = onnx.helper
    graph = make.make_graph(
        nodes,
        "made",
        [make.make_tensor_value_info("x", 1, [1, 2, 6, 5])],
        [make.make_tensor_value_info(name, 1, ["a", "b"]) for name in outputs],
        [onnx.numpy_helper.from_array(np.asarray(w), name) for name, w in constants],
    )
    return make.make_model(graph, opset_imports=[make.make_opsetid("", 13)], ir_version=7)


def node(op, inputs="x", output="y", **attributes):
    return onnx.helper.make_node(op, inputs.split(), [output], **attributes)


def write_onnx(path, *arguments):
    path.write_bytes(graph_of(*arguments).SerializeToString())
    return path


def test_constants_matrices_and_a_softmax(tmp_path):
    """(2 x + (1, -1)) summed over places by a matrix; the softmax at the end is left out."""
    rng = np.random.default_rng(0)
    matrix, shift = rng.normal(size=(60, 3)).astype(np.float32), np.float32([[[1]], [[-1]]])
    nodes = [
        node("Mul", "two x", "a"),
        node("Add", "a shift", "b"),
        node("Reshape", "b shape", "c"),
        node("MatMul", "c matrix", "d"),
        node("Add", "d bias", "e"),
        node("Softmax", "e"),
    ]
    constants = {
        "two": np.float32(2),
        "shift": shift,
        "shape": [1, -1],
        "matrix": matrix,
        "bias": np.float32([1, 2, 3]),
    }
    path = write_onnx(tmp_path / "m.onnx", nodes, constants.items())
    model = load_model(path, config=SMALL, classes=["a", "b", "c"])
    volume = rng.normal(size=SMALL.shape).astype(np.float32)
    expected = (2 * volume + shift).reshape(-1) @ matrix + [1, 2, 3]
    assert np.abs(CompiledClassifier(model)(volume) - expected).max() <= 1e-4


@pytest.mark.parametrize(
    "nodes, constants, message",
    [
        (
            [node("Sigmoid")],
            (),
            "node 'y' (Sigmoid) has no compiled form; OnnxClassifier(path) runs any network, whole",
        ),
        ([node("Mul", "x x")], (), "node 'y' (Mul): a product of two maps has no compiled form"),
        ([node("Softmax"), node("Flatten", "y", "z")], (), "node 'y' (Softmax) has no compiled form"),
        (
            [node("Add", "x big")],
            [("big", np.ones((1, 2, 6, 5), np.float32))],
            "node 'y' (Add): a constant of shape (1, 2, 6, 5) here has no compiled form",
        ),
        ([node("Concat", "x x", axis=2)], (), "node 'y' (Concat): axis 2, not channels (1), has no compiled form"),
        (
            [node("AveragePool", kernel_shape=[3, 3], pads=[1] * 4)],
            (),
            "node 'y' (AveragePool): padding without count_in",
        ),
        (
            [node("PRelu", "x slope")],  # one for each column
            [("slope", np.ones(5, np.float32))],
            "node 'y' (PRelu): a slope of shape (5,) has no compiled form",
        ),
        (
            [node("Add", "one one")],
            [("one", np.ones(1, np.float32))],
            "node 'y' (Add): a sum other than of one map and a constant, or of maps, has no compiled form",
        ),
    ],
    ids=lambda value: value[:30] if isinstance(value, str) else "",
)
def test_a_node_without_a_compiled_form_is_refused_by_name(tmp_path, nodes, constants, message):
    path = write_onnx(tmp_path / "m.onnx", nodes, constants, [nodes[-1].output[0]])
    with pytest.raises(NotImplementedError) as raised:
        load_model(path, config=SMALL)
    assert str(raised.value).startswith(f"{path}: {message}")


def test_weights_in_a_file_beside_are_read_there(tmp_path, monkeypatch):
    """Not those of the same name in the current folder."""
    found = []
    for name, factor in (("a", 1.0), ("b", -1.0)):
        (tmp_path / name).mkdir()
        weights = [("w", np.full((60, 3), factor, np.float32))]
        proto = graph_of([node("Flatten", "x", "f"), node("MatMul", "f w")], weights)
        path = tmp_path / name / "net.onnx"
        onnx.save_model(proto, path, save_as_external_data=True, location="net.onnx.data", size_threshold=0)
        found.append(path)
    monkeypatch.chdir(tmp_path / "b")
    volume = np.ones(SMALL.shape, np.float32)
    logits = [CompiledClassifier(load_model(path, config=SMALL))(volume).tolist() for path in found]
    assert logits == [[60.0] * 3, [-60.0] * 3]


def test_what_load_model_refuses_of_onnx(tmp_path, monkeypatch):
    path = write_onnx(tmp_path / "m.onnx", [node("Flatten")])
    with pytest.raises(TypeError, match=r"does not say how events become its volume: load_model\(path, config=TNTConf"):
        load_model(path)
    ours = tmp_path / "ours.onnx"
    ours.write_bytes(to_onnx(load_model("digits")).SerializeToString())
    with pytest.raises(TypeError, match=r"^`config` and `classes` are for networks of other programs; .* has its own$"):
        load_model(ours, config=SMALL)
    with pytest.raises(TypeError, match=r"^`config` and `classes` are for \.onnx networks; .* has its own$"):
        load_model("digits", config=SMALL)
    content = bytearray(ours.read_bytes())
    content[5000] ^= 1
    ours.write_bytes(content)
    with pytest.raises(ValueError, match=r"is damaged|is not a readable"):
        load_model(ours)
    (tmp_path / "no.onnx").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="is not a readable ONNX network"):
        load_model(tmp_path / "no.onnx", config=SMALL)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ImportError, match=r"^ONNX networks are read by onnx: pip install '\.\[onnx\]' \(.*\)$"):
        load_model(path, config=SMALL)
