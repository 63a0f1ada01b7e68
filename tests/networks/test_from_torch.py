"""Torch modules: the layers compute what the module computed, or it is refused by name.

Also with changes in place, hooks, own classes, and functions that depend on more than the volume.
"""

import numpy as np
import pytest
import torch
from networks.modules import CONFIG, EVEN_KERNEL, MODULES, VOLUMES, Flat, head, logits_of, module_of
from networks.small import assert_same
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


class Written(nn.Module):
    """Convolutions around a body, which is a function of the module and the volume."""

    def __init__(self, body):
        super().__init__()
        torch.manual_seed(1)
        self.body, self.conv, self.relu = body, nn.Conv2d(3, 3, 3, padding=1), nn.ReLU(inplace=True)
        self.norm, self.head, self.dense = nn.BatchNorm2d(3), nn.Conv2d(3, 4, 1), nn.Linear(3 * 18 * 20, 4)

    def forward(self, x):
        return self.body(self, x)

    def logits(self, x):
        return self.head(x).mean((2, 3))


def clamps_the_volume(m, x):
    torch.clamp_(x, -1, 1)
    return m.logits(m.conv(x))


def preactivated(m, x):
    h = m.conv(x)
    return m.logits(m.relu(h) + h)


def pools_again(m, x):
    h = m.conv(x)
    a = F.max_pool2d(h, 2)
    m.relu(a)
    return m.logits(a + F.max_pool2d(h, 2))


def adds_to_another_name(m, x):
    h = m.conv(x)
    g = h
    g += x
    return m.logits(h)


def clamps_into_another(m, x):
    h, g = m.conv(x), m.norm(x)
    torch.clamp(h, -0.1, 0.1, out=g)
    return m.logits(h + g)


def returns_what_it_changed(m, x):
    h = m.logits(m.conv(x))
    h.relu_()
    return h


def changes_through_a_view(m, x):
    h = m.conv(x)
    return m.dense(h.flatten(1).relu_()) + m.logits(h)


def changes_what_is_not_read_again(m, x):
    logits = m.logits(m.conv(x))
    x.clamp_(0, 1)
    return logits


def leaves_results_unread(m, x):
    h = m.conv(x)
    x.exp(), h * 3, F.gelu(h), h.sigmoid(), x.div_(10)
    return m.logits(h)


def flattens(*shape):
    return lambda m, x: m.dense(m.conv(x).reshape(*(n(x) if callable(n) else n for n in shape)))


@pytest.mark.parametrize(
    "body",
    [
        flattens(lambda x: x.size(0), -1),
        flattens(lambda x: x.size()[0], -1),
        flattens(lambda x: x.shape[0], -1),
        clamps_the_volume,
        preactivated,
        pools_again,
        adds_to_another_name,
        clamps_into_another,
        returns_what_it_changed,
        changes_through_a_view,
        changes_what_is_not_read_again,
        leaves_results_unread,
    ],
)
def test_sizes_and_changes_in_place_are_read_as_they_are(body):
    module = Written(body)
    model = Model.from_torch(module, CONFIG, list("abcd"))
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    expected = logits_of(module, VOLUMES.copy())
    assert np.abs(found - expected).max() <= 1e-5 and np.ptp(expected) > 0.01


def divides_the_volume(m, x):
    x.div_(10)
    return m.logits(m.conv(x))


def multiplies_another_name(m, x):
    h = m.conv(x)
    g = h
    g *= 2
    return m.logits(h)


def own_function_in_place(m, x):
    h = m.conv(x)
    halve(h)
    return m.logits(h)


def own_function_named_relu(m, x):
    return m.logits(relu(m.conv(x)))


def changes_its_statistics(m, x):
    m.norm.running_mean.mul_(0.5)
    return m.logits(m.norm(m.conv(x)))


def halve(x):
    return x.mul_(0.5)


def relu(x):
    return torch.tanh(x)


torch.fx.wrap("halve")
torch.fx.wrap("relu")


class ReLU(nn.ReLU):
    def forward(self, x):
        return super().forward(x) ** 2


class Conv2d(nn.Conv2d):
    def forward(self, x):
        return super().forward(x) * 2


def hooked(register, change):
    module = head(nn.Conv2d(3, 4, 3))
    getattr(module[0], register)(change)
    return module


def with_forward(forward):
    module = head(nn.Conv2d(3, 4, 3))
    module[0].forward = forward
    return module


class Counting(nn.Module):
    """Another function each time."""

    def __init__(self):
        super().__init__()
        self.calls, self.conv = 0, nn.Conv2d(3, 4, 3)

    def forward(self, x):
        self.calls += 1
        x = self.conv(x)
        return (F.relu(x) if self.calls > 4 else x).mean((2, 3))


