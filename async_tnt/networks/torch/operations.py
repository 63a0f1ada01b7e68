"""The table of the torch forms of all operations.

For each operation of `networks/layers/operations.py` it lists the torch modules, functions and
methods that become this operation, with the rule by which a call becomes layers.
"""

from __future__ import annotations

import operator
from typing import Any

import torch
from tnt_reference import heatmap_centroid
from torch import nn
from torch.nn import functional as F

from async_tnt.networks.torch import arranging, norms, rules
from async_tnt.networks.torch.form import INPLACE, TorchForm, plain_layer, same_layer


class HeatmapCentroid(nn.Module):
    """Heatmaps (N, 1, H, W) to landmarks (N, 2): the mean place under a softmax over all places."""

    def forward(self, exponent: torch.Tensor) -> torch.Tensor:
        landmark: torch.Tensor = heatmap_centroid(exponent)
        return landmark


OPERANDS = ("input", "other")
"""The inputs of a sum or product."""

AVERAGE_POOL = TorchForm(
    rules.average_pool,
    modules=(nn.AvgPool2d,),
    functions=(F.avg_pool2d,),
    parameters={
        "kernel_size": None,
        "stride": None,
        "padding": 0,
        "ceil_mode": False,
        "count_include_pad": True,
        "divisor_override": None,
    },
)

ADAPTIVE_POOL = TorchForm(
    rules.adaptive_pool,
    modules=(nn.AdaptiveAvgPool2d,),
    functions=(F.adaptive_avg_pool2d,),
    parameters={"output_size": None},
)

ADD = TorchForm(
    arranging.add,
    functions=(torch.add, operator.add),
    methods=("add", "add_"),
    parameters={"alpha": 1},
    inputs=OPERANDS,
)

SUBTRACT = TorchForm(
    arranging.subtract,
    functions=(torch.sub, torch.subtract, operator.sub),
    methods=("sub", "sub_"),
    parameters={"alpha": 1},
    inputs=OPERANDS,
)

MULTIPLY = TorchForm(
    arranging.multiply,
    functions=(torch.mul, torch.multiply, operator.mul),
    methods=("mul", "mul_"),
    inputs=OPERANDS,
)

INDEX = TorchForm(
    arranging.index, functions=(operator.getitem,), parameters={"index": None}, may_share=True
)

UPSAMPLE = TorchForm(
    rules.upsample,
    modules=(nn.Upsample, nn.UpsamplingNearest2d, nn.UpsamplingBilinear2d),
    functions=(F.interpolate,),
    parameters={
        "size": None,
        "scale_factor": None,
        "mode": "nearest",
        "align_corners": None,
        "recompute_scale_factor": None,
        "antialias": False,
    },
)

GELU = TorchForm(
    rules.gelu, modules=(nn.GELU,), functions=(F.gelu,), parameters={"approximate": "none"}
)

PAD = TorchForm(
    rules.pad,
    functions=(F.pad,),
    parameters={"pad": None, "mode": "constant", "value": None},
)

