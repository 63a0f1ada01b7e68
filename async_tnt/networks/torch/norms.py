"""The rules of torch's norms over channels, and of tensors with their channels last."""

from __future__ import annotations

from typing import Any

from async_tnt.networks.layers.conversion_check import expect_form
from async_tnt.networks.torch.layers import Call, LayerList, float_array

TO_LAST = [0, 2, 3, 1]
"""The permutation that puts the channels of (N, C, H, W) last."""

TO_FIRST = [0, 3, 1, 2]
"""The permutation that puts them back."""


def permute(layer_list: LayerList, call: Call) -> str:
    """Note that the channels are last, or again the second axis: no layer is added."""
    axes = call["dims"]
    node = call["input"]
    is_last = node in layer_list.channels_last
    expect_form(axes == (TO_FIRST if is_last else TO_LAST), f"a permutation by {axes}")
    if not is_last:
        layer_list.channels_last.add(call.node)
    return layer_list.source(node)


def permute_arguments(node: Any) -> dict[str, Any]:
    """The axes of a permutation, which may be given as numbers, as a list, or by name."""
    axes = node.args[1:] or tuple(node.kwargs.values())
    if isinstance(axes[0], (tuple, list)):
        axes = tuple(axes[0])
    return {"input": node.args[0], "dims": [axis % 4 for axis in axes]}


def layer_norm(layer_list: LayerList, call: Call) -> str:
    """Add a layer norm over the channels, which must be the last axis."""
    channels, *sides = layer_list.shape(call["input"])
    shape = call["normalized_shape"]
    are_last = not sides or call["input"] in layer_list.channels_last
    is_over_channels = are_last and list(shape) == [channels]
    words = f"a layer norm over {list(shape)}, not over the channels as last axis,"
    expect_form(is_over_channels, words)
    return layer_list.add(
        "layer_norm", call, weights=_weights(layer_list, call), epsilon=float(call["eps"])
    )


def group_norm(layer_list: LayerList, call: Call) -> str:
    return layer_list.add(
        "group_norm",
        call,
        weights=_weights(layer_list, call),
        groups=int(call["num_groups"]),
        epsilon=float(call["eps"]),
    )


def instance_norm(layer_list: LayerList, call: Call) -> str:
    """Add a group norm with one channel in each group."""
    module = call.module
    expect_form(not module.track_running_stats, "an instance norm with running statistics")
    channels = layer_list.shape(call["input"])[0]
    return layer_list.add(
        "group_norm",
        call,
        weights=_weights(layer_list, call),
        groups=channels,
        epsilon=float(module.eps),
    )


def linear_of_last(layer_list: LayerList, call: Call, weight: Any, bias: Any) -> str:
    """Add a convolution of one place for a dense layer over the channels as last axis."""
    # no module's tensor has () in its name
    prefix = f"{layer_list.prefix}{call.node.name}()"
    weights = {}
    for role, tensor in (("weight", weight), ("bias", bias)):
        if tensor is not None:
            values = float_array(tensor)
            weights[role] = f"{prefix}.{role}"
            layer_list.weights[weights[role]] = (
                values[:, :, None, None] if role == "weight" else values
            )
    return layer_list.add(
        "conv",
        call,
        weights=weights,
        kernel=[1, 1],
        stride=[1, 1],
        padding=[0, 0, 0, 0],
        dilation=[1, 1],
        groups=1,
    )


def _weights(layer_list: LayerList, call: Call) -> dict[str, str]:
    """The weight and the bias of a norm, of a module or of a function."""
    if call.module is not None:
        return layer_list.tensors(call, weight="weight", bias="bias")
    return layer_list.constants(call, weight="weight", bias="bias")