SMALL_NET = head(nn.Conv2d(3, 4, 3))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")
@pytest.mark.parametrize(
    "make, message",
    [
        (
            lambda: Written(divides_the_volume),
            r"^layer 'conv' \(Conv2d\): the value x is changed in place by",
        ),
        (lambda: Written(multiplies_another_name), r"the value conv is changed in place by operation 'imul' \(imul\)"),
        (lambda: Written(own_function_in_place), r"the value conv is changed in place by operation 'halve' \(halve\)"),
        (lambda: Written(own_function_named_relu), r"^operation 'relu' \(relu\) has no compiled form"),
        (lambda: Written(changes_its_statistics), r"^operation 'norm_running_mean' .* has no compiled form"),
        (lambda: head(nn.Sequential(nn.Conv2d(3, 4, 3), ReLU())), r"^operation 'pow_1' \(pow\) has no compiled form"),
        (lambda: head(Conv2d(3, 4, 3)), r"^operation '.*' \(.*weight\) has no compiled form"),
        (
            lambda: hooked("register_forward_hook", lambda m, i, o: o.clamp(max=6)),
            r"^layer '0' \(Conv2d\) has hooks, which a trace does not show: remove them",
        ),
        (
            lambda: hooked("register_forward_pre_hook", lambda m, i: (i[0].clamp(max=6),)),
            r"^layer '0' \(Conv2d\) has hooks, which a trace does not show: remove them",
        ),
        (lambda: with_forward(torch.relu), r"^layer '0' \(Conv2d\) has a `forward` that is not of its class"),
        (
            Counting,
            r"^the module cannot be read as layers: its layers compute other numbers \(by .*, where",
        ),
        (lambda: Written(lambda m, x: m.logits(F.dropout(x))), r"a dropout in training mode, also in evaluation"),
        (
            lambda: Written(lambda m, x: m.logits(torch.add(x, x, alpha=2))),
            r"'add' \(add\): a factor alpha",
        ),
        (
            lambda: Written(lambda m, x: x.mean((2, 3), dtype=torch.float64)),
            r"the argument 'dtype' has no compiled",
        ),
        (lambda: Written(lambda m, x: [m.logits(x)]), r"^the module must return one tensor of logits"),
        (lambda: Written(lambda m, x: m.unknown(x)), r"^torch.fx cannot trace this module: .* has no attribute 'unkn"),
        (
            lambda: Written(flattens(2, -1)),
            r"^operation 'reshape' \(reshape\): a view other than \(n, -1\)",
        ),
        (lambda: Written(flattens(lambda x: x.size(1), -1)), r"a view other than \(n, -1\), one row a volume"),
        (lambda: Written(flattens(lambda x: x.shape[1], -1)), r"a view other than \(n, -1\), one row a volume"),
        (lambda: Flat((-1, 5)), r"cannot be read as layers|must have shape"),
        (lambda: head(nn.Sequential(nn.Flatten(), nn.Linear(1080, 4), nn.BatchNorm2d(4)))[:1], r"it fails on a volume"),
        (
            lambda: head(nn.Conv2d(3, 4, 3, dtype=torch.complex64)),
            r"'0' \(Conv2d\): a weight of type torch.complex64",
        ),
        (lambda: head(nn.Conv2d(3, 4, 3, device="meta")), r"^layer '0' \(Conv2d\): Cannot copy out of meta tensor"),
        (lambda: torch.jit.script(SMALL_NET), r"^the module is compiled by torch.jit: take what it was made from"),
        (lambda: torch.jit.trace(SMALL_NET, torch.zeros(1, 3, 18, 20)), r"^the module is compiled by torch.jit"),
        (
            lambda: torch.ao.quantization.quantize_dynamic(nn.Sequential(SMALL_NET, nn.Linear(4, 4)), {nn.Linear}),
            r"^layer '1' \(Linear\) has no compiled form",
        ),
    ],
)
def test_a_module_that_is_more_than_its_trace_shows_is_refused_by_name(make, message):
    with pytest.raises((NotImplementedError, ValueError), match=message):
        Model.from_torch(make(), CONFIG, list("abcd"))


@pytest.mark.parametrize("value", [SMALL_NET.state_dict(), None, torch.zeros(3), abs])
def test_what_is_no_module_is_a_type_error(value):
    with pytest.raises(TypeError, match=f"^`module` must be a torch.nn.Module, got {type(value).__name__}"):
        Model.from_torch(value, CONFIG, list("abcd"))
