"""A network given as a list of layers, in torch.

A layer is a mapping with `op`, `name`, `inputs` (names of earlier layers, or "volume") and the
parameters of its op; `weights` maps roles to names of tensors. The last layer's value is the
network's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import nn
from torch.nn import functional as F


class LayerNetwork(nn.Module):
    """Volumes (N, C, H, W) to the value of the last layer, (N, ...).

    Parameters
    ----------
    layers : mappings with `op`, `name`, `inputs` (names of earlier layers, or "volume"), the
        parameters of the op, and `weights`: role -> name of a tensor. Ops: conv, dense, batch_norm,
        relu, leaky_relu, prelu, clip, log1p, sigmoid, tanh, silu, gelu, gelu_tanh, hardswish,
        hardsigmoid, max_pool, average_pool, sum_pool, inside_average_pool, adaptive_average_pool,
        global_average_pool, depth_to_space, add, concat, flatten, heatmap_centroid.
    tensors : name -> weights, parameters of this module. Means and variances of batch_norm are not
        trained.

    Raises
    ------
    ValueError : an op of another name.
    """

    def __init__(self, layers: Sequence[Mapping[str, Any]], tensors: Mapping[str, Any]) -> None:
        super().__init__()
        self.layers = list(layers)
        self.tensors: dict[str, nn.Parameter] = {}
        for layer in layers:
            if layer["op"] not in _OPERATIONS:
                raise ValueError(
                    f"an op of layers must be one of {', '.join(_OPERATIONS)}, got {layer['op']!r}"
                )
            for role, name in layer.get("weights", {}).items():
                if name not in self.tensors:
                    trained = role not in ("mean", "variance")
                    self.tensors[name] = nn.Parameter(
                        torch.as_tensor(tensors[name]).clone(), requires_grad=trained
                    )
        self._parameters_of_layers = nn.ParameterList(self.tensors.values())

    def forward(self, volume: torch.Tensor) -> torch.Tensor:
        """The last layer's value for each `volume`, (N, C, H, W)."""
        values = {"volume": volume}
        for layer in self.layers:
            weights = {role: self.tensors[name] for role, name in layer.get("weights", {}).items()}
            inputs = [values[name] for name in layer["inputs"]]
            values[layer["name"]] = _OPERATIONS[layer["op"]](layer, weights, *inputs)
        return values[self.layers[-1]["name"]]


def _padded(layer: Mapping[str, Any], x: torch.Tensor, value: float = 0.0) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    return F.pad(x, (left, right, top, bottom), value=value) if any(layer["padding"]) else x


def _conv(
    layer: Mapping[str, Any], weights: dict[str, torch.Tensor], x: torch.Tensor
) -> torch.Tensor:
    top, left, bottom, right = layer["padding"]
    symmetric = (top, left) == (bottom, right)  # torch pads these by itself, without a copy
    return F.conv2d(
        x if symmetric else _padded(layer, x),
        weights["weight"],
        weights.get("bias"),
        stride=layer["stride"],
        padding=(top, left) if symmetric else 0,
        dilation=layer["dilation"],
        groups=layer["groups"],
    )


def _batch_norm(
    layer: Mapping[str, Any], weights: dict[str, torch.Tensor], x: torch.Tensor
) -> torch.Tensor:
    return F.batch_norm(
        x,
        weights["mean"],
        weights["variance"],
        weights.get("weight"),
        weights.get("bias"),
        eps=layer["epsilon"],
    )


def _sum_pool(
    layer: Mapping[str, Any], weights: dict[str, torch.Tensor], x: torch.Tensor
) -> torch.Tensor:
    return F.avg_pool2d(_padded(layer, x), layer["kernel"], layer["stride"], divisor_override=1)


def _inside_average_pool(
    layer: Mapping[str, Any], weights: dict[str, torch.Tensor], x: torch.Tensor
) -> torch.Tensor:
    """The sum over each window, by how many of its places lie inside."""
    return _sum_pool(layer, weights, x) / _sum_pool(layer, weights, torch.ones_like(x))


def heatmap_centroid(exponent: torch.Tensor) -> torch.Tensor:
    """l = sum_{y,x} exp(e[y, x]) (x, y) / sum_{y,x} exp(e[y, x]): e is `exponent`, (N, 1, H, W) ->
    (N, 2), float64 (x, y)."""
    e = exponent[..., 0, :, :].double()  # (N, H, W)
    # A common factor does not change the centroid: make the largest cell 1, so that exp cannot
    # overflow.
    h = torch.exp(e - e.detach().amax(dim=(-2, -1), keepdim=True))  # (N, H, W)
    y, x = (torch.arange(side, dtype=torch.float64, device=h.device) for side in h.shape[-2:])
    total = h.sum(dim=(-2, -1))
    return torch.stack(
        [(h.sum(dim=-2) * x).sum(-1) / total, (h.sum(dim=-1) * y).sum(-1) / total], dim=-1
    )


_OPERATIONS: dict[str, Any] = {
    "conv": _conv,
    "dense": lambda layer, w, x: F.linear(x, w["weight"], w.get("bias")),
    "batch_norm": _batch_norm,
    "relu": lambda layer, w, x: F.relu(x),
    "leaky_relu": lambda layer, w, x: F.leaky_relu(x, layer["slope"]),
    "prelu": lambda layer, w, x: F.prelu(x, w["slope"]),
    "clip": lambda layer, w, x: x.clamp(
        -torch.inf if layer["low"] is None else layer["low"],
        torch.inf if layer["high"] is None else layer["high"],
    ),
    "log1p": lambda layer, w, x: torch.log1p(x),
    "sigmoid": lambda layer, w, x: torch.sigmoid(x),
    "tanh": lambda layer, w, x: torch.tanh(x),
    "silu": lambda layer, w, x: F.silu(x),
    "gelu": lambda layer, w, x: F.gelu(x),
    "gelu_tanh": lambda layer, w, x: F.gelu(x, approximate="tanh"),
    "hardswish": lambda layer, w, x: F.hardswish(x),
    "hardsigmoid": lambda layer, w, x: F.hardsigmoid(x),
    "max_pool": lambda layer, w, x: F.max_pool2d(
        _padded(layer, x, -torch.inf), layer["kernel"], layer["stride"]
    ),
    "average_pool": lambda layer, w, x: F.avg_pool2d(
        _padded(layer, x), layer["kernel"], layer["stride"]
    ),
    "sum_pool": _sum_pool,
    "inside_average_pool": _inside_average_pool,
    "adaptive_average_pool": lambda layer, w, x: F.adaptive_avg_pool2d(x, tuple(layer["size"])),
    "global_average_pool": lambda layer, w, x: x.mean(dim=(-2, -1), keepdim=True),
    "depth_to_space": lambda layer, w, x: F.pixel_shuffle(x, layer["block"]),
    "add": lambda layer, w, *inputs: sum(inputs),
    "concat": lambda layer, w, *inputs: torch.cat(inputs, dim=1),
    "flatten": lambda layer, w, x: x.flatten(1),
    "heatmap_centroid": lambda layer, w, x: heatmap_centroid(x),
}
