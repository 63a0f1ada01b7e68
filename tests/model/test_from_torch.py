"""Torch modules: the layers compute what the module computed, or it is refused by name."""

import numpy as np
import pytest
import torch
from model.modules import CONFIG, EVEN_KERNEL, MODULES, VOLUMES, Flat, head, logits_of, module_of
from model.small import assert_same
from tnt_reference import LayerNetwork
from torch import nn
from torch.nn import functional as F

from async_tnt import CompiledClassifier, Model, load_model
from async_tnt.networks.from_torch import layers_from_torch

WAY_OUT = (
    "; TorchClassifier(module) runs any module, and OnnxClassifier what torch exports to ONNX, whole at every decision"
)


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
        (nn.Sequential(nn.Conv2d(3, 4, 3), nn.GELU()), "layer '1' (GELU) has no compiled form"),
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


class InEvaluation(nn.Sequential):
    def forward(self, x):
        return super().forward(x if self.training else F.relu6(x))


@pytest.mark.parametrize("shape", [(30,), (-1, 30), (1, 30)])
def test_ways_to_flatten(shape):
    module = Flat(shape)
    found = [CompiledClassifier(Model.from_torch(module, CONFIG, list("abcd")))(volume) for volume in VOLUMES]
    assert np.abs(found - np.concatenate([logits_of(module, VOLUMES[k : k + 1]) for k in range(3)])).max() <= 1e-5


def test_a_module_is_read_as_in_eval_mode_and_left_as_it_was():
    module = head(nn.Conv2d(3, 4, 3), InEvaluation).train()
    model = Model.from_torch(module, CONFIG, list("abcd"))
    assert all(part.training for part in module.modules())
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    assert np.abs(found - logits_of(module)).max() <= 1e-5
    half = head(nn.Conv2d(3, 4, 3)).bfloat16()
    assert Model.from_torch(half, CONFIG, list("abcd")).weights["0.weight"].dtype == np.float32
