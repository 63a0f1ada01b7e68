"""A network given as a list of layers, in torch.

A layer is a mapping with `op`, `name`, `inputs` (names of earlier layers, or "volume") and the
parameters of its op; `weights` maps roles to names of tensors. The last layer's value is the
network's value, unless other outputs are named. The table `OPERATIONS` at the end lists the ops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import torch
from torch import nn
from torch.nn import functional as F

Layer = Mapping[str, Any]

Weights = Mapping[str, torch.Tensor]
"""Role -> weights."""


class LayerNetwork(nn.Module):
    """A module that computes the values of layers, (N, ...), from volumes (N, C, H, W).

    Parameters
    ----------
    layers : the layers in the form that the docstring of this file describes.
    tensors : name -> weights. They become parameters of this torch module. The means and variances
        of batch norms are not trained.
    outputs : the layers whose values, as a tuple, are the network's value. None: the last layer's
        value alone is.

    Raises
    ------
    ValueError : a layer has an op that is not in the table.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        tensors: Mapping[str, Any],
        outputs: Sequence[str] | None = None,
    ) -> None:
        super().__init__()
        self.outputs = outputs
        self.layers = list(layers)
        self.tensors: dict[str, nn.Parameter] = {}
        for layer in layers:
            if layer["op"] not in OPERATIONS:
                raise ValueError(
                    f"an op of layers must be one of {', '.join(OPERATIONS)}, got {layer['op']!r}"
                )
            for role, name in layer.get("weights", {}).items():
                if name not in self.tensors:
                    values = torch.as_tensor(tensors[name]).clone()
                    is_trained = role not in ("mean", "variance")
                    self.tensors[name] = nn.Parameter(values, requires_grad=is_trained)
        # torch does not look for parameters in a dictionary: this list registers them
        self._parameters_of_layers = nn.ParameterList(self.tensors.values())

    def forward(self, volume: torch.Tensor) -> Any:
        """The value for each `volume`, (N, C, H, W): a tensor, or a tuple of the `outputs`."""
        values = {"volume": volume}
        for layer in self.layers:
            weights = {role: self.tensors[name] for role, name in layer.get("weights", {}).items()}
            inputs = [values[name] for name in layer["inputs"]]
            values[layer["name"]] = OPERATIONS[layer["op"]](layer, weights, *inputs)
        if self.outputs is not None:
            return tuple(values[name] for name in self.outputs)
        return values[self.layers[-1]["name"]]


# -- with weights ----------------------------------------------------------------------------------


