"""Networks to train: a few that suit small sensors and small machines, or the user's own.

Each network is a torch module from volumes (N, C, H, W) to logits (N, n_classes). Two compute maps
instead: logits of classes and of nothing, and boxes of objects. `map` says their sizes,
(N, n_classes + 3, R, C), and `boxes` their middles, too, (N, n_classes + 5, R, C). All layers have
a compiled form.
"""

from __future__ import annotations

import importlib.util
import sys
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import nn

from async_tnt.base.messages import one_line
from async_tnt.networks.torch.operations import HeatmapCentroid

LARGE = 64
"""If the shorter side of a grid has more cells than this, `residual` has one more pooling."""
Build = Callable[[int, tuple[int, int], int], nn.Module]
"""A function (channels of a volume, (width, height) of its grid, number of classes) -> network."""


def thesis(channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """The thesis' classifier: two convolutions with average pooling, two dense layers.

    The thesis does not state the number of channels. The numbers here are our choice.
    """
    width, height = grid
    return nn.Sequential(
        OrderedDict(
            conv1=nn.Conv2d(channels, 16, 3, padding="same"),
            relu1=nn.ReLU(),
            pool1=nn.AvgPool2d(2),
            conv2=nn.Conv2d(16, 32, 3, padding="same"),
            relu2=nn.ReLU(),
            pool2=nn.AvgPool2d(2),
            flatten=nn.Flatten(),
            fc1=nn.Linear(32 * (height // 4) * (width // 4), 64),
            relu3=nn.ReLU(),
            fc2=nn.Linear(64, n_classes),
        )
    )


def conv4(channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """Four convolutions with batch norm, three max poolings, a mean over places, a dense layer."""
    return nn.Sequential(
        *_conv(channels, 16),
        nn.MaxPool2d(2),
        *_conv(16, 32),
        nn.MaxPool2d(2),
        *_conv(32, 64),
        nn.MaxPool2d(2),
        *_conv(64, 64),
        *_head(64, n_classes),
    )


def residual(
    channels: int,
    grid: tuple[int, int],
    n_classes: int,
    widths: tuple[int, int, int, int] = (24, 32, 48, 96),
) -> nn.Module:
    """A 5x5 convolution with stride 2, then two residual blocks between max poolings.

    A large grid has one more pooling, see `LARGE`.

    widths : number of channels of the first convolution, of the two residual blocks, and of the
        last convolution.
    """
    first, second, third, last = widths
    pooling = [nn.MaxPool2d(2)] if min(grid) > LARGE else []
    return nn.Sequential(
        *_conv(channels, first, 5, stride=2),
        *pooling,
        *_conv(first, second),
        nn.MaxPool2d(2),
        Residual(second),
        *_conv(second, third),
        nn.MaxPool2d(2),
        Residual(third),
        nn.MaxPool2d(2),
        *_conv(third, last),
        *_head(last, n_classes, nn.Dropout(0.2)),
    )


def separable(channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """A network with few multiplications: convolutions of single channels, and 1x1 convolutions."""
    return nn.Sequential(
        *_conv(channels, 16),
        nn.MaxPool2d(2),
        *_separable(16, 32),
        nn.MaxPool2d(2),
        *_separable(32, 64),
        nn.MaxPool2d(2),
        *_separable(64, 64),
        *_head(64, n_classes),
    )


def object_map(
    channels: int, grid: tuple[int, int], n_classes: int, n_of_boxes: int = 2
) -> nn.Module:
    """A network that computes a map: a channel for each class, one for nothing, and some for boxes.

    The map has a place for every 4x4 cells of the grid. A place sees about 40x40 cells. The first
    layers have the most channels, because there an event changes few places.

    n_of_boxes : 2, for sizes, or 4, for sizes and middles.
    """
    return nn.Sequential(
        *_conv(channels, 32, 5, stride=2),
        nn.MaxPool2d(2),
        *_conv(32, 64),
        *_conv(64, 64),
        *_conv(64, 48),
        *_conv(48, 32),
        nn.Conv2d(32, n_classes + 1 + n_of_boxes, 1),
    )


NETWORKS: dict[str, tuple[Build, int]] = {
    "thesis": (thesis, 4),
    "conv4": (conv4, 8),
    "residual": (residual, 16),
    "wide": (partial(residual, widths=(32, 48, 64, 128)), 16),
    "separable": (separable, 8),
    "map": (object_map, 8),
    "boxes": (partial(object_map, n_of_boxes=4), 8),
}
"""Name -> the function that builds the network, and the shortest side of a grid that it takes, in
cells."""


class Residual(nn.Module):
    """A residual block: relu(x + bn(conv(relu(bn(conv(x)))))), with bn for a batch norm."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Sequential(*_conv(channels, channels))
        self.second = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1, bias=False), nn.BatchNorm2d(channels)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.relu(x + self.second(self.first(x)))


def _conv(
    channels: int, n_filters: int, side: int = 3, stride: int = 1, groups: int = 1
) -> list[nn.Module]:
    """A convolution, batch norm and ReLU."""
    conv = nn.Conv2d(
        channels, n_filters, side, stride, padding=side // 2, groups=groups, bias=False
    )
    return [conv, nn.BatchNorm2d(n_filters), nn.ReLU()]


def _separable(channels: int, n_filters: int) -> list[nn.Module]:
    """A convolution of each channel by itself, then a 1x1 convolution."""
    return [*_conv(channels, channels, groups=channels), *_conv(channels, n_filters, 1)]


def _head(channels: int, n_classes: int, *between: nn.Module) -> list[nn.Module]:
    """The last layers of a network: the mean over all places, `between`, and a dense layer."""
    return [nn.AdaptiveAvgPool2d(1), nn.Flatten(), *between, nn.Linear(channels, n_classes)]


def landmark_network(channels: int) -> nn.Module:
    """The thesis' landmark regressor: raw volumes (N, C, H, W) to landmarks (N, 2) in grid pixels.

    The weights of the 1x1 convolution start at zero. So before training the landmark is the image
    centre, whatever the events.
    """
    network: Any = nn.Sequential(
        OrderedDict(
            conv1=nn.Conv2d(channels, 20, 3, padding="same"),
            relu1=nn.ReLU(),
            conv2=nn.Conv2d(20, 20, 3, padding="same"),
            relu2=nn.ReLU(),
            conv3=nn.Conv2d(20, 20, 3, padding="same"),
            relu3=nn.ReLU(),
            heatmap=nn.Conv2d(20, 1, 1, bias=False),
            landmark=HeatmapCentroid(),
        )
    )
    nn.init.zeros_(network.heatmap.weight)
    regressor: nn.Module = network
    return regressor


def build_network(name: str, channels: int, grid: tuple[int, int], n_classes: int) -> nn.Module:
    """Build one of `NETWORKS` by its name, or the user's own, see `find_network`.

    Raises
    ------
    ValueError : as `find_network`; the grid is too small; the user's own function fails or returns
        no module.
    """
    build, smallest = find_network(name)
    if min(grid) < smallest:
        raise ValueError(
            f"network {name!r} needs a grid of at least {smallest}x{smallest}, got {grid}"
        )
    try:
        network = build(channels, grid, n_classes)
    except Exception as error:  # anything that the user's own code raises
        raise ValueError(f"{name}: {type(error).__name__}: {one_line(error)}") from error
    if not isinstance(network, nn.Module):
        raise ValueError(f"{name} must return a torch module, got {type(network).__name__}")
    return network


def find_network(name: str) -> tuple[Build, int]:
    """Find the function that builds a network, and the shortest side of a grid that it takes.

    Parameters
    ----------
    name : a name in `NETWORKS`, or "module.py:build": a Python file and a function in it. The
        function gets the arguments of `Build` and returns a module.

    Raises
    ------
    ValueError : the network, the file or the function does not exist, or the file fails.
    """
    if ":" not in name:
        if name not in NETWORKS:
            raise ValueError(
                f"a network must be one of {', '.join(NETWORKS)}, or FILE.py:FUNCTION; got {name!r}"
            )
        return NETWORKS[name]
    file, function = name.rsplit(":", 1)
    path = Path(file)
    if not path.is_file():
        raise ValueError(f"{name}: no file {path}")
    spec = importlib.util.spec_from_file_location(f"async_tnt network {path.stem}", path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{name}: {path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses in the file look for their types there
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # anything that the user's own code raises
        raise ValueError(f"{name}: {type(error).__name__}: {one_line(error)}") from error
    build: Any = getattr(module, function, None)
    if not callable(build):
        raise ValueError(f"{name}: it has no function {function!r}")
    return build, 1  # a user's own network may take any grid
