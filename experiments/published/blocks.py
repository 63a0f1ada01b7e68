"""Parts that several networks of event cameras share."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

Activation = Callable[[], nn.Module]
"""Makes an activation."""


def conv(
    inputs: int,
    outputs: int,
    kernel: int = 3,
    stride: int = 1,
    activation: Activation | None = nn.ReLU,
    *,
    norm: bool = False,
    groups: int = 1,
) -> nn.Sequential:
    """A convolution that keeps the size at stride 1, then batch norm and activation if wanted."""
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=not norm)
    ]
    if norm:
        layers.append(nn.BatchNorm2d(outputs))
    if activation is not None:
        layers.append(activation())
    return nn.Sequential(*layers)


def vgg(inputs: int, widths: Sequence[int | str], *, norm: bool = False) -> nn.Sequential:
    """Convolutions 3x3 of these widths; "M" is a max pooling of 2x2."""
    layers: list[nn.Module] = []
    for width in widths:
        if isinstance(width, str):
            layers.append(nn.MaxPool2d(2))
        else:
            layers.append(conv(inputs, width, norm=norm))
            inputs = width
    return nn.Sequential(*layers)


class Residual(nn.Module):
    """Two convolutions, whose result is added to the input."""

    def __init__(self, channels: int, *, norm: bool = False) -> None:
        super().__init__()
        self.body = nn.Sequential(
            conv(channels, channels, norm=norm),
            conv(channels, channels, activation=None, norm=norm),
        )

    def forward(self, x: Tensor) -> Tensor:
        """x + body(x), behind a ReLU."""
        return torch.relu(x + self.body(x))


class Up(nn.Module):
    """Twice the size, by the nearest place or bilinearly, and a convolution."""

    def __init__(self, inputs: int, outputs: int, mode: str = "bilinear", kernel: int = 3) -> None:
        super().__init__()
        corners = False if mode == "bilinear" else None
        self.up = nn.Upsample(scale_factor=2, mode=mode, align_corners=corners)
        self.conv = conv(inputs, outputs, kernel)

    def forward(self, x: Tensor) -> Tensor:
        """The larger map."""
        result: Tensor = self.conv(self.up(x))
        return result


class UNet(nn.Module):
    """An encoder of strided convolutions, and a decoder that gets the encoder's maps again.

    Parameters
    ----------
    widths : channels of the first convolution and of each level of the encoder.
    outputs : channels of the result, at the input's size.
    join : "concat" or "add": how a map of the encoder is joined.
    up : "bilinear", "nearest" or "transposed".
    n_residual : number of residual blocks between both.
    """

    def __init__(
        self,
        inputs: int,
        widths: Sequence[int],
        outputs: int,
        *,
        join: str = "concat",
        up: str = "bilinear",
        n_residual: int = 2,
        kernel: int = 3,
        norm: bool = False,
    ) -> None:
        super().__init__()
        self.join = join
        self.head = conv(inputs, widths[0], kernel, norm=norm)
        self.down = nn.ModuleList(
            conv(a, b, kernel, 2, norm=norm) for a, b in itertools.pairwise(widths)
        )
        self.middle = nn.Sequential(*(Residual(widths[-1], norm=norm) for _ in range(n_residual)))
        self.up = nn.ModuleList()
        for a, b in zip(widths[:0:-1], widths[-2::-1], strict=True):
            joined = 2 * a if join == "concat" else a
            if up == "transposed":
                transposed = nn.ConvTranspose2d(joined, b, 2, 2)
                self.up.append(nn.Sequential(transposed, nn.ReLU()))
            else:
                self.up.append(Up(joined, b, up, kernel))
        self.last = nn.Conv2d(2 * widths[0] if join == "concat" else widths[0], outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        """The result, of the input's size."""
        x = self.head(x)
        maps = [x]
        for down in self.down:
            x = down(x)
            maps.append(x)
        x = self.middle(x)
        for up in self.up:
            x = up(self._joined(x, maps.pop()))
        result: Tensor = self.last(self._joined(x, maps.pop()))
        return result

    def _joined(self, x: Tensor, other: Tensor) -> Tensor:
        return torch.cat([x, other], 1) if self.join == "concat" else x + other
