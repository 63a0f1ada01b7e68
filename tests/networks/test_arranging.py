"""Products, differences, slices and shuffles: from torch, and exported by torch from ONNX."""

import io

import numpy as np
import pytest
import torch
from networks.foreign import onnx
from torch import nn
from torch.nn import functional as F

from async_tnt import CompiledNetwork, Model, TNTConfig, TNTVolume
from async_tnt.base.box import Box
from async_tnt.networks.layers.upsampling import corner_taps
from async_tnt.networks.onnx.from_onnx import layers_from_onnx
from async_tnt.networks.torch.from_torch import check_torch_layers, layers_from_torch

CONFIG = TNTConfig(sensor=(10, 6), grid=(10, 6), bins=4, transform="none")


class Body(nn.Module):
    """A convolution, then what `body` does with its map."""

    def __init__(self, body):
        super().__init__()
        self.conv = nn.Conv2d(4, 8, 3, padding=1)
        self.other = nn.Conv2d(8, 8, 1)
        self.filters = nn.Parameter(torch.randn(8, 1, 3, 3))
        self.gamma = nn.Parameter(torch.randn(8))
        self.layer_norm = nn.LayerNorm(8)
        self.group_norm = nn.GroupNorm(4, 8)
        self.instance_norm = nn.InstanceNorm2d(8, affine=True)
        for norm in (self.layer_norm, self.group_norm, self.instance_norm):
            nn.init.normal_(norm.weight)
            nn.init.normal_(norm.bias)
        self.wide = nn.Linear(8, 20)
        self.narrow = nn.Linear(20, 8)
        self.body = body

    def forward(self, x):
        return self.body(self, self.conv(x))


def last(h):
    return h.permute(0, 2, 3, 1)


