"""Torch modules: the layers compute what the module computed, or it is refused by name.

Also with changes in place, hooks, own classes, and functions that depend on more than the volume.
Many more of them: test_random_networks.py.
"""

import numpy as np
import pytest
import torch
from networks.modules import CONFIG, EVEN_KERNEL, VOLUMES, branches, logits_of
from networks.small import assert_same
from tnt_reference import LayerNetwork
from torch import nn
from torch.nn import functional as F

from async_tnt import CompiledClassifier, CompiledRegressor, Model, load_model
from async_tnt.networks.layers.refusals import Refusals, RefusedError
from async_tnt.networks.torch.from_torch import layers_from_torch
from async_tnt.networks.torch.operations import HeatmapCentroid

WAY_OUT = (
    "; a network of logits runs whole at every decision: TorchClassifier(module), or exported to "
    "ONNX, OnnxClassifier(path)"
)

RARE = 1e6
"""Larger than what any of the volumes gives that a module and its layers are compared on."""


def model_of(module):
    return Model.from_torch(module, CONFIG, list("abcd"), record={"by": "hand"})


@EVEN_KERNEL
def test_a_torch_module_computes_what_it_did(tmp_path):
    """The model computes what the module does in eval mode, and leaves the module as it was.

    So does the model that was saved and loaded, and so do its layers in torch.
    """
    module = branches().train()
    model = model_of(module)
    assert module.training and (model.classes, model.record) == (tuple("abcd"), {"by": "hand"})
    state = module.state_dict()
    # Weights of functions have names with "()". The module has no such weights.
    own = {key: w for key, w in model.weights.items() if "()" not in key}
    assert all(np.array_equal(w, state[key].numpy()) for key, w in own.items())
    expected = logits_of(module)
    assert np.ptp(expected) > 0.1
    for one in (model, load_model(model.save(tmp_path / "m.safetensors"))):
        found = [CompiledClassifier(one)(volume) for volume in VOLUMES]
        assert np.abs(found - expected).max() <= 1e-5
    again = model_of(LayerNetwork(model.network["classifier"], model.weights))
    assert_same(again, model)
    assert again.network == model.network


class Written(nn.Module):
    """Convolutions around a body, which is a function of the module and the volume."""

    def __init__(self, body):
        super().__init__()
        torch.manual_seed(1)
        self.body = body
        self.conv = nn.Conv2d(3, 3, 3, padding=1)
        self.dense = nn.Linear(3 * 18 * 20, 4)
        self.head = nn.Conv2d(3, 4, 1)
        self.flatten = nn.Flatten()
        self.identity = nn.Identity()
        self.limit = nn.Hardtanh(-RARE, RARE, inplace=True)
        self.threshold = nn.Threshold(-RARE, 0.0, inplace=True)
        self.register_buffer("scales", torch.tensor([0.5, 2.0, 3.0])[:, None, None])

    def forward(self, x):
        return self.body(self, x)

    def logits(self, x):
        return self.head(x).mean((2, 3))


def depends_on_the_mode(m, x):
    return m.logits(m.conv(x if m.training else F.relu6(x)))


def scales_the_volume(m, x):
    """A module that multiplies the volume by numbers, also in place and by channel."""
    x.div_(10)
    return m.logits(m.conv((1.5 * x - 0.25) / m.scales))


def computes_more_than_it_returns(m, x):
    """The weights of what nobody reads are no part of the model."""
    F.relu(m.conv(x))
    return m.logits(x)


def limits_at_zero(m, x):
    """One limit is 0, and there is no other."""
    h = m.conv(x)
    return m.logits(torch.clamp(h, max=0) + 2 * h.clamp(0))


WRITTEN = [depends_on_the_mode, scales_the_volume, computes_more_than_it_returns, limits_at_zero]
ALONE = nn.Conv2d(3, 4, (18, 20))


