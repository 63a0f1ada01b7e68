"""Torch modules that are made at random from what people write.

Layers and functions are in place or not, shared, hooked, or of own classes. There are views, and
results that nobody reads. Each module can be made again from its seed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import fx, nn
from torch.nn import functional as F

SHAPE = (3, 12, 11)
SMOOTH = nn.Sigmoid, nn.Tanh, nn.SiLU, nn.Hardswish, nn.Hardsigmoid
N_CLASSES = 4


class ReLU(nn.ReLU):
    """Named like torch's, and another function."""

    def forward(self, x):
        return super().forward(x).clamp(max=2.0)


class Conv2d(nn.Conv2d):
    def forward(self, x):
        return 1.01 * super().forward(x)


class Plain(nn.Module):
    """A class of one's own that is made of known operations."""

    def forward(self, x):
        return F.leaky_relu(x, 0.3)


class NormFunction(nn.Module):
    """F.batch_norm with the tensors of a batch norm."""

    def __init__(self, norm):
        super().__init__()
        self.norm = norm

    def forward(self, x):
        norm = self.norm
        return F.batch_norm(x, norm.running_mean, norm.running_var, norm.weight, norm.bias)


def relu(x):
    return torch.tanh(x)


def scale_(x):
    return x.mul_(0.5)


fx.wrap("relu")
fx.wrap("scale_")


@dataclass
class Step:
    """value[out] = run(module, *values)"""

    run: object
    inputs: list[int]
    result: bool = True
    """Whether the value is kept; else only what it does in place has an effect."""


class RandomModule(nn.Module):
    def __init__(self, steps: list[Step], parts: list[nn.Module]) -> None:
        super().__init__()
        self.steps = steps
        self.parts = nn.ModuleList(parts)

    def forward(self, x):
        values = [x]
        for step in self.steps:
            value = step.run(self, *(values[k] for k in step.inputs))
            if step.result:
                values.append(value)
        return values[-1]


def is_wild(seed: int) -> bool:
    """A third of the modules: in place, hooks, own classes, shared and functional layers."""
    return seed % 3 == 0


