"""Networks that papers on event cameras published, retyped in a few lines each.

They have the layers, widths and sizes that the papers state, as far as these say; the weights are
random. Recurrent ones stand here, too: a stream of single events has no steps for their state.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor, nn

from experiments.published.blocks import Residual, UNet, Up, conv, vgg

CLASSES = 10
"""Number of classes of networks whose own number does not matter."""


ASYNET = (16, 16, "M", 32, 32, "M", 64, 64, "M", 128, 128, "M", 256, 256)
"""Widths of AsyNet's convolutions, see `blocks.vgg`."""


def _head(inputs: int, *widths: int) -> list[nn.Module]:
    """Flatten, and dense layers of these widths with ReLUs between them."""
    layers: list[nn.Module] = [nn.Flatten()]
    for k, width in enumerate(widths):
        layers.append(nn.Linear(inputs, width))
        if k + 1 < len(widths):
            layers.append(nn.ReLU())
        inputs = width
    return layers


def nir_nmnist() -> nn.Module:
    """The CNN of the NIR paper for N-MNIST (Pedersen et al. 2024), as a network of ReLUs."""
    return nn.Sequential(
        nn.Conv2d(2, 16, 5, 2, 1, bias=False), nn.ReLU(),
        nn.Conv2d(16, 16, 3, 1, 1, bias=False), nn.ReLU(), nn.AvgPool2d(2),
        nn.Conv2d(16, 8, 3, 1, 1, bias=False), nn.ReLU(), nn.AvgPool2d(2),
        *_head(128, 256, 10),
    )  # fmt: skip


def roshambo() -> nn.Module:
    """RoShamBo's network (Lungu et al. 2017): five convolutions, each with pooling."""
    body = vgg(1, [16, "M", 32, "M", 64, "M", 128, "M"])
    return nn.Sequential(body, nn.Conv2d(128, 128, 1), nn.ReLU(), nn.MaxPool2d(2), *_head(512, 4))


def gesture_cnn() -> nn.Module:
    """A CNN for DVS128 Gesture in the manner of Amir et al. 2017, with groups."""
    return nn.Sequential(
        conv(6, 12, 3, 2), conv(12, 252, 4, 2, groups=1), nn.Conv2d(252, 256, 1, groups=2),
        nn.ReLU(), conv(256, 256, 3, groups=8), nn.MaxPool2d(2), conv(256, 512, 3, 2, groups=16),
        nn.Conv2d(512, 512, 1, groups=4), nn.ReLU(), nn.AdaptiveAvgPool2d(1), *_head(512, 11),
    )  # fmt: skip


def decolle_gesture() -> nn.Module:
    """The layers of DECOLLE for DVS Gesture (Kaiser et al. 2020), with ReLUs."""
    return nn.Sequential(
        nn.Conv2d(2, 64, 7, padding=2), nn.MaxPool2d(2), nn.ReLU(),
        nn.Conv2d(64, 128, 7, padding=2), nn.ReLU(),
        nn.Conv2d(128, 128, 7, padding=2), nn.MaxPool2d(2), nn.ReLU(), *_head(3200, 11),
    )  # fmt: skip


def speck_gesture() -> nn.Module:
    """A network of the size of the chip Speck (Yao et al. 2024), with ReLUs and sum pooling."""
    return nn.Sequential(
        conv(2, 16, 5, 2), nn.AvgPool2d(2, divisor_override=1), conv(16, 32),
        nn.AvgPool2d(2, divisor_override=1), conv(32, 32), nn.AvgPool2d(2, divisor_override=1),
        *_head(2048, 256, 11),
    )  # fmt: skip


def asynet_vgg() -> nn.Module:
    """AsyNet's network for classification (Messikommer et al. 2020), as dense convolutions."""
    return nn.Sequential(vgg(2, ASYNET, norm=True), conv(256, 512, 3, 2), *_head(512 * 16, 2))


def asynet_detection() -> nn.Module:
    """AsyNet's network for detection: the same body, and boxes of 5x7 cells."""
    body = vgg(2, ASYNET, norm=True)
    return nn.Sequential(body, conv(256, 256, 3, 2), *_head(256 * 24, 1024, 5 * 7 * 12))