FORMS: dict[str, tuple[TorchForm, ...]] = {
    "conv": (
        TorchForm(rules.conv, modules=(nn.Conv2d,)),
        TorchForm(
            rules.conv_function,
            functions=(F.conv2d,),
            parameters={
                "weight": None,
                "bias": None,
                "stride": 1,
                "padding": 0,
                "dilation": 1,
                "groups": 1,
            },
        ),
        TorchForm(
            arranging.sum_of_channels,
            functions=(torch.sum,),
            methods=("sum",),
            parameters={"dim": None, "keepdim": False},
        ),
        TorchForm(rules.conv_transpose, modules=(nn.ConvTranspose2d,)),
        INDEX,
    ),
    "dense": (
        TorchForm(rules.linear, modules=(nn.Linear,)),
        TorchForm(
            rules.linear_function,
            functions=(F.linear,),
            parameters={"weight": None, "bias": None},
        ),
    ),
    "batch_norm": (
        TorchForm(
            rules.batch_norm,
            modules=(nn.BatchNorm1d, nn.BatchNorm2d),
            functions=(F.batch_norm,),
            parameters={
                "running_mean": None,
                "running_var": None,
                "weight": None,
                "bias": None,
                "training": False,
                "momentum": 0.1,
                "eps": 1e-5,
            },
        ),
        ADD,
        SUBTRACT,
        TorchForm(arranging.negative, functions=(torch.neg, operator.neg), methods=("neg", "neg_")),
        MULTIPLY,
        TorchForm(
            arranging.divide,
            functions=(torch.div, torch.divide, operator.truediv),
            methods=("div", "div_"),
            parameters={"rounding_mode": None},
            inputs=OPERANDS,
        ),
    ),
    "relu": (
        TorchForm(
            plain_layer("relu"),
            modules=(nn.ReLU,),
            functions=(torch.relu, torch.relu_, F.relu),
            methods=("relu", "relu_"),
            parameters=INPLACE,
        ),
    ),
    "leaky_relu": (
        TorchForm(
            rules.leaky_relu,
            modules=(nn.LeakyReLU,),
            functions=(F.leaky_relu, F.leaky_relu_),
            parameters={"negative_slope": 0.01, **INPLACE},
        ),
        TorchForm(
            rules.absolute,
            functions=(torch.abs, torch.abs_, torch.absolute),
            methods=("abs", "abs_", "absolute"),
        ),
    ),
    "prelu": (TorchForm(rules.prelu, modules=(nn.PReLU,)),),
    "clip": (
        TorchForm(
            rules.clamp,
            functions=(torch.clamp, torch.clamp_, torch.clip, torch.clip_),
            methods=("clamp", "clamp_", "clip", "clip_"),
            parameters={"min": None, "max": None},
        ),
        TorchForm(
            rules.hardtanh,
            modules=(nn.Hardtanh, nn.ReLU6),
            functions=(F.hardtanh, F.hardtanh_),
            parameters={"min_val": -1.0, "max_val": 1.0, **INPLACE},
        ),
        TorchForm(
            rules.hardtanh,
            functions=(F.relu6,),
            parameters={**INPLACE, "min_val": 0.0, "max_val": 6.0},
        ),
    ),
    "softshrink": (
        TorchForm(
            rules.softshrink,
            modules=(nn.Softshrink,),
            functions=(F.softshrink,),
            parameters={"lambd": 0.5},
        ),
    ),
    "log1p": (
        TorchForm(
            plain_layer("log1p"),
            functions=(torch.log1p, torch.log1p_),
            methods=("log1p", "log1p_"),
            parameters=INPLACE,
        ),
    ),
    "sigmoid": (
        TorchForm(
            plain_layer("sigmoid"),
            modules=(nn.Sigmoid,),
            functions=(torch.sigmoid, torch.sigmoid_, F.sigmoid),
            methods=("sigmoid", "sigmoid_"),
            parameters=INPLACE,
        ),
    ),
    "tanh": (
        TorchForm(
            plain_layer("tanh"),
            modules=(nn.Tanh,),
            functions=(torch.tanh, torch.tanh_, F.tanh),
            methods=("tanh", "tanh_"),
            parameters=INPLACE,
        ),
    ),
    "silu": (
        TorchForm(plain_layer("silu"), modules=(nn.SiLU,), functions=(F.silu,), parameters=INPLACE),
    ),
    "gelu": (GELU,),
    "gelu_tanh": (GELU,),
    "erf": (TorchForm(plain_layer("erf"), functions=(torch.erf,), methods=("erf", "erf_")),),
    "hardswish": (
        TorchForm(
            plain_layer("hardswish"),
            modules=(nn.Hardswish,),
            functions=(F.hardswish,),
            parameters=INPLACE,
        ),
    ),
    "hardsigmoid": (
        TorchForm(
            plain_layer("hardsigmoid"),
            modules=(nn.Hardsigmoid,),
            functions=(F.hardsigmoid,),
            parameters=INPLACE,
        ),
    ),
    "max_pool": (
        TorchForm(
            rules.max_pool,
            modules=(nn.MaxPool2d,),
            functions=(F.max_pool2d, torch.max_pool2d),
            parameters={
                "kernel_size": None,
                "stride": None,
                "padding": 0,
                "dilation": 1,
                "ceil_mode": False,
                "return_indices": False,
            },
        ),
    ),
    "average_pool": (AVERAGE_POOL,),
    "sum_pool": (AVERAGE_POOL,),
    "inside_average_pool": (AVERAGE_POOL,),
    "adaptive_average_pool": (ADAPTIVE_POOL,),
    "global_average_pool": (
        ADAPTIVE_POOL,
        TorchForm(
            rules.mean,
            functions=(torch.mean,),
            methods=("mean",),
            parameters={"dim": None, "keepdim": False},
        ),
    ),
    "depth_to_space": (
        TorchForm(
            arranging.pixel_shuffle,
            modules=(nn.PixelShuffle,),
            functions=(F.pixel_shuffle, torch.pixel_shuffle),
            parameters={"upscale_factor": None},
        ),
        UPSAMPLE,
    ),
    "bilinear_corners": (UPSAMPLE,),
    "expand": (UPSAMPLE,),
    "layer_norm": (
        TorchForm(
            norms.layer_norm,
            modules=(nn.LayerNorm,),
            functions=(F.layer_norm, torch.layer_norm),
            parameters={"normalized_shape": None, "weight": None, "bias": None, "eps": 1e-5},
        ),
    ),
    "group_norm": (
        TorchForm(
            norms.group_norm,
            modules=(nn.GroupNorm,),
            functions=(F.group_norm,),
            parameters={"num_groups": None, "weight": None, "bias": None, "eps": 1e-5},
        ),
        TorchForm(norms.instance_norm, modules=(nn.InstanceNorm2d,)),
    ),
    "zero_pad": (
        TorchForm(
            rules.pad_module("zero_pad"),
            modules=(nn.ZeroPad2d, nn.ConstantPad2d),
            parameters={"padding": None, "value": 0},
        ),
        PAD,
    ),
    "edge_pad": (
        TorchForm(
            rules.pad_module("edge_pad"),
            modules=(nn.ReplicationPad2d,),
            parameters={"padding": None},
        ),
        PAD,
    ),
    "pick": (
        INDEX,
        TorchForm(
            arranging.chunk,
            functions=(torch.chunk,),
            methods=("chunk",),
            parameters={"chunks": None, "dim": 0},
            may_share=True,
        ),
        TorchForm(
            arranging.split,
            functions=(torch.split,),
            methods=("split",),
            parameters={"sizes": None, "dim": 0},
            may_share=True,
        ),
        TorchForm(
            arranging.shuffle_channels,
            modules=(nn.ChannelShuffle,),
            functions=(torch.channel_shuffle, F.channel_shuffle),
            parameters={"groups": None},
        ),
        TorchForm(
            arranging.transpose,
            functions=(torch.transpose,),
            methods=("transpose",),
            parameters={"dim0": None, "dim1": None},
            may_share=True,
        ),
    ),
    "multiply": (MULTIPLY,),
    "add": (ADD, SUBTRACT),
    "concat": (
        TorchForm(
            arranging.stack,
            functions=(torch.stack,),
            parameters={"dim": 0},
            inputs=("tensors",),
        ),
        TorchForm(
            arranging.concatenate,
            functions=(torch.cat, torch.concat, torch.concatenate),
            parameters={"dim": 0},
            inputs=("tensors",),
        ),
    ),
    "flatten": (
        TorchForm(
            arranging.flatten,
            modules=(nn.Flatten,),
            functions=(torch.flatten,),
            methods=("flatten",),
            parameters={"start_dim": 0, "end_dim": -1},
            may_share=True,
        ),
        TorchForm(
            arranging.view,
            functions=(torch.reshape,),
            methods=("view", "reshape"),
            arguments_of=arranging.view_arguments,
            may_share=True,
        ),
    ),
    "heatmap_centroid": (TorchForm(plain_layer("heatmap_centroid"), modules=(HeatmapCentroid,)),),
}
"""Operation -> its torch forms.

The arguments of some calls decide which operation they become. Each of these operations lists the
form of such calls."""