@pytest.mark.parametrize(
    "module", [*map(Written, WRITTEN), ALONE], ids=[*(f.__name__ for f in WRITTEN), "one layer"]
)
def test_modes_and_changes_in_place_are_read_as_they_are(module):
    found = [CompiledClassifier(model_of(module))(volume) for volume in VOLUMES]
    expected = np.concatenate(
        [logits_of(module, VOLUMES[k : k + 1].copy()).reshape(1, -1) for k in range(len(VOLUMES))]
    )
    assert np.abs(found - expected).max() <= 1e-5 and np.ptp(expected) > 0.01


@EVEN_KERNEL
@pytest.mark.parametrize(
    "layer",
    [
        nn.Conv2d(3, 2, 3, padding="valid"),
        nn.Conv2d(3, 2, (2, 4), dilation=(2, 1), padding="same"),
        nn.AdaptiveAvgPool2d((None, 3)),
        nn.AdaptiveAvgPool2d((7, None)),
        nn.AvgPool2d((3, 2)),
        nn.AvgPool2d(3, ceil_mode=True),
        nn.AvgPool2d(3, padding=1, ceil_mode=True, count_include_pad=False),
        nn.MaxPool2d(3, ceil_mode=True),
        nn.Hardtanh(-0.1, 0.2),
    ],
    ids=str,
)
def test_parameters_that_are_words_or_missing(layer):
    module = nn.Sequential(layer, nn.Flatten(), nn.LazyLinear(4))
    expected = logits_of(module)
    found = [CompiledClassifier(model_of(module))(volume) for volume in VOLUMES]
    assert np.abs(found - expected).max() <= 1e-5 and np.ptp(expected) > 0.01


VIEWS = {
    "flatten": lambda m, h: h.flatten(1),
    "torch.flatten": lambda m, h: torch.flatten(h, 1),
    "Flatten": lambda m, h: m.flatten(h),
    "view": lambda m, h: h.view(h.size(0), -1),
    "reshape": lambda m, h: h.reshape(1, -1),
    "a view of a view": lambda m, h: h.contiguous().flatten(1),
    "of a result in place": lambda m, h: h.relu_().flatten(1),
    "of dropout": lambda m, h: F.dropout(h, training=False).flatten(1),
    "of Identity": lambda m, h: m.identity(h).flatten(1),
}
IN_PLACE = {  # its name -> what changes only numbers beyond RARE
    "clamp_": lambda m, h: h.clamp_(max=RARE),
    "clip_": lambda m, h: torch.clip_(h, max=RARE),
    "hardtanh": lambda m, h: F.hardtanh(h, -RARE, RARE, inplace=True),
    "Hardtanh": lambda m, h: m.limit(h),
    "clamp": lambda m, h: torch.clamp(h, max=RARE, out=h),
}


def through_a_view(view, change):
    """The view is changed, the map is read."""

    def body(m, x):
        h = m.conv(x)
        flat = view(m, h)
        change(m, flat)
        return m.dense(flat) + m.logits(h)

    return body


def under_a_view(view, change):
    """The map is changed, the view is read."""

    def body(m, x):
        h = m.conv(x)
        flat = view(m, h)
        change(m, h)
        return m.dense(flat)

    return body


@pytest.mark.parametrize("order", [through_a_view, under_a_view])
@pytest.mark.parametrize("change", IN_PLACE)
@pytest.mark.parametrize("view", VIEWS)
def test_a_change_in_place_that_a_view_shares_is_refused_by_name(view, change, order):
    """Although no volume that both are compared on shows the difference."""
    with pytest.raises(NotImplementedError) as raised:
        model_of(Written(order(VIEWS[view], IN_PLACE[change])))
    where, _, why = str(raised.value).partition(": ")
    assert where.endswith(f"({change})") and why.startswith("a change in place of memory that '")
    assert "\n" not in why and why.endswith(f", which is read later, has no compiled form{WAY_OUT}")


def of_one_tensor(m, x):
    """Changed under each of its names: all of them show it."""
    h = m.conv(x)
    first = h.clamp_(-0.3, 0.4)
    second = F.leaky_relu_(first, 0.1)
    h.mul_(3)
    return m.logits(h + 0.5 * first) + m.logits(second)


