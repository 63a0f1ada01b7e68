"""Torch's operations that have a compiled form: modules, functions and methods, and how a call
becomes layers."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from tnt_reference import heatmap_centroid
from torch import fx, nn
from torch.nn import functional as F

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.torch.layers import Call, LayerList, float_array


class HeatmapCentroid(nn.Module):
    """Heatmaps (N, 1, H, W) to landmarks (N, 2): the mean place under a softmax over all places."""

    def forward(self, exponent: torch.Tensor) -> torch.Tensor:
        landmark: torch.Tensor = heatmap_centroid(exponent)
        return landmark


def _pair(value: Any) -> list[int]:
    return [int(v) for v in value] if isinstance(value, (tuple, list)) else [int(value)] * 2


def _conv(made: LayerList, call: Call) -> str:
    module = call.module
    expect_form(module.padding_mode == "zeros", f"padding_mode {module.padding_mode!r}")
    kernel, dilation = _pair(module.kernel_size), _pair(module.dilation)
    if module.padding == "same":
        total = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        padding = [n // 2 for n in total] + [n - n // 2 for n in total]
    else:
        padding = 2 * _pair(0 if module.padding == "valid" else module.padding)
    return made.add(
        "conv",
        call,
        weights=made.tensors(call, weight="weight", bias="bias"),
        kernel=kernel,
        stride=_pair(module.stride),
        padding=padding,
        dilation=dilation,
        groups=module.groups,
    )


def _linear(made: LayerList, call: Call) -> str:
    return made.add("dense", call, weights=made.tensors(call, weight="weight", bias="bias"))


def _batch_norm(made: LayerList, call: Call) -> str:
    without = call.module.running_mean is None or call.module.training
    expect_form(not without, "a batch norm that does not use running statistics")
    roles = {"mean": "running_mean", "variance": "running_var", "weight": "weight", "bias": "bias"}
    return made.add(
        "batch_norm", call, weights=made.tensors(call, **roles), epsilon=call.module.eps
    )


def _function(op: str) -> Operation:
    """Of one input, without parameters."""

    def rule(made: LayerList, call: Call) -> str:
        return made.add(op, call)

    return Operation(rule, _FLAG)


def _gelu(made: LayerList, call: Call) -> str:
    expect_form(call["approximate"] in ("none", "tanh"), f"approximate {call['approximate']!r}")
    return made.add("gelu" if call["approximate"] == "none" else "gelu_tanh", call)


def _clip(made: LayerList, call: Call, low: str = "min", high: str = "max") -> str:
    for value in (call[low], call[high]):
        expect_form(value is None or isinstance(value, (int, float)), "a limit that is no number")
    return made.add("clip", call, low=call[low], high=call[high])


def _leaky_relu(made: LayerList, call: Call) -> str:
    return made.add("leaky_relu", call, slope=float(call["negative_slope"]))


def _prelu(made: LayerList, call: Call) -> str:
    return made.add("prelu", call, weights=made.tensors(call, slope="weight"))


def _pool(made: LayerList, call: Call, op: str) -> str:
    kernel, stride = _pair(call["kernel_size"]), _pair(call["stride"] or call["kernel_size"])
    padding = 2 * _pair(call["padding"])
    # as if padded at the end, so far that a last window fits that begins inside
    if call["ceil_mode"]:
        sides = made.shape(call["input"])[1:]
        expect_form(len(sides) == 2, "a pooling of a vector")
        for axis, (side, reach, step, before) in enumerate(
            zip(sides, kernel, stride, padding[:2], strict=True)
        ):
            last = min(math.ceil((side + 2 * before - reach) / step), (side + before - 1) // step)
            padding[2 + axis] = max(padding[2 + axis], last * step + reach - before - side)
    return made.add(op, call, kernel=kernel, stride=stride, padding=padding)


def _max_pool(made: LayerList, call: Call) -> str:
    expect_form(_pair(call["dilation"]) == [1, 1], "dilation")
    expect_form(not call.arguments.get("return_indices"), "return_indices")
    return _pool(made, call, "max_pool")


def _average_pool(made: LayerList, call: Call) -> str:
    padded, counted = any(_pair(call["padding"])), bool(call["count_include_pad"])
    if call["divisor_override"] is not None:
        expect_form(call["divisor_override"] == 1, "divisor_override")
        return _pool(made, call, "sum_pool")
    expect_form(
        not (call["ceil_mode"] and padded and counted), "ceil_mode with padding that counts"
    )
    inside = call["ceil_mode"] or (padded and not counted)
    return _pool(made, call, "inside_average_pool" if inside else "average_pool")


def _adaptive_pool(made: LayerList, call: Call) -> str:
    size = call["output_size"]
    if size in (1, (1, 1), [1, 1]):
        return made.add("global_average_pool", call)
    sizes = size if isinstance(size, (tuple, list)) else (size, size)
    sides = made.shape(call["input"])[1:]
    expect_form(len(sides) == len(sizes) == 2, f"an output size of {size} here")
    if sizes[0] is sizes[1] is None:
        return _same(made, call)
    return made.add(
        "adaptive_average_pool",
        call,
        size=[s or side for s, side in zip(sizes, sides, strict=True)],
    )


def _mean(made: LayerList, call: Call) -> str:
    axes = call["dim"]
    axes = sorted(axis % 4 for axis in axes) if isinstance(axes, (tuple, list)) else axes
    expect_form(axes == [2, 3], f"a mean over {axes}, not over all places (2, 3),")
    pooled = made.add("global_average_pool", call)
    return pooled if call["keepdim"] else made.add("flatten", call, [pooled])


def _add(made: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None:
        return made.add("add", call, [call["input"], call["other"]])
    return _affine(made, call, x, shift=constant)


def _sub(made: LayerList, call: Call) -> str:
    expect_form(call.arguments.get("alpha", 1) == 1, "a factor alpha")
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"]:
        raise NotImplementedError(
            "a difference other than a map less a constant has no compiled form"
        )
    return _affine(made, call, x, shift=-constant)


def _mul(made: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None:
        raise NotImplementedError("a product of two maps has no compiled form")
    return _affine(made, call, x, factor=constant)


def _div(made: LayerList, call: Call) -> str:
    x, constant = _with_constant(call)
    if constant is None or x is not call["input"] or call.arguments.get("rounding_mode"):
        raise NotImplementedError("a quotient other than a map by a constant has no compiled form")
    return _affine(made, call, x, factor=1 / constant)


def _with_constant(call: Call) -> tuple[Any, torch.Tensor | None]:
    """The two operands: what is computed from the volume first, and the other one where it is a
    constant."""
    x, other = call["input"], call["other"]
    if isinstance(other, fx.Node):
        x, other = other, x
    if isinstance(other, (int, float)):
        return x, torch.tensor(float(other), dtype=torch.float64)
    return x, other.detach() if isinstance(other, torch.Tensor) else None


def _affine(made: LayerList, call: Call, x: Any, factor: Any = None, shift: Any = None) -> str:
    """As a batch norm: a constant of one number, or of one for each channel."""
    channels, *sides = made.shape(x)
    weights = {}
    for role, values in {
        "weight": factor,
        "bias": shift,
        "mean": torch.zeros(1),
        "variance": torch.ones(1),
    }.items():
        if values is None:
            continue
        shape = list(values.shape)
        while shape[:1] == [1]:
            del shape[0]
        expect_form(
            shape in ([], [channels, *[1] * len(sides)]),
            f"a constant of shape {list(values.shape)} here",
        )
        weights[role] = f"{made.prefix}{call.node.name}().{role}"  # unlike any module's
        made.weights[weights[role]] = float_array(values.reshape(-1).expand(channels))
    return made.add("batch_norm", call, [x], weights=weights, epsilon=0.0)


def _cat(made: LayerList, call: Call) -> str:
    expect_form(
        call["dim"] in (1, -3), f"a concatenation along axis {call['dim']}, not of channels (1),"
    )
    expect_form(isinstance(call["tensors"], (tuple, list)), "a concatenation of other than a list")
    return made.add("concat", call, call["tensors"])


def _flatten(made: LayerList, call: Call) -> str:
    axes = (call["start_dim"], call["end_dim"])
    expect_form(axes == (1, -1), f"a flatten from axis {axes[0]} to {axes[1]}, not from 1 to -1,")
    return made.add("flatten", call)


def _view(made: LayerList, call: Call) -> str:
    """x.view(n, -1), with the batch's size, or 1; or (-1, m), where `check_torch_layers` finds out
    whether m fits."""
    shape = call["shape"]
    n, m = shape if len(shape) == 2 else (None, None)
    expect_form(
        isinstance(m, int) and (n in (1, -1) or _is_batch_size(n)),
        "a view other than (n, -1), one row a volume,",
    )
    return made.add("flatten", call)


def _is_batch_size(node: Any) -> bool:
    """x.size(0), x.size()[0], x.shape[0]."""
    if not isinstance(node, fx.Node):
        return False
    if node.target is operator.getitem:
        of, index = node.args
        return (
            isinstance(of, fx.Node)
            and (of.target is getattr or len(of.args) == 1)
            and bool(index == 0)
        )
    return node.target == "size" and list(node.args[1:]) == [0]


def _same(made: LayerList, call: Call) -> str:
    return made.source(call["input"])


def _dropout(made: LayerList, call: Call) -> str:
    expect_form(not call["training"], "a dropout in training mode, also in evaluation,")
    return _same(made, call)


@dataclass(frozen=True)
class Operation:
    """How an operation becomes layers, and its arguments."""

    rule: Callable[[LayerList, Call], str]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """After the inputs, in torch's order: name -> default. A module has them as attributes."""
    inputs: tuple[str, ...] = ("input",)
    may_share: bool = False
    """Whether its result may lie in the memory of its input, as a view does."""

    def arguments(self, node: fx.Node, module: nn.Module | None) -> dict[str, Any]:
        if self.rule is _view:
            shape = node.args[1:] or tuple(node.kwargs.values())
            return {
                "input": node.args[0],
                "shape": shape[0] if isinstance(shape[0], (tuple, list)) else shape,
            }
        names = [*self.inputs, *([*self.parameters, "out"] if module is None else [])]
        given = {**dict(zip(names, node.args, strict=False)), **node.kwargs}
        unknown = [*node.args[len(names) :], *(name for name in given if name not in names)]
        expect_form(not unknown, f"the argument {unknown[0]!r}" if unknown else "")
        return {
            **{name: getattr(module, name, default) for name, default in self.parameters.items()},
            **given,
        }