def _conv(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    if (top, left) == (bottom, right):
        padding = (top, left)  # torch adds a symmetric padding by itself, without a copy
    else:
        x = _padded(layer, x)
        padding = (0, 0)
    return F.conv2d(
        x,
        weights["weight"],
        weights.get("bias"),
        stride=layer["stride"],
        padding=padding,
        dilation=layer["dilation"],
        groups=layer["groups"],
    )


def _dense(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.linear(x, weights["weight"], weights.get("bias"))


def _batch_norm(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.batch_norm(
        x,
        weights["mean"],
        weights["variance"],
        weights.get("weight"),
        weights.get("bias"),
        eps=layer["epsilon"],
    )


# -- activations -----------------------------------------------------------------------------------


def _leaky_relu(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.leaky_relu(x, layer["slope"])


def _prelu(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.prelu(x, weights["slope"])


def _clip(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    low = -torch.inf if layer["low"] is None else layer["low"]
    high = torch.inf if layer["high"] is None else layer["high"]
    return x.clamp(low, high)


def _softshrink(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.softshrink(x, layer["lambd"])


def _gelu_tanh(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.gelu(x, approximate="tanh")


def _function(function: Callable[[torch.Tensor], torch.Tensor]) -> Operation:
    """An op of one input, without parameters."""

    def operation(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
        return function(x)

    return operation


# -- pooling ---------------------------------------------------------------------------------------


def _padded(layer: Layer, x: torch.Tensor, value: float = 0.0) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    if not any(layer["padding"]):
        return x
    return F.pad(x, (left, right, top, bottom), value=value)


def _max_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.max_pool2d(_padded(layer, x, -torch.inf), layer["kernel"], layer["stride"])


def _average_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.avg_pool2d(_padded(layer, x), layer["kernel"], layer["stride"])


def _sum_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.avg_pool2d(_padded(layer, x), layer["kernel"], layer["stride"], divisor_override=1)


def _inside_average_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    """The sum over each window, divided by the number of its places inside the input."""
    return _sum_pool(layer, weights, x) / _sum_pool(layer, weights, torch.ones_like(x))


def _adaptive_average_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.adaptive_avg_pool2d(x, tuple(layer["size"]))


def _global_average_pool(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return x.mean(dim=(-2, -1), keepdim=True)


# -- joining, the order of numbers -----------------------------------------------------------------


def _zero_pad(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return _padded(layer, x)


def _edge_pad(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    return F.pad(x, (left, right, top, bottom), mode="replicate")


def _depth_to_space(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return F.pixel_shuffle(x, layer["block"])


def _layer_norm(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    last = x.movedim(1, -1)  # F.layer_norm is over the last axis
    given = (weights.get("weight"), weights.get("bias"))
    return F.layer_norm(last, last.shape[-1:], *given, eps=layer["epsilon"]).movedim(-1, 1)


def _group_norm(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    given = (weights.get("weight"), weights.get("bias"))
    return F.group_norm(x, layer["groups"], *given, eps=layer["epsilon"])


def _bilinear_corners(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    block = layer["block"]
    sides = (block * x.shape[2], block * x.shape[3])
    return F.interpolate(x, size=sides, mode="bilinear", align_corners=True)


def _expand(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return x.expand(-1, -1, *layer["size"])


def _pick(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return x[:, layer["channels"]]


def _multiply(layer: Layer, weights: Weights, x: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    return x * other


def _add(layer: Layer, weights: Weights, *inputs: torch.Tensor) -> torch.Tensor:
    return cast(torch.Tensor, sum(inputs))


def _concat(layer: Layer, weights: Weights, *inputs: torch.Tensor) -> torch.Tensor:
    return torch.cat(inputs, dim=1)


def _flatten(layer: Layer, weights: Weights, x: torch.Tensor) -> torch.Tensor:
    return x.flatten(1)


def heatmap_centroid(exponent: torch.Tensor) -> torch.Tensor:
    """The mean place (x, y) of each heatmap exp(e), float64, shape (N, 2).

    The exponents e are `exponent`, (N, 1, H, W).

    l = sum_{y,x} exp(e[y, x]) (x, y) / sum_{y,x} exp(e[y, x])
    """
    e = exponent[..., 0, :, :].double()  # (N, H, W)
    # A common factor does not change the centroid. It is chosen so that the largest cell is 1, and
    # exp cannot overflow.
    h = torch.exp(e - e.detach().amax(dim=(-2, -1), keepdim=True))  # (N, H, W)
    height, width = h.shape[-2:]
    y = torch.arange(height, dtype=torch.float64, device=h.device)
    x = torch.arange(width, dtype=torch.float64, device=h.device)
    total = h.sum(dim=(-2, -1))  # (N,)
    mean_x = (h.sum(dim=-2) * x).sum(-1) / total
    mean_y = (h.sum(dim=-1) * y).sum(-1) / total
    return torch.stack([mean_x, mean_y], dim=-1)


Operation = Callable[..., torch.Tensor]
"""Layer, its weights, its inputs; returns the layer's value."""

OPERATIONS: dict[str, Operation] = {
    "conv": _conv,
    "dense": _dense,
    "batch_norm": _batch_norm,
    "relu": _function(F.relu),
    "leaky_relu": _leaky_relu,
    "prelu": _prelu,
    "clip": _clip,
    "softshrink": _softshrink,
    "log1p": _function(torch.log1p),
    "sigmoid": _function(torch.sigmoid),
    "tanh": _function(torch.tanh),
    "silu": _function(F.silu),
    "gelu": _function(F.gelu),
    "gelu_tanh": _gelu_tanh,
    "hardswish": _function(F.hardswish),
    "erf": _function(torch.erf),
    "hardsigmoid": _function(F.hardsigmoid),
    "max_pool": _max_pool,
    "average_pool": _average_pool,
    "sum_pool": _sum_pool,
    "inside_average_pool": _inside_average_pool,
    "adaptive_average_pool": _adaptive_average_pool,
    "global_average_pool": _global_average_pool,
    "zero_pad": _zero_pad,
    "edge_pad": _edge_pad,
    "depth_to_space": _depth_to_space,
    "layer_norm": _layer_norm,
    "group_norm": _group_norm,
    "bilinear_corners": _bilinear_corners,
    "expand": _expand,
    "pick": _pick,
    "multiply": _multiply,
    "add": _add,
    "concat": _concat,
    "flatten": _flatten,
    "heatmap_centroid": _function(heatmap_centroid),
}
"""Op -> the function that computes it."""