PERMUTE = TorchForm(
    norms.permute,
    functions=(torch.permute,),
    methods=("permute",),
    arguments_of=norms.permute_arguments,
    may_share=True,
)

PASSED_ON = (
    TorchForm(
        rules.dropout,
        modules=(nn.Dropout, nn.Dropout1d, nn.Dropout2d),
        functions=(F.dropout, F.dropout1d, F.dropout2d, torch.dropout),
        parameters={"p": 0.5, "training": True, **INPLACE},
        may_share=True,
    ),
    TorchForm(same_layer, modules=(nn.Identity,), may_share=True),
    TorchForm(
        same_layer, methods=("contiguous",), parameters={"memory_format": None}, may_share=True
    ),
    PERMUTE,
    TorchForm(
        same_layer,
        functions=(torch.clone,),
        methods=("clone",),
        parameters={"memory_format": None},
    ),
)
"""The forms of calls that pass their input on: such a call becomes no layer."""

NUMBER_BY_NUMBER = (
    "relu",
    "leaky_relu",
    "clip",
    "softshrink",
    "log1p",
    "sigmoid",
    "tanh",
    "silu",
    "gelu",
    "erf",
    "hardswish",
    "hardsigmoid",
    "multiply",
    "add",
    "batch_norm",
    "dense",
    "layer_norm",
)
"""Operations whose forms take tensors with their channels last, too, or check it themselves."""

CHANNELS_LAST = [
    form
    for form in (*(form for name in NUMBER_BY_NUMBER for form in FORMS[name]), *PASSED_ON)
    if nn.BatchNorm2d not in form.modules
]
"""The forms of calls that may have an input with its channels last."""

ALL_FORMS = (*(form for forms in FORMS.values() for form in forms), *PASSED_ON)

MODULES: dict[type, TorchForm] = {module: form for form in ALL_FORMS for module in form.modules}

FUNCTIONS: dict[Any, TorchForm] = {
    function: form for form in ALL_FORMS for function in form.functions
}

STOCHASTIC_DEPTH = TorchForm(
    rules.dropout, parameters={"p": 0.5, "mode": "row", "training": True}, may_share=True
)

FUNCTIONS_BY_NAME = {"torchvision.ops.stochastic_depth.stochastic_depth": STOCHASTIC_DEPTH}
"""Functions of packages that are not imported here: module and name -> form."""

METHODS: dict[Any, TorchForm] = {method: form for form in ALL_FORMS for method in form.methods}