_FLAG = {"inplace": False}
_POOL = {"kernel_size": None, "stride": None, "padding": 0}
HARDTANH = Operation(
    partial(_clip, low="min_val", high="max_val"), {"min_val": -1.0, "max_val": 1.0, **_FLAG}
)
CLAMP = Operation(_clip, {"min": None, "max": None})
LEAKY_RELU = Operation(_leaky_relu, {"negative_slope": 0.01, **_FLAG})
MAX_POOL = Operation(
    _max_pool, {**_POOL, "dilation": 1, "ceil_mode": False, "return_indices": False}
)
AVERAGE_POOL = Operation(
    _average_pool,
    {**_POOL, "ceil_mode": False, "count_include_pad": True, "divisor_override": None},
)
ADAPTIVE_POOL = Operation(_adaptive_pool, {"output_size": None})
MEAN = Operation(_mean, {"dim": None, "keepdim": False})
TWO = ("input", "other")
ADD, SUB = (Operation(rule, {"alpha": 1}, inputs=TWO) for rule in (_add, _sub))
MUL, DIV = Operation(_mul, inputs=TWO), Operation(_div, {"rounding_mode": None}, inputs=TWO)
GELU = Operation(_gelu, {"approximate": "none"})
RELU, SIGMOID, TANH, LOG1P = map(_function, ("relu", "sigmoid", "tanh", "log1p"))
SILU, HARDSWISH, HARDSIGMOID = map(_function, ("silu", "hardswish", "hardsigmoid"))
PIXEL_SHUFFLE = Operation(
    lambda made, call: made.add("depth_to_space", call, block=call["upscale_factor"]),
    {"upscale_factor": None},
)
CAT = Operation(_cat, {"dim": 0}, inputs=("tensors",))
FLATTEN = Operation(_flatten, {"start_dim": 0, "end_dim": -1}, may_share=True)
VIEW = Operation(_view, may_share=True)
DROPOUT = Operation(_dropout, {"p": 0.5, "training": True, **_FLAG}, may_share=True)