def views_that_nobody_reads_later(m, x):
    """One read before, one that keeps its values, and those of which a size or nothing is read."""
    h = m.conv(x)
    before = m.dense(h.flatten(1))
    n = h.size(0)
    flat = h.view(n, -1)
    F.dropout(flat, training=False, inplace=True)
    g = m.conv(h)
    shown = g.flatten(1)
    after = m.dense(flat.relu_().view(h.size(0), -1)) + m.logits(g.relu_())
    shown.exp()
    return before + after


def by_operators(m, x):
    """Each changes the tensor of which `before` is another name."""
    h = m.conv(x)
    before = h
    h += 0.5
    h -= 0.25
    h *= 3
    h /= 2
    return m.logits(h + before)


@pytest.mark.parametrize("body", [of_one_tensor, by_operators, views_that_nobody_reads_later])
def test_changes_in_place_that_no_view_shares_are_read(body):
    module = Written(body)
    found = [CompiledClassifier(model_of(module))(volume) for volume in VOLUMES]
    expected = logits_of(module)
    assert np.abs(found - expected).max() <= 1e-5 and np.ptp(expected) > 0.01


def limits(h):
    return h.clamp_(max=RARE)


torch.fx.wrap("limits")
UNREAD = {  # named as they would be if their results were read
    "clamp_max_": lambda m, h: h.clamp_max_(RARE),
    "threshold_": lambda m, h: F.threshold_(h, -RARE, 0.0),
    "celu": lambda m, h: F.celu(h, 1.0, True),
    "Threshold": lambda m, h: m.threshold(h),
    "limits": lambda m, h: limits(h),
    "sign": lambda m, h: torch.sign(torch.sign(h), out=h),
}


class ManyUnknown(nn.Module):
    """Two calls of each of eleven unknown functions, then a sum that does not fit the volume."""

    FUNCTIONS = (
        "exp",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "lgamma",
        "ceil",
    )

    def forward(self, x):
        for name in self.FUNCTIONS:
            x = getattr(torch, name)(getattr(torch, name)(x))
        pooled = x.exp().mean((2, 3), keepdim=True)
        return (pooled + pooled.floor()).flatten(1)


def test_a_message_counts_the_calls_of_each_kind_and_names_ten_kinds():
    with pytest.raises(NotImplementedError) as refused:
        layers_from_torch(ManyUnknown(), (2, 8, 8))
    parts = str(refused.value).split("; ")
    assert parts[0] == "operation 'exp' (exp) has no compiled form (3 of these)"
    assert parts[1] == "operation 'sin' (sin) has no compiled form (2 of these)"
    assert len(parts) == 11 and parts[-1] == "and 2 more kinds"


@pytest.mark.parametrize("n_kinds", [1, 10, 11])
def test_a_message_counts_the_kinds_that_it_does_not_name(n_kinds):
    refusals = Refusals()
    assert not refusals
    refusals.raise_if_any()
    for k in range(n_kinds):
        refusals.add(RefusedError(f"kind {k}", f"part {k}"))
    parts = [f"part {k}" for k in range(min(n_kinds, 10))]
    if n_kinds == 11:
        parts.append("and 1 more kind")
    with pytest.raises(NotImplementedError, match=f"^{'; '.join(parts)}$"):
        refusals.raise_if_any()


@pytest.mark.parametrize("name", UNREAD)
def test_an_unknown_change_in_place_is_refused_though_nobody_reads_its_result(name):
    """For most of these changes, no volume shows a difference."""

    def body(m, x):
        h = m.conv(x)
        UNREAD[name](m, h)
        return m.logits(h)

    with pytest.raises(NotImplementedError, match=rf"\({name}\) has no compiled form"):
        model_of(Written(body))


def squares_the_volume(m, x):
    x.pow_(2)
    return m.logits(m.conv(x))


def own_function_named_relu(m, x):
    return m.logits(relu(m.conv(x)))


def relu(x):
    return torch.tanh(x)


torch.fx.wrap("relu")


