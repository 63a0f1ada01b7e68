"""Layers by which maps grow compute what torch computes, as convolutions and blocks."""

import io

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from networks.foreign import onnx
from torch import nn
from torch.nn import functional as F

from async_tnt.networks.layers.enlarging import transposed_convolution
from async_tnt.networks.onnx.from_onnx import layers_from_onnx
from async_tnt.networks.torch.from_torch import check_torch_layers, layers_from_torch

SHAPE = (4, 6, 5)


class Functional(nn.Module):
    """Calls of functions, whose tensors are attributes of the module."""

    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm2d(4)
        self.norm.running_mean.normal_()
        self.norm.running_var.uniform_(0.5, 2)

    def forward(self, x):
        norm = self.norm
        x = F.batch_norm(x, norm.running_mean, norm.running_var, norm.weight, norm.bias, eps=0.1)
        x = torch.cat([x], 1).clone()
        x = F.interpolate(x, scale_factor=2, mode="nearest")
        x = F.interpolate(F.batch_norm(x, norm.running_mean, norm.running_var), size=(36, 30))
        return F.pad(F.pad(x, (1, 1, 0, 2)), (0, 2, 1, 0), "replicate")


class Focus(nn.Module):
    """Every second row and column, as YOLO networks begin."""

    def forward(self, x):
        return torch.cat([x[..., j::2, i::2] for i in (0, 1) for j in (0, 1)], 1)[:, :, :]


class Picked(nn.Module):
    """Rows and columns by other indices."""

    def forward(self, x):
        return x[:, :, 2:][:, :, ::3, 1:]


GROWING = {
    "nearest": nn.Upsample(scale_factor=2),
    "nearest by 3 to a size": nn.Upsample(size=(18, 15)),
    "nearest of 2d": nn.UpsamplingNearest2d(scale_factor=2),
    "2x2 by 2": nn.ConvTranspose2d(4, 3, 2, 2),
    "4x4 by 2": nn.ConvTranspose2d(4, 3, 4, 2, 1, bias=False),
    "3x3 by 2 with output padding": nn.ConvTranspose2d(4, 6, 3, 2, 1, 1, groups=2),
    "3x3 by 1": nn.ConvTranspose2d(4, 3, 3, 1, 1),
    "dilated": nn.ConvTranspose2d(4, 2, 3, 2, 2, 1, dilation=2),
    "less than its stride": nn.ConvTranspose2d(4, 3, 1, 2, output_padding=1),
    "not square": nn.ConvTranspose2d(4, 3, (2, 4), 2, (0, 1)),
    "bilinear": nn.Upsample(scale_factor=2, mode="bilinear"),
    "bilinear by 3 to a size": nn.Upsample(size=(18, 15), mode="bilinear"),
    "every third row": Picked(),
    "zeros around": nn.ZeroPad2d((1, 0, 2, 3)),
    "edges around": nn.ReplicationPad2d((1, 0, 2, 3)),
    "functions": Functional(),
}
"""Modules by which a map of `SHAPE` grows."""


def as_layers(module):
    module = nn.Sequential(module, nn.Conv2d(_channels(module), 2, 1)).eval()
    return module, layers_from_torch(module, SHAPE)


def _channels(module):
    with torch.no_grad():
        return module.eval()(torch.zeros(1, *SHAPE)).shape[1]


@pytest.mark.parametrize("name", GROWING)
def test_from_torch_they_compute_the_same(name):
    torch.manual_seed(0)
    module, read = as_layers(GROWING[name])
    check_torch_layers(module, read, SHAPE)
    known = {"conv", "depth_to_space", "batch_norm", "zero_pad", "edge_pad"}
    assert {layer["op"] for layer in read.layers} <= known