MODULES: dict[type, Operation] = {
    nn.Conv2d: Operation(_conv),
    nn.Linear: Operation(_linear),
    **dict.fromkeys((nn.BatchNorm1d, nn.BatchNorm2d), Operation(_batch_norm)),
    nn.ReLU: RELU,
    **dict.fromkeys((nn.Hardtanh, nn.ReLU6), HARDTANH),
    nn.LeakyReLU: LEAKY_RELU,
    nn.PReLU: Operation(_prelu),
    nn.Sigmoid: SIGMOID,
    nn.Tanh: TANH,
    nn.SiLU: SILU,
    nn.GELU: GELU,
    nn.Hardswish: HARDSWISH,
    nn.Hardsigmoid: HARDSIGMOID,
    nn.MaxPool2d: MAX_POOL,
    nn.AvgPool2d: AVERAGE_POOL,
    nn.AdaptiveAvgPool2d: ADAPTIVE_POOL,
    nn.PixelShuffle: PIXEL_SHUFFLE,
    nn.Flatten: FLATTEN,
    **dict.fromkeys((nn.Dropout, nn.Dropout1d, nn.Dropout2d), DROPOUT),
    nn.Identity: Operation(_same, may_share=True),
    HeatmapCentroid: _function("heatmap_centroid"),
}
"""By the very type: a subclass may compute anything."""
FUNCTIONS: dict[Any, Operation] = {
    **dict.fromkeys((torch.relu, torch.relu_, F.relu), RELU),
    F.relu6: Operation(HARDTANH.rule, {**_FLAG, "min_val": 0.0, "max_val": 6.0}),
    **dict.fromkeys((F.hardtanh, F.hardtanh_), HARDTANH),
    **dict.fromkeys((torch.clamp, torch.clamp_, torch.clip, torch.clip_), CLAMP),
    **dict.fromkeys((F.leaky_relu, F.leaky_relu_), LEAKY_RELU),
    **dict.fromkeys((F.max_pool2d, torch.max_pool2d), MAX_POOL),
    F.avg_pool2d: AVERAGE_POOL,
    F.adaptive_avg_pool2d: ADAPTIVE_POOL,
    torch.mean: MEAN,
    **dict.fromkeys((torch.add, operator.add), ADD),
    **dict.fromkeys((torch.sub, torch.subtract, operator.sub), SUB),
    **dict.fromkeys((torch.mul, torch.multiply, operator.mul), MUL),
    **dict.fromkeys((torch.div, torch.divide, operator.truediv), DIV),
    **dict.fromkeys((torch.sigmoid, torch.sigmoid_, F.sigmoid), SIGMOID),
    **dict.fromkeys((torch.tanh, torch.tanh_, F.tanh), TANH),
    **dict.fromkeys((torch.log1p, torch.log1p_), LOG1P),
    F.silu: SILU,
    F.gelu: GELU,
    F.hardswish: HARDSWISH,
    F.hardsigmoid: HARDSIGMOID,
    **dict.fromkeys((torch.cat, torch.concat, torch.concatenate), CAT),
    **dict.fromkeys((F.pixel_shuffle, torch.pixel_shuffle), PIXEL_SHUFFLE),
    torch.flatten: FLATTEN,
    **dict.fromkeys((F.dropout, F.dropout1d, F.dropout2d, torch.dropout), DROPOUT),
}
"""By the very function: one of the user's may have the same name."""
METHODS: dict[Any, Operation] = {
    **dict.fromkeys(("relu", "relu_"), RELU),
    **dict.fromkeys(("clamp", "clamp_", "clip", "clip_"), CLAMP),
    "mean": MEAN,
    **dict.fromkeys(("add", "add_"), ADD),
    **dict.fromkeys(("sub", "sub_"), SUB),
    **dict.fromkeys(("mul", "mul_"), MUL),
    **dict.fromkeys(("div", "div_"), DIV),
    **dict.fromkeys(("sigmoid", "sigmoid_"), SIGMOID),
    **dict.fromkeys(("tanh", "tanh_"), TANH),
    **dict.fromkeys(("log1p", "log1p_"), LOG1P),
    "flatten": FLATTEN,
    **dict.fromkeys(("view", "reshape"), VIEW),
    "contiguous": Operation(_same, {"memory_format": None}, may_share=True),
}