def counts_its_calls(m, x):
    """Another function each time."""
    m.calls = getattr(m, "calls", 0) + 1
    x = m.conv(x)
    return m.logits(F.relu(x) if m.calls > 4 else x)


class Two(nn.Module):
    def forward(self, x, y):
        return x + y


def hooked():
    module = nn.Sequential(nn.Conv2d(3, 4, 3))
    module[0].register_forward_pre_hook(lambda *arguments: None)
    return module


def with_a_forward_of_its_own():
    module = nn.Sequential(nn.Conv2d(3, 4, 3))
    module[0].forward = nn.Conv2d(3, 4, 3).forward
    return module


def of_layer(*layers):
    return lambda: nn.Sequential(*layers)


def of_body(body):
    return lambda: Written(body)


def stochastic_depth(x, p, mode, training=True):
    """Torchvision's function by its name, which is all that is known of it here."""
    return x


stochastic_depth.__module__ = "torchvision.ops.stochastic_depth"
torch.fx.wrap("stochastic_depth")


def test_a_stochastic_depth_is_left_out_in_evaluation():
    module = Written(lambda m, x: m.logits(stochastic_depth(m.conv(x), 0.5, "row", m.training)))
    layers = [layer["op"] for layer in model_of(module).network["classifier"]]
    assert layers == ["conv", "conv", "global_average_pool", "flatten"]
    trained = Written(lambda m, x: m.logits(stochastic_depth(m.conv(x), 0.5, "row")))
    with pytest.raises(NotImplementedError, match="a dropout in training mode, also in evaluatio"):
        model_of(trained)