def shuffled(m, h):
    n, channels, rows, columns = h.shape
    groups = h.view(n, 4, channels // 4, rows, columns).transpose(1, 2).contiguous()
    return groups.view(n, -1, rows, columns)


def asserted(m, h):
    assert h.ndim == 4 and h.dim() == 4 and len(h) == 1
    torch._assert(h.shape[1] == 8, "eight channels")
    n, channels = h.shape[:2]
    return h[:, : channels // 2] if h.size(2) == h.size(-2) else h.view(n, -1)


BODIES = {
    "product": lambda m, h: h * m.other(h),
    "square": lambda m, h: h * h,
    "gate of all places": lambda m, h: h * h.mean((2, 3), keepdim=True).sigmoid(),
    "gate of one channel": lambda m, h: m.other(h).sigmoid()[:, 3:4] * h,
    "gates of both kinds": lambda m, h: h.mean((2, 3), keepdim=True) * h[:, :1],
    "difference": lambda m, h: h - m.other(h),
    "difference from a number": lambda m, h: 1.5 - h,
    "negative": lambda m, h: -h,
    "mask of places": lambda m, h: m.other(h) * h.abs().sum(1, keepdim=True).clamp(max=1),
    "sum with one channel": lambda m, h: h + h[:, 1:2],
    "channels": lambda m, h: h[:, 1:-2],
    "every third channel": lambda m, h: h[:, 1::3],
    "a part of the places": lambda m, h: h[:, :, 1:-2, 2:9:3],
    "chunks": lambda m, h: torch.cat(h.chunk(3, 1)[::-1], 1),
    "splits": lambda m, h: h.split([1, 5, 2], 1)[1] + torch.split(h, 5, 1)[0],
    "shuffle": shuffled,
    "asserted shapes": asserted,
    "corners": lambda m, h: F.interpolate(h, scale_factor=2, mode="bilinear", align_corners=True),
    "corners by three": lambda m, h: F.interpolate(
        h, size=(18, 30), mode="bilinear", align_corners=True
    ),
    "one place at all places": lambda m, h: F.interpolate(
        h.mean((2, 3), keepdim=True), size=h.shape[2:], mode="bilinear"
    ),
    "layer norm": lambda m, h: m.layer_norm(h.permute(0, 2, 3, 1)).permute(0, 3, 1, 2),
    "block of a ConvNeXt": lambda m, h: (
        h
        + m.gamma[:, None, None]
        * (m.narrow(F.gelu(m.wide(m.layer_norm(last(h))))) * m.gamma).permute(0, 3, 1, 2)
    ),
    "group norm": lambda m, h: m.group_norm(h),
    "group norm of one group": lambda m, h: F.group_norm(h, 1),
    "instance norm": lambda m, h: m.instance_norm(h),
    "layer norm of a vector": lambda m, h: m.layer_norm(h.mean((2, 3))),
    "error function": lambda m, h: torch.erf(h),
    "filters of its own": lambda m, h: F.conv2d(h, 2 * m.filters, padding=1, groups=8),
}
"""What is done with a map (8, 6, 10)."""


def module_of(name):
    torch.manual_seed(0)
    return Body(BODIES[name]).eval()


@pytest.mark.parametrize("name", BODIES)
def test_from_torch_they_compute_the_same(name):
    module = module_of(name)
    check_torch_layers(module, layers_from_torch(module, CONFIG.shape), CONFIG.shape)


# of torch, whose exporter of this kind needs no other package
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
@pytest.mark.filterwarnings("ignore::torch.jit.TracerWarning")
@pytest.mark.parametrize("name", BODIES)
def test_from_onnx_they_become_layers_of_the_same_numbers(name):
    module = module_of(name)
    file = io.BytesIO()
    example = (torch.zeros(1, *CONFIG.shape),)
    torch.onnx.export(module, example, file, dynamo=False, opset_version=18)
    network = onnx.load_from_string(file.getvalue())
    read = layers_from_onnx(network, CONFIG.shape, has_classes=False)
    own_weights = {name: values.copy() for name, values in read.weights.items()}
    check_torch_layers(module, read._replace(weights=own_weights), CONFIG.shape)


@pytest.mark.parametrize("name", BODIES)
def test_after_every_event_they_have_the_bits_of_a_whole_pass(name):
    model = Model.from_torch(module_of(name), CONFIG)
    network = CompiledNetwork(model)
    whole = CompiledNetwork(model)
    volume = TNTVolume(CONFIG)
    rng = np.random.default_rng(0)
    for k in range(60):
        if k % 20 == 0:
            volume.open(1_000_000 * k)
        where = int(rng.integers(10)), int(rng.integers(6))
        volume.update_one(1_000_000 * (k // 20 * 20) + 500 * k, *where, k % 2)
        for array, expected in zip(network.refresh(volume), whole(volume.array), strict=True):
            assert array.tobytes() == expected.tobytes()


class JoinedGate(nn.Module):
    """The means of each half of the channels, joined, multiply all places."""

    def forward(self, x):
        means = [half.mean((2, 3), keepdim=True) for half in x.chunk(2, 1)]
        return x * torch.cat(means, 1)


@pytest.mark.parametrize("polarity", [0, 1])
def test_a_gate_of_which_an_event_changes_one_half(polarity):
    """Each half is computed by a step of its own; either makes all places new."""
    model = Model.from_torch(JoinedGate(), CONFIG.replace(bins=2, polarity="split"))
    network = CompiledNetwork(model)
    whole = CompiledNetwork(model)
    volume = TNTVolume(model.config)
    volume.open(0)
    for k in range(20):
        volume.update_one(100 * k, k % 10, k % 6, polarity)
        (array,) = network.refresh(volume)
        (expected,) = whole(volume.array)
        assert array.tobytes() == expected.tobytes()
    halves = expected.any((1, 2)).reshape(2, 2).any(1)
    assert halves.tolist() == [polarity == 1, polarity == 0]


def test_a_gate_by_hand():
    """The mean of 60 places is 1/60 after one event, and each place is multiplied by it."""

    class Gate(nn.Module):
        def forward(self, x):
            return x * x.mean((2, 3), keepdim=True)

    volume = np.zeros(CONFIG.shape, np.float32)
    volume[2, 3, 4] = 3.0
    (array,) = CompiledNetwork(Model.from_torch(Gate(), CONFIG))(volume)
    assert array[2, 3, 4] == pytest.approx(3.0 * 3.0 / 60) and np.count_nonzero(array) == 1


def test_a_layer_norm_by_hand():
    """Channels 1, 2, 3 and 6 have the mean 3 and the variance 3.5."""
    model = Model.from_torch(LastNorm(), CONFIG)
    volume = np.float32([1, 2, 3, 6])[:, None, None] + np.zeros(CONFIG.shape, np.float32)
    (array,) = CompiledNetwork(model)(volume)
    np.testing.assert_allclose(array[:, 0, 0], np.array([-2, -1, 0, 3]) / 3.5**0.5, rtol=1e-5)


def test_a_change_behind_a_layer_norm_stays_where_it_is():
    network = CompiledNetwork(Model.from_torch(LastNorm(), CONFIG))
    volume = TNTVolume(CONFIG)
    volume.open(0)
    network.refresh(volume)
    volume.update_one(10, 7, 3, 1)
    network.refresh(volume)
    assert network.changed == (Box(7, 3, 8, 4),)


class LastNorm(nn.Module):
    """A layer norm without weights."""

    def forward(self, x):
        return F.layer_norm(last(x), (4,)).permute(0, 3, 1, 2)


OF_TORCH = {
    "a sum of a stack": lambda m, h: torch.stack([h, m.other(h), h]).sum(dim=0),
    "the last of fewer chunks": lambda m, h: h.chunk(5, 1)[-1],
    "splits beside empty ones": lambda m, h: h.split([0, 3, 5, 0], 1)[2],
    "axes as a list": lambda m, h: torch.permute(
        m.layer_norm(torch.permute(h, (0, 2, -1, 1))), (0, 3, -3, 2)
    ),
}
"""More that is done with it, which torch exports in forms that are not read."""


@pytest.mark.parametrize("name", OF_TORCH)
def test_other_spellings_of_torch_compute_the_same(name):
    body = Body(OF_TORCH[name]).eval()
    check_torch_layers(body, layers_from_torch(body, CONFIG.shape), CONFIG.shape)


NUMBER_BY_NUMBER = {
    "relu": F.relu,
    "leaky relu": lambda h: F.leaky_relu(h, 0.3),
    "absolute": torch.abs,
    "clip": lambda h: h.clamp(-0.5, 0.25),
    "hardtanh": F.hardtanh,
    "relu6": F.relu6,
    "softshrink": lambda h: F.softshrink(h, 0.25),
    "logarithm": lambda h: torch.log1p(h.relu()),
    "sigmoid": torch.sigmoid,
    "tanh": torch.tanh,
    "silu": F.silu,
    "gelu": F.gelu,
    "gelu by tanh": lambda h: F.gelu(h, approximate="tanh"),
    "error function": torch.erf,
    "hardswish": F.hardswish,
    "hardsigmoid": F.hardsigmoid,
    "square": lambda h: h * h,
    "sum": lambda h: h + h.relu(),
    "difference": lambda h: h - h.relu(),
    "negative": lambda h: -h,
    "part": lambda h: h / 3,
    "dropout": nn.Dropout(),
    "dropout of channels": nn.Dropout2d(),
    "identity": nn.Identity(),
    "contiguous": lambda h: h.contiguous(),
    "clone": lambda h: h.clone(),
}


@pytest.mark.parametrize("name", NUMBER_BY_NUMBER)
def test_what_is_done_with_each_number_may_be_done_with_the_channels_last(name):
    body = Body(lambda m, h: m.function(last(h)).permute(0, 3, 1, 2))
    plain = Body(lambda m, h: m.function(h))
    body.function = plain.function = NUMBER_BY_NUMBER[name]
    found = layers_from_torch(body.eval(), CONFIG.shape)
    expected = layers_from_torch(plain.eval(), CONFIG.shape)
    check_torch_layers(body, found, CONFIG.shape)
    assert [layer["op"] for layer in found.layers] == [layer["op"] for layer in expected.layers]


def test_a_shuffle_by_hand():
    """Four groups of two: the first of each, then the second of each."""
    model = Model.from_torch(nn.Sequential(nn.ChannelShuffle(2)), CONFIG)
    volume = np.arange(4, dtype=np.float32)[:, None, None] + np.zeros(CONFIG.shape, np.float32)
    (array,) = CompiledNetwork(model)(volume)
    assert array[:, 0, 0].tolist() == [0, 2, 1, 3]


@pytest.mark.parametrize("n, factor", [(1, 1), (1, 3), (3, 1), (2, 2), (5, 2), (7, 4)])
def test_corners_lie_on_each_other(n, factor):
    taps = corner_taps(n, factor)
    assert np.allclose(taps.sum(2), 1) and (taps >= 0).all()
    # the place m - 1 + tap of the input has the coordinate of the output's place
    places = (taps * (np.arange(n)[:, None] - 1 + np.arange(3))).sum(2)
    expected = np.linspace(0, n - 1, n * factor).reshape(n, factor).T
    assert np.allclose(places, expected)


@pytest.mark.parametrize(
    "body, reason",
    [
        (lambda m, h: h[:, [0, 2]], "the index"),
        (lambda m, h: h.transpose(1, 2), "a transposition"),
        (lambda m, h: last(h), "a tensor with its channels last"),
        (lambda m, h: F.max_pool2d(last(h), 2), "a tensor with its channels last"),
        (lambda m, h: h + last(h)[:, :1, :1], "a tensor with its channels last"),
        (lambda m, h: h.permute(0, 3, 2, 1), "a permutation by"),
        (lambda m, h: F.layer_norm(h, (10,)), "a layer norm over"),
        (lambda m, h: torch.stack([h, h]).relu(), "a stack or tuple of maps"),
        (lambda m, h: h.view(1, 2, 4, 6, 10).relu(), "a view of channels in groups"),
        (lambda m, h: h.view(1, 2, 4, 6, 10), "a view of channels in groups"),
        (lambda m, h: h.view(1, 4, 12, 10), "a view other than"),
        (lambda m, h: h.chunk(2, 2)[0], "a division along axis 2"),
        (lambda m, h: h / m.other(h), "a quotient other than"),
        (lambda m, h: h / 0, "a quotient by zero"),
        (lambda m, h: h * h[:, :, :1], "one place or channel for all"),
        (lambda m, h: h.sum(2, keepdim=True), "a sum over 2, not of the channels"),
        (lambda m, h: h.sum(1), "a sum over 1, not of the channels"),
        (lambda m, h: F.conv2d(h, h.new_ones(1)), "has no compiled form"),
        (lambda m, h: h if h.sum() > 0 else -h, "cannot trace this module"),
    ],
)
def test_what_has_no_form_is_refused_by_its_reason(body, reason):
    with pytest.raises(NotImplementedError, match=reason) as raised:
        layers_from_torch(Body(body).eval(), CONFIG.shape)
    assert "\n" not in str(raised.value)


class Keeps(nn.Module):
    """A unit with a state, as recurrent networks have it."""

    def __init__(self):
        super().__init__()
        self.conv = nn.Conv2d(4, 4, 1)
        self.state = None

    def forward(self, x):
        self.state = self.conv(x) if self.state is None else self.conv(x) + self.state
        return self.state


@pytest.mark.parametrize(
    "module, message",
    [
        (
            nn.Sequential(Keeps()),
            "layer '0' (Keeps) keeps a tensor in `state` from call to call: it is recurrent",
        ),
        (Keeps(), "the module keeps a tensor in `state` from call to call: it is recurrent"),
        (
            nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.GRU(4, 2)),
            "layer '2' (GRU) has no compiled form: it is recurrent",
        ),
    ],
)
def test_a_recurrent_network_is_called_recurrent(module, message):
    with pytest.raises(NotImplementedError) as raised:
        layers_from_torch(module.eval(), CONFIG.shape)
    assert message in str(raised.value) and "\n" not in str(raised.value)
