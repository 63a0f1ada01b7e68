"""The fields of NIR nodes, and the layers of nodes without a state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from async_tnt.base.messages import short
from async_tnt.networks.nir.graph import Node


class Source(NamedTuple):
    """What a node reads."""

    is_line: bool
    """Whether the graph's input is a line of pixels, (channels, W) or (W,), without rows."""
    is_pixels_alone: bool
    """Whether it is a vector in NIR, and a map (1, 1, W) here: see `GraphReader`."""


Rule = Callable[[Source, Node], dict[str, Any]]
"""Makes a node's layer: its fields without name and inputs, and `tensors`, role -> weights."""


def title_of(node: Node) -> str:
    """A node in a message: its name and its type."""
    kind = node.kind if node.kind.isidentifier() else short(node.kind)
    return f"node {short(node.name)} ({kind})"


# -- fields of nodes -------------------------------------------------------------------------------


def array_of(node: Node, name: str) -> np.ndarray:
    """A field as an array of numbers."""
    if name not in node.fields:
        raise ValueError(f"it has no field {name!r}")
    try:
        values = np.asarray(node.fields[name])
    except ValueError:  # lists of different lengths
        raise ValueError(f"{name} must be numbers, got {short(node.fields[name])}") from None
    if values.dtype.kind not in "fiu":
        raise ValueError(f"{name} must be numbers, got {short(node.fields[name])}")
    return values


def floats_of(node: Node, name: str) -> np.ndarray:
    """A field as float32."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array_of(node, name), np.float32)


def whole_numbers_of(node: Node, name: str, n: int = 2) -> list[int]:
    """A field of n whole numbers; one number counts for all."""
    values = array_of(node, name)
    is_whole = np.isfinite(values) & (values == np.floor(values))
    if values.size not in (1, n) or not is_whole.all():
        raise ValueError(f"{name} must be {n} whole numbers, got {short(values.tolist())}")
    return [int(value) for value in np.broadcast_to(values.reshape(-1), (n,))]


# -- rules of nodes --------------------------------------------------------------------------------


def _conv_2d(source: Source, node: Node) -> dict[str, Any]:
    _check_axes(source, 2)
    weight = floats_of(node, "weight")
    if weight.ndim != 4:
        raise ValueError(f"weight must be (F, C, ky, kx), got {weight.shape}")
    stride = whole_numbers_of(node, "stride")
    dilation = whole_numbers_of(node, "dilation")
    return _conv(node, weight, stride, dilation, is_line=False)


def _conv_1d(source: Source, node: Node) -> dict[str, Any]:
    """A convolution along a line: one of a map with one row."""
    _check_axes(source, 1)
    weight = floats_of(node, "weight")
    if weight.ndim != 3:
        raise ValueError(f"weight must be (F, C, kx), got {weight.shape}")
    (stride,) = whole_numbers_of(node, "stride", 1)
    (dilation,) = whole_numbers_of(node, "dilation", 1)
    return _conv(node, weight[:, :, np.newaxis, :], [1, stride], [1, dilation], is_line=True)


def _check_axes(source: Source, n_axes: int) -> None:
    """Refuse a node of maps for a line, a node of lines for a map, and both for a vector."""
    if source.is_line == (n_axes == 1) and not source.is_pixels_alone:
        return
    needed = "(1 or 2, W)" if n_axes == 1 else "(1 or 2, H, W)"
    raise ValueError(f"it needs a graph whose input has a shape {needed}")


def _conv(
    node: Node, weight: np.ndarray, stride: list[int], dilation: list[int], is_line: bool
) -> dict[str, Any]:
    """A convolution with weights (F, C, ky, kx). Along a line, its padding has one number."""
    kernel = list(weight.shape[2:])
    tensors = {"weight": weight}
    bias = floats_of(node, "bias") if "bias" in node.fields else np.zeros(0, np.float32)
    if bias.any():
        tensors["bias"] = bias
    return {
        "op": "conv",
        "kernel": kernel,
        "stride": stride,
        "padding": _padding(node, kernel, dilation, is_line),
        "dilation": dilation,
        "groups": whole_numbers_of(node, "groups", 1)[0],
        "tensors": tensors,
    }


def _padding(node: Node, kernel: list[int], dilation: list[int], is_line: bool) -> list[int]:
    """The padding [top, left, bottom, right], which may be "same" or "valid" in NIR."""
    padding = node.fields.get("padding")
    if isinstance(padding, bytes):  # as files hold texts
        padding = padding.decode("utf-8", "replace")
    if isinstance(padding, str):
        if padding == "valid":
            return [0, 0, 0, 0]
        if padding != "same":
            raise ValueError(f"padding must be numbers, 'same' or 'valid', got {short(padding)}")
        reach = [(k - 1) * d for k, d in zip(kernel, dilation, strict=True)]
        top, left = (side // 2 for side in reach)
        return [top, left, reach[0] - top, reach[1] - left]
    if is_line:
        (columns,) = whole_numbers_of(node, "padding", 1)
        return [0, columns, 0, columns]
    rows, columns = whole_numbers_of(node, "padding")
    return [rows, columns, rows, columns]


def _pool(op: str) -> Rule:
    def rule(source: Source, node: Node) -> dict[str, Any]:
        _check_axes(source, 2)
        rows, columns = whole_numbers_of(node, "padding")
        return {
            "op": op,
            "kernel": whole_numbers_of(node, "kernel_size"),
            "stride": whole_numbers_of(node, "stride"),
            "padding": [rows, columns, rows, columns],
        }

    return rule


def _flatten(source: Source, node: Node) -> dict[str, Any]:
    (start,) = whole_numbers_of(node, "start_dim", 1)
    (end,) = whole_numbers_of(node, "end_dim", 1)
    last_axis = 1 if source.is_line else 2
    if source.is_pixels_alone:
        last_axis = 0
    if start != 0 or end not in (-1, last_axis):
        raise NotImplementedError(f"a Flatten from {start} to {end}, not of all axes (0 to -1)")
    return {"op": "flatten"}


def _affine(source: Source, node: Node) -> dict[str, Any]:
    tensors = {"weight": floats_of(node, "weight")}
    bias = floats_of(node, "bias") if "bias" in node.fields else np.zeros(0, np.float32)
    if bias.any():
        tensors["bias"] = bias
    return {"op": "dense", "tensors": tensors}


LINEAR_RULES: dict[str, Rule] = {
    "Conv1d": _conv_1d,
    "Conv2d": _conv_2d,
    "SumPool2d": _pool("sum_pool"),
    "AvgPool2d": _pool("average_pool"),
    "Flatten": _flatten,
    "Affine": _affine,
    "Linear": _affine,
}
"""Type of a node -> its rule."""