HIDDEN = [counts_its_calls]
OTHER_NUMBERS = "the module cannot be read as layers: its layers compute other numbers (by "
FORM = "has no compiled form"
HOOKS = "has hooks, which a trace does not show: remove them"
REFUSED = [  # what makes it, the beginning of the message
    (
        of_layer(nn.Mish(), nn.ReLU(), nn.CELU()),
        f"layer '0' (Mish) {FORM}; layer '2' (CELU) {FORM}",
    ),
    (
        of_layer(nn.Flatten(), nn.Softmax(1)),
        f"layer '1' (Softmax) {FORM}: a decision has the softmax of its logits",
    ),
    (
        of_layer(nn.AvgPool2d(3, 2, 1, True)),
        "layer '0' (AvgPool2d): ceil_mode with padding that counts",
    ),
    (
        of_body(lambda m, x: 1 / m.conv(x)),
        "operation 'truediv' (truediv): a quotient other than a map by a constant",
    ),
    (
        of_body(lambda m, x: x + x[:, :, :1]),
        "the module cannot be read as layers: layer 'add' (add): ",
    ),
    (
        of_body(lambda m, x: m.conv(x) * m.dense.bias),
        "operation 'mul' (mul): a constant of shape [4] here has",
    ),
    (Two, "the module must take one volume, got 2 arguments"),
    (
        of_body(lambda m, x: x if x.sum() > 0 else -x),
        "torch.fx cannot trace this module: symbolically traced variable",
    ),
    (of_body(own_function_named_relu), f"operation 'relu' (relu) {FORM}"),
    (hooked, f"layer '0' (Conv2d) {HOOKS}"),
    (
        with_a_forward_of_its_own,
        "layer '0' (Conv2d) has a `forward` that is not of its class",
    ),
    (
        lambda: nn.Sequential(nn.Conv2d(3, 4, 3), nn.LazyConv2d(4, 3)),
        "layer '1' (LazyConv2d) has no weights yet: call the module once",
    ),
    (
        of_layer(nn.BatchNorm2d(3, track_running_stats=False), nn.Conv2d(3, 4, 3)),
        "layer '0' (BatchNorm2d): a batch norm that does not use running statistics",
    ),
    (
        of_layer(nn.AvgPool2d(2, divisor_override=2)),
        "layer '0' (AvgPool2d): divisor_override has no compiled form",
    ),
    (
        of_body(lambda m, x: m.logits(m.conv(x) * torch.tensor([1, 2, 3])[:, None, None])),
        "operation 'mul' (mul): a weight of type torch.int64, not floating point, has no compiled",
    ),
    (of_body(squares_the_volume), f"operation 'pow_' (pow_) {FORM}"),
    *((of_body(body), OTHER_NUMBERS) for body in HIDDEN),
    (
        of_body(lambda m, x: x.mean((2, 3), dtype=torch.float64)),
        "operation 'mean' (mean): the argument 'dtype' has",
    ),
    (
        of_body(lambda m, x: m.dense(x.reshape(2, -1))),
        "operation 'reshape' (reshape): a view other than (n, -1)",
    ),
    (
        lambda: torch.jit.trace(nn.Conv2d(3, 4, 3), torch.zeros(1, 3, 18, 20)),
        "the module is compiled by torch.jit",
    ),
    (
        of_layer(nn.Conv2d(3, 4, 3, padding=1, padding_mode="reflect")),
        f"layer '0' (Conv2d): padding_mode 'reflect' {FORM}",
    ),
    (of_layer(nn.Upsample(scale_factor=2, mode="bicubic")), "layer '0' (Upsample): mode 'bicubic'"),
    (
        of_layer(nn.Upsample(scale_factor=(2, 3))),
        "layer '0' (Upsample): an upsampling by [2.0, 3.0], not by one whole number",
    ),
    (
        of_layer(nn.Upsample(size=(20, 20))),
        "layer '0' (Upsample): an upsampling by [1.1111111111111112, 1.0], not by one whole",
    ),
    (
        of_body(lambda m, x: F.interpolate(x, scale_factor=2, mode="bilinear", antialias=True)),
        f"operation 'interpolate' (interpolate): antialias {FORM}",
    ),
    (
        of_body(lambda m, x: F.pad(x, (1, 1, 1, 1), value=1.0)),
        f"operation 'pad' (pad): mode 'constant' with the value 1.0 {FORM}",
    ),
    (
        of_body(lambda m, x: F.pad(x, (1, 1, 1, 1), "reflect")),
        f"operation 'pad' (pad): mode 'reflect' with the value None {FORM}",
    ),
    (of_body(lambda m, x: F.pad(x, (1, -1, 0, 0))), "operation 'pad' (pad): a padding of [1, -1,"),
    (
        of_layer(nn.ConstantPad2d(1, 0.5)),
        f"layer '0' (ConstantPad2d): a padding of (1, 1, 1, 1) with a value {FORM}",
    ),
    (of_layer(nn.ZeroPad2d(-1)), "layer '0' (ZeroPad2d): a padding of (-1, -1, -1, -1) with a"),
    (of_layer(nn.MaxPool2d(2, dilation=2)), f"layer '0' (MaxPool2d): dilation {FORM}"),
    (
        of_layer(nn.MaxPool2d(2, return_indices=True)),
        f"layer '0' (MaxPool2d): return_indices {FORM}",
    ),
    (
        of_body(lambda m, x: m.logits(F.dropout(m.conv(x)))),
        f"operation 'dropout' (dropout): a dropout in training mode, also in evaluation, {FORM}",
    ),
    (
        of_body(lambda m, x: F.batch_norm(x, None, None, training=True)),
        "operation 'batch_norm' (batch_norm): a batch norm that does not use running statistics",
    ),
    (
        of_layer(nn.InstanceNorm2d(3, track_running_stats=True)),
        f"layer '0' (InstanceNorm2d): an instance norm with running statistics {FORM}",
    ),
    (
        of_body(lambda m, x: x.sub(m.conv(x), alpha=2)),
        f"operation 'sub' (sub): a factor alpha {FORM}",
    ),
    (
        of_body(lambda m, x: torch.div(x, 2, rounding_mode="floor")),
        "operation 'div' (div): a quotient other than a map by a constant",
    ),
    (
        of_body(lambda m, x: x.clamp(min=m.scales)),
        f"operation 'clamp' (clamp): a limit that is no number {FORM}",
    ),
    (
        of_body(lambda m, x: torch.cat([x, x], 2)),
        f"operation 'cat' (cat): a concatenation along axis 2, not of channels (1), {FORM}",
    ),
    (
        of_body(lambda m, x: x.flatten(2)),
        f"operation 'flatten' (flatten): a flatten from axis 2 to -1, not from 1 to -1, {FORM}",
    ),
    (
        of_body(lambda m, x: x.mean((1, 2))),
        f"operation 'mean' (mean): a mean over [1, 2], not over all places (2, 3), {FORM}",
    ),
]


@pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning"
)
@pytest.mark.parametrize(
    "make, message", REFUSED, ids=[f"{k} {message[:60]}" for k, (_, message) in enumerate(REFUSED)]
)
def test_a_module_that_is_more_than_its_layers_is_refused_by_name(make, message):
    with pytest.raises(NotImplementedError) as raised:
        model_of(make())
    assert str(raised.value).startswith(message) and str(raised.value).endswith(WAY_OUT)


@pytest.mark.parametrize(
    "value, got",
    [
        (
            nn.Conv2d(3, 4, 3).state_dict(),
            r"OrderedDict: load it into its module \(load_state_dict\)",
        ),
        (abs, "builtin_function_or_method"),
    ],
)
def test_what_is_no_module_is_a_type_error(value, got):
    with pytest.raises(TypeError, match=f"^`module` must be a torch.nn.Module, got {got}$"):
        model_of(value)


# -- a landmark network beside the classifier ------------------------------------------------------

WITH_LANDMARK = CONFIG.replace(landmark="regressor")


def finder(*layers):
    return nn.Sequential(nn.Conv2d(3, 1, 1), *layers, HeatmapCentroid())


class Part(nn.Module):
    def __init__(self):
        super().__init__()
        self.regressor = nn.ModuleList([nn.Conv2d(3, 4, 1)])

    def forward(self, volume):
        return self.regressor[0](volume).mean((2, 3))


def test_weights_of_both_networks_are_kept_apart():
    """Although a part of the classifier is named as the landmark network is, with a part "0"."""
    decides = Part()
    finds = finder()
    model = Model.from_torch(decides, WITH_LANDMARK, list("abcd"), regressor=finds)
    assert len(model.weights) == 4
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    assert np.abs(found - logits_of(decides)).max() <= 1e-5
    landmarks = [CompiledRegressor(model)(volume) for volume in VOLUMES]
    np.testing.assert_allclose(landmarks, logits_of(finds), atol=1e-4)


def test_networks_of_layers_whose_weights_have_the_same_names_are_kept_apart():
    modules = nn.Sequential(Part()), finder()
    names = {}
    parts = []
    for module in modules:
        read = layers_from_torch(module, CONFIG.shape)
        weights = {f"w{k}": values for k, values in enumerate(read.weights.values())}
        names = dict(zip(read.weights, weights, strict=True))
        layers = [
            {**layer, "weights": {role: names[name] for role, name in layer["weights"].items()}}
            if "weights" in layer
            else layer
            for layer in read.layers
        ]
        parts.append(LayerNetwork(layers, weights))
    decides, finds = parts
    model = Model.from_torch(decides, WITH_LANDMARK, list("abcd"), regressor=finds)
    assert len(model.weights) == 4
    found = [CompiledClassifier(model)(volume) for volume in VOLUMES]
    assert np.abs(found - logits_of(modules[0])).max() <= 1e-5
    landmarks = [CompiledRegressor(model)(volume) for volume in VOLUMES]
    np.testing.assert_allclose(landmarks, logits_of(modules[1]), atol=1e-4)


class Forgets(nn.Module):
    """Another function after its fourth call."""

    n_calls = 0

    def forward(self, x):
        self.n_calls += 1
        return torch.relu(x) if self.n_calls > 4 else 1.0 * x


def test_a_landmark_network_that_is_more_than_its_layers_is_refused():
    finds = finder()
    finds.insert(1, Forgets())
    with pytest.raises(NotImplementedError, match="its layers compute other numbers"):
        Model.from_torch(Part(), WITH_LANDMARK, list("abcd"), regressor=finds)