class _Builder:
    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        torch.manual_seed(seed)
        self.parts: list[nn.Module] = []
        self.steps: list[Step] = []
        self.wild = is_wild(seed)
        self.shapes = [SHAPE]

    def pick(self, *choices):
        return choices[self.rng.integers(len(choices))]

    def chance(self, share: float) -> bool:
        return self.wild and self.rng.random() < share

    def part(self, module: nn.Module):
        """A call of a layer, kept in the module."""
        if self.chance(0.06):
            hook = self.pick(lambda m, i, o: o.clamp(max=2.0), lambda m, i, o: None)
            module.register_forward_hook(hook)
        elif self.chance(0.03):
            module.register_forward_pre_hook(lambda m, i: (i[0].clamp(-6, 6),))
        elif self.chance(0.02):
            module.forward = lambda x, own=module.forward: own(x) * 1.5
        self.parts.append(module)
        return self.call(len(self.parts) - 1)

    @staticmethod
    def call(k: int):
        return lambda module, x: module.parts[k](x)

    def add(self, run, *inputs: int, result: bool = True) -> None:
        """A step, unless it fails on these values."""
        step = Step(run, list(inputs), result)
        module = RandomModule([*self.steps, step], self.parts).eval()
        with torch.no_grad():
            try:
                shape = tuple(module(torch.ones(1, *SHAPE)).shape[1:])
            except Exception:  # torch refuses these shapes
                return
        self.steps.append(step)
        if result:
            self.shapes.append(shape)

    def activation(self):
        inplace = self.chance(0.5)
        low, high = self.pick((-1.0, 1.0), (0.0, 6.0), (-0.5, 2.0))
        slope = self.pick(0.01, 0.2)
        function = self.pick(F.silu, F.gelu, torch.sigmoid, torch.tanh, F.hardswish, F.hardsigmoid)
        choices = [
            lambda: self.part(nn.ReLU(inplace)),
            lambda: self.part(nn.LeakyReLU(slope, inplace)),
            lambda: self.part(nn.ReLU6(inplace)),
            lambda: self.part(nn.Hardtanh(low, high, inplace)),
            lambda: self.part(nn.PReLU()),
            lambda: lambda m, x: F.relu(x, inplace),
            lambda: lambda m, x: torch.relu(input=x),
            lambda: lambda m, x: F.leaky_relu(x, slope, inplace=inplace),
            lambda: lambda m, x: F.hardtanh(x, low, high, inplace),
            lambda: lambda m, x: F.relu6(x, inplace=inplace),
            lambda: lambda m, x: torch.clamp(x, low, high),
            lambda: lambda m, x: x.clamp(max=high),
            lambda: lambda m, x: x.relu(),
            lambda: self.part(self.pick(*SMOOTH)()),
            lambda: self.part(nn.Softshrink(self.pick(0.5, 0.0))),
            lambda: lambda m, x: F.softshrink(x, slope),
            lambda: self.part(nn.GELU(self.pick("none", "tanh"))),
            lambda: lambda m, x: function(x),
            lambda: lambda m, x: torch.log1p(x.clamp(min=0)),
            lambda: lambda m, x: (x - low) / high * 2 + slope,
        ]
        if self.chance(0.5):
            choices = [
                lambda: lambda m, x: x.relu_(),
                lambda: lambda m, x: torch.relu_(x),
                lambda: lambda m, x: x.clamp_(low, high),
                lambda: lambda m, x: torch.clamp_(x, low),
                lambda: lambda m, x: F.hardtanh_(x, low, high),
                lambda: lambda m, x: F.leaky_relu_(x, slope),
                lambda: lambda m, x: x.div_(10),
                lambda: lambda m, x: x.mul_(0.5),
                lambda: lambda m, x: torch.clamp(x, low, high, out=x),
                lambda: lambda m, x: torch.tanh_(x),
                lambda: lambda m, x: F.silu(x, inplace=True),
                lambda: lambda m, x: scale_(x),
            ]
        if self.chance(0.12):
            choices = [
                lambda: self.part(ReLU(inplace)),
                lambda: self.part(Plain()),
                lambda: lambda m, x: relu(x),
            ]
        return self.pick(*choices)()

    def layer(self, shape):
        channels = shape[0]
        groups = self.pick(1, 1, channels)
        filters = groups * self.pick(1, 2, 3)
        conv = self.pick(nn.Conv2d, nn.Conv2d, Conv2d if self.chance(0.1) else nn.Conv2d)
        kernel = self.pick(1, 2, 3, (3, 2))
        stride = self.pick(1, 1, 2)
        padding = self.pick(0, 1, "same") if stride == 1 else self.pick(0, 1)
        ceil = self.pick(False, False, True)
        pool = {
            "kernel_size": self.pick(2, (2, 3)),
            "stride": self.pick(None, 1, 2),
            "padding": self.pick(0, 0, 1),
        }
        norm = nn.BatchNorm2d(channels, affine=self.pick(True, False))
        norm.running_mean.normal_()
        norm.running_var.uniform_(0.5, 2.0)
        return self.pick(
            lambda: self.part(
                conv(
                    channels,
                    filters,
                    kernel,
                    stride,
                    padding,
                    self.pick(1, 1, 2),
                    groups,
                    bias=self.pick(True, False),
                )
            ),
            lambda: self.part(norm),
            lambda: self.part(nn.MaxPool2d(**pool, ceil_mode=ceil)),
            lambda: self.part(
                nn.AvgPool2d(**pool, ceil_mode=ceil, count_include_pad=self.pick(True, False))
            ),
            lambda: self.part(nn.AdaptiveAvgPool2d(self.pick(2, (3, None), (5, 4), 7))),
            lambda: self.part(
                nn.Sequential(nn.Conv2d(channels, 4 * filters, 1), nn.PixelShuffle(2))
            ),
            lambda: lambda m, x: F.pixel_shuffle(torch.cat([x, x, 2 * x, x], 1), 2),
            lambda: self.part(
                nn.ConvTranspose2d(
                    channels,
                    filters,
                    self.pick(2, 4, (2, 4)),
                    2,
                    self.pick(0, 0, 1),
                    groups=groups,
                    bias=self.pick(True, False),
                )
            ),
            lambda: self.part(
                nn.Upsample(scale_factor=self.pick(2, 3), mode=self.pick("nearest", "bilinear"))
            ),
            lambda: self.part(
                self.pick(nn.ZeroPad2d, nn.ReplicationPad2d)(self.pick(1, (0, 1, 2, 0)))
            ),
            lambda: lambda m, x: F.interpolate(x, scale_factor=2),
            lambda: (
                lambda m, x: F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
            ),
            lambda: lambda m, x: x * torch.sigmoid(x.mean((2, 3), keepdim=True)),
            lambda: lambda m, x: F.interpolate(x.mean((2, 3), keepdim=True), size=x.shape[2:]),
            lambda: lambda m, x: x[:, ::2].contiguous(),
            lambda: lambda m, x: x[:, -1:, : x.shape[2] // 2 + 1].clone(),
            lambda: lambda m, x: _shuffled(torch.cat([x, x], 1)),
            lambda: lambda m, x: torch.cat(torch.cat([x, x], 1).chunk(2, 1)[::-1], 1),
            lambda: lambda m, x: x - x[:, :1],
            lambda: (
                lambda m, x: (
                    F.layer_norm(x.permute(0, 2, 3, 1), x.shape[1:2])
                    .permute(0, 3, 1, 2)
                    .contiguous()
                )
            ),
            lambda: self.part(nn.GroupNorm(self.pick(1, shape[0]), shape[0])),
            lambda: lambda m, x: torch.erf(x),
            lambda: lambda m, x: 1 - x,
            lambda: lambda m, x: torch.cat([x], 1).clone(),
            lambda: lambda m, x: x[..., ::2, :].contiguous(),
            lambda: lambda m, x: x[:, :, 1:, ::2].contiguous(),
            lambda: self.part(NormFunction(norm)),
            lambda: lambda m, x: F.max_pool2d(x, **pool),
            lambda: lambda m, x: F.avg_pool2d(x, pool["kernel_size"], pool["stride"]),
            lambda: lambda m, x: F.dropout(x, 0.4, m.training),
            lambda: self.part(
                self.pick(nn.Dropout(inplace=self.pick(True, False)), nn.Dropout2d(), nn.Identity())
            ),
            lambda: lambda m, x: x.contiguous(),
        )()

    def join(self):
        alpha = self.pick(1, 2)
        if self.chance(0.5):
            return self.pick(
                lambda m, x, y: x.add_(y),
                lambda m, x, y: _iadd(x, y),
                lambda m, x, y: torch.add(x, y),
            )
        return self.pick(
            lambda m, x, y: x + y,
            lambda m, x, y: x * torch.tanh(y),
            lambda m, x, y: torch.sub(x, y),
            lambda m, x, y: torch.cat([x, y], 1),
            lambda m, x, y: torch.cat(tensors=(x, y), dim=1),
            lambda m, x, y: torch.add(x, y, alpha=alpha),
        )

    def unused(self):
        """Something whose result nobody reads, and which may have changed its input."""
        return self.pick(
            lambda m, x: x.exp(),
            lambda m, x: x * 3,
            lambda m, x: x.clamp_(-0.5, 0.5),
            lambda m, x: F.relu(x, inplace=True),
            lambda m, x: x.div_(10),
            lambda m, x: _imul(x, 2),
            lambda m, x: x.flatten(1).clamp_(max=0.7),
            lambda m, x: x.view(x.size(0), -1).relu_(),
            lambda m, x: scale_(x),
            self.activation(),
        )

    def head(self) -> None:
        shape = self.shapes[-1]
        if len(shape) == 3:
            if self.pick(True, False):
                pool = self.pick(
                    self.part(nn.AdaptiveAvgPool2d(1)),
                    lambda m, x: F.adaptive_avg_pool2d(x, (1, 1)),
                    lambda m, x: x.mean((2, 3), keepdim=True),
                    lambda m, x: torch.mean(x, dim=(-1, -2), keepdim=True),
                )
                self.add(pool, len(self.shapes) - 1)
            flat = self.pick(
                self.part(nn.Flatten()),
                lambda m, x: torch.flatten(x, 1),
                lambda m, x: x.flatten(start_dim=1),
                lambda m, x: x.view(x.size(0), -1),
                lambda m, x: x.reshape(x.shape[0], -1),
                lambda m, x: x.view(1, -1),
            )
            if self.chance(0.1):
                flat = self.pick(lambda m, x: x.view(x.size(1), -1), lambda m, x: x.reshape(2, -1))
            self.add(flat, len(self.shapes) - 1)
        shape = self.shapes[-1]
        if len(shape) == 1:
            if self.pick(True, False):
                self.add(self.activation(), len(self.shapes) - 1)
            self.add(self.part(nn.Linear(shape[0], N_CLASSES)), len(self.shapes) - 1)
            if self.chance(0.2):
                self.add(self.unused(), len(self.shapes) - 1, result=False)


def _shuffled(x):
    """A channel shuffle, as ShuffleNet spells it."""
    n, channels, rows, columns = x.shape
    groups = x.view(n, 2, channels // 2, rows, columns).transpose(1, 2).contiguous()
    return groups.view(n, -1, rows, columns)


def _iadd(x, y):
    x += y
    return x


def _imul(x, y):
    x *= y
    return x


def random_module(seed: int) -> RandomModule:
    """Volumes (1, *SHAPE) to logits (1, N_CLASSES), in most cases."""
    builder = _Builder(seed)
    for _ in range(builder.rng.integers(1, 8)):
        n = len(builder.shapes)
        source = int(builder.rng.integers(n)) if builder.rng.random() < 0.3 else n - 1
        shape = builder.shapes[source]
        same = [k for k, other in enumerate(builder.shapes) if other == shape]
        if len(shape) != 3:
            break
        choice = builder.rng.random()
        if choice < 0.5:
            run = builder.layer(shape)
        elif choice < 0.7:
            run = builder.activation()
        elif choice < 0.85:
            other = same[builder.rng.integers(len(same))]
            builder.add(builder.join(), source, other)
            continue
        elif builder.wild and choice < 0.92:
            builder.add(builder.unused(), source, result=False)
            continue
        elif builder.wild and builder.parts:  # a layer that is used again
            run = builder.call(int(builder.rng.integers(len(builder.parts))))
        else:
            continue
        builder.add(run, source)
    builder.head()
    return RandomModule(builder.steps, builder.parts).eval()