class MaskedConv(nn.Module):
    """A convolution at active places only, as submanifold networks have it."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """The convolution times the mask of places with an input."""
        mask = x.abs().sum(1, keepdim=True).clamp(max=1)
        return torch.relu(self.conv(x) * mask)


def submanifold_vgg() -> nn.Module:
    """AsyNet's layers with masks, which its sparse convolutions mean."""
    return nn.Sequential(
        MaskedConv(2, 16), MaskedConv(16, 16), nn.MaxPool2d(2), MaskedConv(16, 32),
        nn.MaxPool2d(2), MaskedConv(32, 64), nn.MaxPool2d(2), *_head(64 * 256, CLASSES),
    )  # fmt: skip


def yole() -> nn.Module:
    """YOLE (Cannici et al. 2019): leaky ReLUs, max pooling, and dense layers for boxes."""

    def leaky() -> nn.Module:
        return nn.LeakyReLU(0.1)

    return nn.Sequential(
        conv(1, 16, 5, activation=leaky), nn.MaxPool2d(2), conv(16, 32, 5, activation=leaky),
        nn.MaxPool2d(2), conv(32, 64, activation=leaky), nn.MaxPool2d(2),
        conv(64, 128, activation=leaky), nn.MaxPool2d(2), *_head(128 * 64, 512, 5 * 5 * 20),
    )  # fmt: skip