# of torch, whose exporter of this kind needs no other package
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore:Constant folding:UserWarning")
@pytest.mark.parametrize("name", GROWING)
def test_from_onnx_they_become_layers_of_the_same_numbers(name):
    module = GROWING[name].eval()
    file = io.BytesIO()
    torch.onnx.export(module, (torch.zeros(1, *SHAPE),), file, dynamo=False, opset_version=18)
    network = onnx.load_from_string(file.getvalue())
    read = layers_from_onnx(network, SHAPE, has_classes=False)
    own_weights = {name: values.copy() for name, values in read.weights.items()}
    check_torch_layers(module, read._replace(weights=own_weights), SHAPE)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_transposed_convolutions_of_all_sizes_are_exact_or_refused(data):
    """Whole numbers in float64, so that any order of sums gives the same."""
    draw = data.draw
    stride = draw(st.integers(1, 3))
    kernel = [draw(st.integers(1, 5)) for _ in range(2)]
    dilation = [draw(st.integers(1, 2)) for _ in range(2)]
    reach = [d * (k - 1) for d, k in zip(dilation, kernel, strict=True)]
    sizes = [(side - 1) * stride + n + 1 for side, n in zip((4, 3), reach, strict=True)]
    padding = [
        draw(st.integers(0, min(n, (size - 1) // 2))) for n, size in zip(reach, sizes, strict=True)
    ]
    output_padding = [draw(st.integers(0, max(stride, d) - 1)) for d in dilation]
    groups = draw(st.sampled_from([1, 2]))
    rng = np.random.default_rng(draw(st.integers(0, 100)))
    weight = rng.integers(-4, 5, (4, 2, *kernel)).astype(np.float32)
    bias = rng.integers(-4, 5, 2 * groups).astype(np.float32)
    x = torch.tensor(rng.integers(-4, 5, (1, 4, 4, 3)), dtype=torch.float64)
    options = {"stride": [stride] * 2, "output_padding": output_padding, "dilation": dilation}
    wanted = F.conv_transpose2d(
        x,
        torch.tensor(weight, dtype=torch.float64),
        torch.tensor(bias, dtype=torch.float64),
        padding=padding,
        groups=groups,
        **options,
    )
    try:
        found = transposed_convolution(
            weight, bias, (4, 3), padding=[*padding, *padding], groups=groups, **options
        )
    except NotImplementedError as error:
        assert "a transposed convolution" in str(error)
        is_whole = all(side % stride == 0 for side in wanted.shape[2:])
        assert not is_whole or "cuts off places" in str(error)
        return
    top, left, bottom, right = found.padding
    assert min(found.padding) >= 0
    small = F.conv2d(
        F.pad(x, (left, right, top, bottom)),
        torch.tensor(found.weight, dtype=torch.float64),
        torch.tensor(found.bias, dtype=torch.float64),
        groups=found.groups,
    )
    torch.testing.assert_close(F.pixel_shuffle(small, found.block), wanted, rtol=0, atol=0)


@pytest.mark.parametrize("side", range(4))
def test_a_transposed_convolution_that_cuts_off_a_side_is_refused(side):
    padding = [0, 0, 0, 0]
    padding[side] = 1
    with pytest.raises(NotImplementedError, match="convolution that cuts off places"):
        transposed_convolution(
            np.ones((4, 2, 1, 1), np.float32),
            None,
            (4, 3),
            stride=(1, 1),
            padding=padding,
            output_padding=(0, 0),
            dilation=(1, 1),
            groups=1,
        )


def test_focus_takes_every_second_row_and_column():
    module = nn.Sequential(Focus(), nn.Conv2d(16, 2, 1)).eval()
    read = layers_from_torch(module, (4, 6, 8))
    check_torch_layers(module, read, (4, 6, 8))


class Indexed(nn.Module):
    def __init__(self, index):
        super().__init__()
        self.index = index

    def forward(self, x):
        return x[self.index]


@pytest.mark.parametrize(
    "module, reason",
    [
        (Indexed((slice(None), [0, 2])), "the index"),
        (Indexed((..., 1, slice(None))), "the index"),
        (nn.Upsample(scale_factor=2, mode="bicubic"), "mode 'bicubic'"),
        (nn.ZeroPad2d(-1), "a padding of"),
        (nn.ConstantPad2d(1, 2.0), "with a value"),
        (nn.Upsample(scale_factor=1.5), "not by one whole number"),
        (nn.ConvTranspose2d(4, 2, 3, 2, 1), "to 11 places by strides of 2"),
        (nn.ConvTranspose2d(4, 2, 2, (2, 1)), "strides [2, 1]"),
    ],
)
def test_what_has_no_form_is_refused_by_its_reason(module, reason):
    with pytest.raises(NotImplementedError, match=reason.replace("[", r"\[")):
        layers_from_torch(nn.Sequential(module, nn.Conv2d(_channels(module), 2, 1)), SHAPE)