class YoloTiny(nn.Module):
    """The shape of YOLOv3-tiny, used on event frames: two scales, nearest upsampling."""

    def __init__(self) -> None:
        super().__init__()

        def leaky() -> nn.Module:
            return nn.LeakyReLU(0.1)

        def step(a: int, b: int) -> nn.Module:
            return nn.Sequential(conv(a, b, activation=leaky, norm=True), nn.MaxPool2d(2))

        self.fine = nn.Sequential(step(2, 16), step(16, 32), step(32, 64), step(64, 128))
        self.middle = conv(128, 256, activation=leaky, norm=True)
        self.coarse = nn.Sequential(
            nn.MaxPool2d(2), conv(256, 512, activation=leaky, norm=True),
            conv(512, 256, 1, activation=leaky, norm=True),
        )  # fmt: skip
        self.head_coarse = nn.Conv2d(256, 21, 1)
        self.reduce = conv(256, 128, 1, activation=leaky, norm=True)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")
        self.head_fine = nn.Conv2d(128 + 256, 21, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Maps of boxes at both scales."""
        middle = self.middle(self.fine(x))
        coarse = self.coarse(middle)
        fine = torch.cat([self.up(self.reduce(coarse)), middle], 1)
        return self.head_coarse(coarse), self.head_fine(fine)


class YoloxNano(nn.Module):
    """The shape of YOLOX (Ge et al. 2021), used by RVT and others: Focus, SiLU, split heads."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = conv(8, 16, activation=nn.SiLU, norm=True)
        self.body = nn.Sequential(
            conv(16, 32, 3, 2, nn.SiLU, norm=True), Residual(32, norm=True),
            conv(32, 64, 3, 2, nn.SiLU, norm=True), Residual(64, norm=True),
        )  # fmt: skip
        self.classes = nn.Sequential(
            conv(64, 64, activation=nn.SiLU, norm=True), nn.Conv2d(64, 2, 1)
        )
        self.boxes = nn.Sequential(conv(64, 64, activation=nn.SiLU, norm=True), nn.Conv2d(64, 4, 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Maps of classes and boxes."""
        corners = [x[..., j::2, i::2] for i in (0, 1) for j in (0, 1)]
        x = self.body(self.stem(torch.cat(corners, 1)))
        return self.classes(x), torch.sigmoid(self.boxes(x))


class SsdVgg(nn.Module):
    """An SSD head on a VGG body for event frames: maps of two scales as one row of boxes."""

    def __init__(self) -> None:
        super().__init__()
        self.body = vgg(3, [32, 32, "M", 64, 64, "M", 128, 128, "M", 256, 256])
        self.extra = nn.Sequential(nn.MaxPool2d(2), conv(256, 256))
        self.heads = nn.ModuleList(nn.Conv2d(256, 4 * 6, 3, padding=1) for _ in range(2))

    def forward(self, x: Tensor) -> Tensor:
        """Rows of six numbers, (N, boxes * 6)."""
        fine = self.body(x)
        coarse = self.extra(fine)
        rows = [
            head(scale).permute(0, 2, 3, 1).flatten(1)
            for head, scale in zip(self.heads, (fine, coarse), strict=True)
        ]
        return torch.cat(rows, 1)


class EvFlowNet(nn.Module):
    """EV-FlowNet (Zhu et al. 2018): a U-Net with a flow of every scale, which the next one gets."""

    def __init__(self, up: str = "bilinear") -> None:
        super().__init__()
        widths = (4, 64, 128, 256, 512)
        self.down = nn.ModuleList(conv(a, b, 3, 2) for a, b in itertools.pairwise(widths))
        self.middle = nn.Sequential(Residual(512), Residual(512))
        ups = ((1024, 256), (512 + 2, 128), (256 + 2, 64), (128 + 2, 32))
        self.up = nn.ModuleList(Up(a, b, up) for a, b in ups)
        self.flow = nn.ModuleList(nn.Conv2d(b, 2, 1) for _, b in ups)

    def forward(self, x: Tensor) -> tuple[Tensor, ...]:
        """Flows of four scales, the finest at the input's size."""
        maps = []
        for down in self.down:
            x = down(x)
            maps.append(x)
        x = self.middle(x)
        flows: list[Tensor] = []
        for up, head in zip(self.up, self.flow, strict=True):
            parts = [x, maps.pop(), *flows[-1:]]
            x = up(torch.cat(parts, 1))
            flows.append(torch.tanh(head(x)) * 256.0)
        return tuple(flows)


def fire_flow_net() -> nn.Module:
    """FireFlowNet (Paredes-Valles et al. 2021): convolutions at full size, flow of each pixel."""
    return nn.Sequential(
        conv(4, 32), conv(32, 32), Residual(32), conv(32, 32), Residual(32),
        nn.Conv2d(32, 2, 1), nn.Tanh(),
    )  # fmt: skip


class ConvGru(nn.Module):
    """A convolutional gated unit, whose state goes on from call to call."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.gates = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1)
        self.new = nn.Conv2d(2 * channels, channels, 3, padding=1)
        self.state: Tensor | None = None

    def forward(self, x: Tensor) -> Tensor:
        """The new state."""
        before = torch.zeros_like(x) if self.state is None else self.state
        update, reset = torch.sigmoid(self.gates(torch.cat([x, before], 1))).chunk(2, 1)
        new = torch.tanh(self.new(torch.cat([x, reset * before], 1)))
        self.state = (1 - update) * before + update * new
        return self.state


def firenet() -> nn.Module:
    """FireNet (Scheerlinck et al. 2020), recurrent: images of brightness from events."""
    return nn.Sequential(
        conv(5, 16), ConvGru(16), Residual(16), ConvGru(16), Residual(16), nn.Conv2d(16, 1, 1)
    )


def e2vid_without_state() -> nn.Module:
    """E2VID's U-Net (Rebecq et al. 2019) without its recurrent units: sums as joins."""
    net = UNet(5, (32, 64, 128, 256), 1, join="add", kernel=5)
    return nn.Sequential(net, nn.Sigmoid())


def ev_segnet() -> nn.Module:
    """A smaller EV-SegNet (Alonso and Murillo 2019): separable convolutions, classes of pixels."""

    def separable(a: int, b: int, stride: int = 1) -> nn.Module:
        return nn.Sequential(conv(a, a, 3, stride, None, groups=a), conv(a, b, 1, norm=True))

    return nn.Sequential(
        conv(6, 32, 3, 2, norm=True), separable(32, 64, 2), separable(64, 128, 2),
        separable(128, 128), Up(128, 64), Up(64, 32), Up(32, 16), nn.Conv2d(16, 6, 1),
    )  # fmt: skip


def dhp19() -> nn.Module:
    """DHP19 (Calabrese et al. 2019): heat maps of 13 joints, with upsampling in between."""
    return nn.Sequential(
        conv(1, 16), nn.MaxPool2d(2), conv(16, 32), conv(32, 32), nn.MaxPool2d(2), conv(32, 64),
        conv(64, 64), nn.Upsample(scale_factor=2, mode="nearest"), conv(64, 32), conv(32, 32),
        nn.Conv2d(32, 13, 3, padding=1),
    )  # fmt: skip


def denoising_unet() -> nn.Module:
    """A U-Net with transposed convolutions, a value of each pixel (event denoising, depth)."""
    return UNet(2, (16, 32, 64), 1, up="transposed", n_residual=1)


def event_depth() -> nn.Module:
    """A U-Net for depth in the manner of Hidalgo-Carrio et al. 2020, without recurrent units."""
    return UNet(5, (32, 64, 128), 1, n_residual=1, norm=True)


def edncnn() -> nn.Module:
    """EDnCNN (Baldwin et al. 2020): whether an event is noise, by the surface around it."""
    return nn.Sequential(
        nn.Conv2d(4, 16, 3), nn.ReLU(), nn.BatchNorm2d(16), nn.Conv2d(16, 32, 3), nn.ReLU(),
        nn.BatchNorm2d(32), nn.Conv2d(32, 64, 3), nn.ReLU(), nn.BatchNorm2d(64),
        *_head(64 * 19 * 19, 512, 2),
    )  # fmt: skip


class SuperEvent(nn.Module):
    """Interest points in the manner of SuperPoint, used on event images: two outputs."""

    def __init__(self) -> None:
        super().__init__()
        self.body = vgg(1, [64, 64, "M", 64, 64, "M", 128, 128, "M", 128, 128])
        self.points = nn.Sequential(conv(128, 256), nn.Conv2d(256, 65, 1))
        self.descriptors = nn.Sequential(conv(128, 256), nn.Conv2d(256, 128, 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """A heat map of the input's size, and descriptors of 8x8 pixels."""
        x = self.body(x)
        points = torch.softmax(self.points(x), 1)[:, :-1]
        return torch.pixel_shuffle(points, 8), self.descriptors(x)


def eye_tracker() -> nn.Module:
    """A small CNN for eye tracking in the manner of Retina (Bonazzi et al. 2024): two numbers."""
    return nn.Sequential(
        conv(2, 16, 5, 2, norm=True), nn.AvgPool2d(2), conv(16, 64, norm=True),
        conv(64, 16, norm=True), nn.AvgPool2d(2), conv(16, 16, norm=True), nn.AvgPool2d(2),
        *_head(256, 64, 2),
    )  # fmt: skip


def spike_flow_decoder() -> nn.Module:
    """The decoder of Spike-FlowNet (Lee et al. 2020): transposed convolutions, leaky ReLUs."""
    return nn.Sequential(
        conv(4, 64, 3, 2), conv(64, 128, 3, 2), Residual(128),
        nn.ConvTranspose2d(128, 64, 4, 2, 1), nn.LeakyReLU(0.1),
        nn.ConvTranspose2d(64, 32, 4, 2, 1), nn.LeakyReLU(0.1), nn.Conv2d(32, 2, 1, bias=False),
    )  # fmt: skip


class GatedPyramid(nn.Module):
    """Channel attention as event networks use it (squeeze and excitation), then classes."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(conv(2, 32, 3, 2, norm=True), conv(32, 64, 3, 2, norm=True))
        self.gate = nn.Sequential(
            nn.AdaptiveAvgPool2d(1), nn.Conv2d(64, 16, 1), nn.ReLU(), nn.Conv2d(16, 64, 1),
            nn.Sigmoid(),
        )  # fmt: skip
        self.head = nn.Sequential(nn.AdaptiveAvgPool2d(1), *_head(64, CLASSES))

    def forward(self, x: Tensor) -> Tensor:
        """Logits."""
        x = self.body(x)
        result: Tensor = self.head(x * self.gate(x))
        return result
